//! The LEGO NXT as it comes out of the box: polled by its own commands, without a program of ours on it. `SPEC.md` beside
//! this file defines the bytes.
//!
//! A transaction costs about 30 ms of the radio chip whatever its size, so the station sends one request at a time, reads
//! whole IO maps, and requests no reply that it can do without. A program on the brick that sends MAVLink frames is another
//! row of the table, `nxt-push`: the same codec, which then polls only the clock.

mod codec;
mod digital;
mod estimate;
mod framer;
mod gyro;
mod io_maps;
mod motors;
mod poll_schedule;
mod replies;
mod requests;
mod settings;
mod telegram;

pub(super) use codec::{open, open_push};
pub use settings::{
    AccelerometerMounting, ForwardAxis, GyroSign, MaxOutstanding, MotorMounting, MotorPort, NxtSensor, NxtSettings,
    NxtSettingsError, WheelMotor,
};
pub use telegram::{
    NxtStatus, OutputState, ReplyRequest, framed, message_write, set_output_state, start_program, stop_program,
};

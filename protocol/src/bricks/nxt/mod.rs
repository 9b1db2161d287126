//! The LEGO NXT as it comes out of the box: asked by its own commands, with no program of ours on it.
//!
//! `SPEC.md` beside this file has the bytes. The station asks, one question at a time, because a transaction costs
//! about 30 ms of the radio chip whatever it holds: so it reads whole IO maps, and leaves out every reply that it can do without.
//!
//! ```text
//! cutter        bytes of the link to telegrams; what to do when there is one too many or too few
//! conversation  which reply belongs to which question, and what is lost
//! plan          what to ask next: connect, set-up, rounds
//! answers       what replies mean: counters, gyro, digital sensors, tick, notes to people
//! estimate      the pose into a mailbox, for a program on the brick if there is one
//! ```
//! A program on the brick that pushes MAVLink frames of itself is the other row of the table, `nxt-push`: the same codec, which then
//! asks for nothing but the clock.

mod answers;
mod codec;
mod conversation;
mod counters;
mod cutter;
mod digital;
mod estimate;
mod gyro;
mod io_maps;
mod motion;
mod notes;
mod plan;
mod presence;
mod question;
mod settings;
mod status;
mod telegram;
mod tick;

pub(super) use codec::{open, open_push};
pub use settings::{
    AccelerometerPlace, ForwardAxis, GyroSign, MotorPort, Mounting, NxtSensor, NxtSettings, NxtSettingsError,
    Outstanding, WheelMotor,
};
pub use status::Status;
pub use telegram::{Answer, OutputState, framed, message_write, set_output_state, start_program, stop_program};

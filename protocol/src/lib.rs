//! Bytes to frames to messages, and back.
//!
//! [`framing`] finds frames in the bytes of a link, [`dialect`] decodes them to [`message::Message`]s in SI units and
//! our coordinate frames, [`session`] implements the MAVLink services beside the telemetry, [`signing`] verifies
//! signatures, [`routing`] decides where a frame is forwarded, [`statistics`] counts frames, and [`bricks`] is the
//! table of the protocols of robots; [`detect`] guesses which of them a link carries. Everything here is a value: bytes
//! and time are arguments, frames and messages are results. Nothing opens a link, reads a clock, aligns clocks or
//! estimates.

pub mod bricks;
pub mod detect;
pub mod dialect;
pub mod frame_verifier;
pub mod framing;
pub mod message;
pub mod recorded_robot;
pub mod routing;
pub mod session;
pub mod signing;
pub mod statistics;

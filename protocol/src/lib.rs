//! Bytes to frames to messages, and back. Everything here is a value: bytes and time are arguments, frames and messages are
//! results. Nothing opens a link, reads a clock, aligns clocks or estimates.

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
pub mod text_columns;

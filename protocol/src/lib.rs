//! Bytes to frames to messages, and back.
//!
//! [`framing`] finds frames in what a link delivers, [`dialect`] turns them into [`message::Message`]s in SI units and our
//! spaces, [`session`] holds the conversation beside the telemetry, [`signing`] says whose frames are believed, [`routing`] to
//! whom a frame is passed on, [`census`] counts what came, and [`bricks`] is the table of the protocols that robots speak;
//! [`recognise`] guesses which of them a link carries. Everything here is a value: bytes and time come in as arguments, frames and
//! messages go out. Nothing opens a link, reads a clock, aligns clocks or estimates.

pub mod brick_player;
pub mod bricks;
pub mod census;
pub mod dialect;
pub mod framing;
pub mod message;
pub mod recognise;
pub mod routing;
pub mod session;
pub mod signing;

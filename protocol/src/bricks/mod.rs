//! The protocols that bricks speak, in one table.
//!
//! A brick protocol turns a link's bytes into [`Message`]s and back. To the pipeline all of them look the same; what a
//! protocol cannot say, it never says. MAVLink is one of them; a brick with a protocol of its own gets a folder beside it
//! with its specification and captured bytes, and a line in [`BRICKS`].

mod mavlink;

use std::fmt;

use posebridge_telemetry::{Address, Defect, HostClock, Stamp};

use crate::framing::{FrameRef, ScannerConfig};
use crate::message::Message;

/// Every brick protocol. Adding one: a folder here and a line there.
pub const BRICKS: &[BrickProtocol] = &[BrickProtocol {
    name: "mavlink",
    summary: "MAVLink 2 with the common and the posebridge dialect",
    open: mavlink::open,
}];

/// One row of [`BRICKS`].
#[derive(Clone, Copy, Debug)]
pub struct BrickProtocol {
    /// The name in configurations, lower case.
    pub name: &'static str,
    /// What it is, in one line.
    pub summary: &'static str,
    /// Makes the codec for one link.
    pub open: fn(ScannerConfig) -> Box<dyn BrickCodec>,
}

/// What a codec heard.
#[derive(Clone, Debug, PartialEq)]
pub enum Heard<'a> {
    /// A message that means something here.
    Message {
        /// Who sent it.
        from: Address,
        /// The message.
        message: Message,
    },
    /// A whole frame that means nothing here: forward it untouched.
    Other(FrameRef<'a>),
    /// Something damaged or missing.
    Defect(Defect),
}

/// Bytes of one link to messages and back. Holds the link's framing state; reads no clock and does no IO.
pub trait BrickCodec: fmt::Debug + Send {
    /// Takes one chunk, which arrived at `now`.
    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>));

    /// When [`BrickCodec::tick`] must be called if nothing comes before.
    fn deadline(&self) -> Option<Stamp<HostClock>>;

    /// Gives up what has waited for too long.
    fn tick(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>));

    /// Appends the message to `out` and returns how many bytes it took; 0 when the protocol cannot say it.
    fn encode(&mut self, from: Address, message: &Message, out: &mut Vec<u8>) -> usize;
}

/// The protocol with this name.
#[must_use]
pub fn brick_protocol(name: &str) -> Option<&'static BrickProtocol> {
    BRICKS.iter().find(|protocol| protocol.name == name)
}

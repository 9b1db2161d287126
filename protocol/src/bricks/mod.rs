//! The protocols that bricks speak, in one table.
//!
//! A brick protocol turns a link's bytes into [`Message`]s and back. To the pipeline all of them look the same; what a
//! protocol cannot say, it never says. MAVLink is one of them; a brick with a protocol of its own gets a folder beside it
//! with its specification and captured bytes, and a line in [`BRICKS`].
//!
//! Some bricks speak only when they are asked. Their codec asks: what it wants to send stands in [`BrickCodec::poll`], and
//! [`BrickCodec::deadline`] says when it wants to be woken for the next question or for an answer that did not come.

mod counters;
pub mod ev3;
pub mod fixes;
pub mod line;
mod mavlink;
pub mod nxt;
mod pulse;
mod splitter;

use std::fmt;

use posebridge_telemetry::{Address, Audience, Defect, HostClock, PeerId, SourceHealth, Stamp};

use crate::framing::{FrameRef, ScanCounters, ScannerConfig};
use crate::message::Message;

/// The address of a brick whose protocol knows none: system 1, component 1, as an autopilot's.
pub const ONLY_BRICK: Address = Address::new(1, 1);

/// Every brick protocol. Adding one: a folder here and a line there.
pub const BRICKS: &[BrickProtocol] = &[
    BrickProtocol {
        name: "mavlink",
        summary: "MAVLink 2 with the common and the posebridge dialect",
        open: mavlink::open,
    },
    BrickProtocol {
        name: "nxt",
        summary: "LEGO NXT as it comes out of the box, asked by its own commands",
        open: nxt::open,
    },
    BrickProtocol {
        name: "nxt-push",
        summary: "LEGO NXT with a program that sends MAVLink frames of itself",
        open: nxt::open_push,
    },
    BrickProtocol { name: "ev3", summary: "LEGO EV3 as it is: direct commands by Bluetooth or WiFi", open: ev3::open },
    BrickProtocol { name: "line", summary: "lines of text from boards that print: key:value or CSV", open: line::open },
    BrickProtocol {
        name: "camera-json",
        summary: "no brick but cameras that say in lines of JSON where the robot is",
        open: fixes::open,
    },
];

/// One row of [`BRICKS`].
#[derive(Clone, Copy, Debug)]
pub struct BrickProtocol {
    /// The name in configurations, lower case.
    pub name: &'static str,
    /// What it is, in one line.
    pub summary: &'static str,
    /// Makes the codec for one link.
    pub open: fn(&BrickSettings) -> Box<dyn BrickCodec>,
}

/// What a codec must be told of a brick; each takes its own part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BrickSettings {
    /// How MAVLink is cut out of the bytes.
    pub scanner: ScannerConfig,
    /// A LEGO NXT: its motors, sensors and framing.
    pub nxt: nxt::NxtSettings,
    /// What is plugged into an EV3, and how it is reached.
    pub ev3: ev3::Ev3Settings,
    /// How the lines of a board that prints are laid out.
    pub line: line::LineSettings,
    /// How cameras that speak JSON are heard.
    pub fixes: fixes::FixSettings,
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
    /// A question for the brick's time was answered.
    Time {
        /// Who answered.
        from: Address,
        /// When the question left; the answer came with the bytes at hand.
        sent: Stamp<HostClock>,
        /// The brick's clock in between, in nanoseconds since its power-up.
        peer_nanos: i64,
    },
    /// Something that people should read, such as why a brick refuses what it is asked.
    Note {
        /// Of whom it speaks.
        from: Address,
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        /// The line.
        text: String,
    },
    /// A whole frame that means nothing here: forward it untouched.
    Other(FrameRef<'a>),
    /// Something damaged or missing.
    Defect(Defect),
}

/// Bytes of one link to messages and back. Holds the link's framing state; reads no clock and does no IO.
pub trait BrickCodec: fmt::Debug + Send {
    /// The link came up at `now`: nothing that was half heard goes on, and a brick that must be asked is asked from now on.
    fn begin(&mut self, now: Stamp<HostClock>);

    /// Takes one chunk, which arrived at `now`.
    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>));

    /// The same for a chunk of one of several peers of a link. A brick is alone on its link; who may have company keeps them apart.
    fn push_from(&mut self, now: Stamp<HostClock>, _peer: PeerId, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        self.push(now, bytes, sink);
    }

    /// When [`BrickCodec::tick`] must be called if nothing comes before.
    fn deadline(&self) -> Option<Stamp<HostClock>>;

    /// Gives up what has waited for too long, and asks what is due.
    fn tick(&mut self, now: Stamp<HostClock>, sink: &mut dyn FnMut(Heard<'_>));

    /// The next bytes that the codec itself wants to send, to be asked for after every other call until there are none.
    fn poll(&mut self) -> Option<Vec<u8>>;

    /// The same with whom the bytes are for.
    fn poll_to(&mut self) -> Option<(Audience, Vec<u8>)> {
        self.poll().map(|bytes| (Audience::All, bytes))
    }

    /// Appends the message to `out` and returns how many bytes it took; 0 when the protocol cannot say it, or not now.
    fn encode(&mut self, now: Stamp<HostClock>, from: Address, message: &Message, out: &mut Vec<u8>) -> usize;

    /// What was found in the bytes so far.
    fn counters(&self) -> ScanCounters;

    /// What each sender has sent, and what of it is missing.
    fn sources(&self) -> Vec<SourceHealth>;
}

/// The protocol with this name.
#[must_use]
pub fn brick_protocol(name: &str) -> Option<&'static BrickProtocol> {
    BRICKS.iter().find(|protocol| protocol.name == name)
}

//! The interface of a brick protocol: settings, events and the codec of one link.

use std::fmt;

use posebridge_telemetry::{Address, HostClock, PeerId, ReceiveError, Recipients, SourceHealth, Timestamp};

use super::camera_json::CameraJsonSettings;
use super::ev3::Ev3Settings;
use super::nxt::NxtSettings;
use super::text_line::TextLineSettings;
use crate::framing::{FrameRef, FramerConfig, FramerCounters};
use crate::message::Message;

/// The address of a brick whose protocol knows none: system 1, component 1, as an autopilot's.
pub const DEFAULT_BRICK_ADDRESS: Address = Address::new(1, 1);

/// What a codec must know of a brick; each takes its own part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CodecSettings {
    /// How MAVLink is cut out of the bytes.
    pub framer: FramerConfig,
    /// A LEGO NXT: its motors, sensors and framing.
    pub nxt: NxtSettings,
    /// What is plugged into an EV3, and how it is reached.
    pub ev3: Ev3Settings,
    /// How the lines of a board that prints are laid out.
    pub line: TextLineSettings,
    /// Settings for cameras that send JSON.
    pub fixes: CameraJsonSettings,
}

/// What a codec heard.
#[derive(Clone, Debug, PartialEq)]
pub enum CodecEvent<'a> {
    /// A message that means something here.
    Message {
        /// Who sent it.
        from: Address,
        /// The message.
        message: Message,
    },
    /// A question for the brick's time was answered.
    ClockReply {
        /// Who answered.
        from: Address,
        /// When the question left; the answer came with the bytes at hand.
        sent: Timestamp<HostClock>,
        /// The brick's clock in between, in nanoseconds since its power-up.
        peer_nanos: i64,
    },
    /// Something that people should read, such as why a brick refuses what it is asked.
    StatusText {
        /// The sender that it is about.
        from: Address,
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        /// The line.
        text: String,
    },
    /// A whole frame that means nothing here: forward it untouched.
    ForwardFrame(FrameRef<'a>),
    /// Something damaged or missing.
    Error(ReceiveError),
}

/// Bytes of one link to messages and back. Holds the link's framing state; reads no clock and does no IO.
pub trait BrickCodec: fmt::Debug + Send {
    /// The link came up at `now`: nothing that was half heard goes on, and a brick that must be asked is asked from now on.
    fn on_link_up(&mut self, now: Timestamp<HostClock>);

    /// Takes one chunk, which arrived at `now`.
    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(CodecEvent<'_>));

    /// The same for a chunk of one of several peers of a link. A brick is alone on its link; who may have company keeps them apart.
    fn push_from_peer(
        &mut self,
        now: Timestamp<HostClock>,
        _peer: PeerId,
        bytes: &[u8],
        sink: &mut dyn FnMut(CodecEvent<'_>),
    ) {
        self.push(now, bytes, sink);
    }

    /// When [`BrickCodec::tick`] must be called if nothing comes before.
    fn deadline(&self) -> Option<Timestamp<HostClock>>;

    /// Gives up what has waited for too long, and asks what is due.
    fn tick(&mut self, now: Timestamp<HostClock>, sink: &mut dyn FnMut(CodecEvent<'_>));

    /// The next bytes that the codec itself wants to send, to be asked for after every other call until there are none.
    fn poll(&mut self) -> Option<Vec<u8>>;

    /// The same with whom the bytes are for.
    fn poll_addressed(&mut self) -> Option<(Recipients, Vec<u8>)> {
        self.poll().map(|bytes| (Recipients::All, bytes))
    }

    /// Appends the message to `out` and returns how many bytes it took; 0 when the protocol cannot say it, or not now.
    fn encode(&mut self, now: Timestamp<HostClock>, from: Address, message: &Message, out: &mut Vec<u8>) -> usize;

    /// What was found in the bytes so far.
    fn counters(&self) -> FramerCounters;

    /// What each sender has sent, and what of it is missing.
    fn source_health(&self) -> Vec<SourceHealth>;
}

pub(super) type CodecEventSink<'a> = dyn FnMut(CodecEvent<'_>) + 'a;

/// A message of a brick whose protocol knows no address.
pub(super) fn emit_message(sink: &mut CodecEventSink<'_>, message: Message) {
    sink(CodecEvent::Message { from: DEFAULT_BRICK_ADDRESS, message });
}

/// A line about a brick whose protocol knows no address.
pub(super) fn emit_status_text(sink: &mut CodecEventSink<'_>, severity: u8, text: impl Into<String>) {
    sink(CodecEvent::StatusText { from: DEFAULT_BRICK_ADDRESS, severity, text: text.into() });
}

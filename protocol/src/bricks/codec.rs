//! The interface of a brick protocol: settings, events and the codec of one link.

use std::fmt;

use posebridge_telemetry::{Address, HostClock, PeerId, ReceiveError, Recipients, SourceHealth, Timestamp};

use super::camera_json::CameraJsonSettings;
use super::ev3::Ev3Settings;
use super::nxt::NxtSettings;
use super::text_line::TextLineSettings;
use crate::framing::{FrameRef, FramerConfig, FramerCounters};
use crate::message::Message;

/// The address of a brick whose protocol has none: system 1, component 1, as an autopilot's.
pub const DEFAULT_BRICK_ADDRESS: Address = Address::new(1, 1);

/// The settings of all brick protocols; each codec uses its own part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CodecSettings {
    pub framer: FramerConfig,
    pub nxt: NxtSettings,
    /// The sensors of an EV3, and how it is reached.
    pub ev3: Ev3Settings,
    /// The layout of the lines of a board that prints text.
    pub line: TextLineSettings,
    pub fixes: CameraJsonSettings,
}

/// The output of a codec.
#[derive(Clone, Debug, PartialEq)]
pub enum CodecEvent<'a> {
    Message {
        from: Address,
        message: Message,
    },
    /// The brick replied to a time request.
    ClockReply {
        from: Address,
        /// When the request was sent; the reply is in the current bytes.
        sent: Timestamp<HostClock>,
        /// The brick's clock in between, since its power-up.
        peer_nanos: i64,
    },
    /// A text for people, such as why a brick refuses a request.
    StatusText {
        /// The brick that it is about.
        from: Address,
        /// MAVLink severity, 0 emergency to 7 debug.
        severity: u8,
        text: String,
    },
    /// A complete frame with an unknown message id: forward it unchanged.
    ForwardFrame(FrameRef<'a>),
    /// Damaged or missing input.
    Error(ReceiveError),
}

/// Bytes of one link to messages and back. Holds the link's framing state; reads no clock and does no IO.
pub trait BrickCodec: fmt::Debug + Send {
    /// The link came up at `now`: discards incomplete input, and starts to poll a brick that answers only requests.
    fn on_link_up(&mut self, now: Timestamp<HostClock>);

    /// Decodes one chunk, which arrived at `now`.
    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(CodecEvent<'_>));

    /// The same for a chunk of one of several peers of a link. The default is for a brick that is alone on its link.
    fn push_from_peer(
        &mut self,
        now: Timestamp<HostClock>,
        _peer: PeerId,
        bytes: &[u8],
        sink: &mut dyn FnMut(CodecEvent<'_>),
    ) {
        self.push(now, bytes, sink);
    }

    /// When [`BrickCodec::tick`] must be called if no input comes before.
    fn deadline(&self) -> Option<Timestamp<HostClock>>;

    /// Handles timeouts and sends due requests.
    fn tick(&mut self, now: Timestamp<HostClock>, sink: &mut dyn FnMut(CodecEvent<'_>));

    /// The next bytes that the codec itself sends; call it after every other method until it returns `None`.
    fn poll(&mut self) -> Option<Vec<u8>>;

    /// The same with the recipients.
    fn poll_addressed(&mut self) -> Option<(Recipients, Vec<u8>)> {
        self.poll().map(|bytes| (Recipients::All, bytes))
    }

    /// Appends the message to `out` and returns its length in bytes; 0 when the protocol has no such message, or it
    /// must not be sent now.
    fn encode(&mut self, now: Timestamp<HostClock>, from: Address, message: &Message, out: &mut Vec<u8>) -> usize;

    fn counters(&self) -> FramerCounters;

    /// Frames received from each sender, and those missing.
    fn source_health(&self) -> Vec<SourceHealth>;
}

pub(super) type CodecEventSink<'a> = dyn FnMut(CodecEvent<'_>) + 'a;

/// Emits a message of a brick whose protocol has no addresses.
pub(super) fn emit_message(sink: &mut CodecEventSink<'_>, message: Message) {
    sink(CodecEvent::Message { from: DEFAULT_BRICK_ADDRESS, message });
}

/// Emits a text about a brick whose protocol has no addresses.
pub(super) fn emit_status_text(sink: &mut CodecEventSink<'_>, severity: u8, text: impl Into<String>) {
    sink(CodecEvent::StatusText { from: DEFAULT_BRICK_ADDRESS, severity, text: text.into() });
}

//! The interface of a brick protocol: settings, events and the codec of one link; and what several codecs emit.

use std::fmt;

use posebridge_telemetry::{Address, HostClock, PeerId, ReceiveError, Recipients, SourceHealth, TimeDelta, Timestamp};

use super::camera_json::CameraJsonSettings;
use super::ev3::Ev3Settings;
use super::nxt::NxtSettings;
use super::text_line::TextLineSettings;
use crate::framing::{FrameRef, FramerConfig, FramerCounters};
use crate::message::{Heartbeat, Message, PlanarPose, PoseFlags};

/// The address of a brick whose protocol has none: system 1, component 1, as an autopilot's.
pub const DEFAULT_BRICK_ADDRESS: Address = Address::new(1, 1);

/// The settings of all brick protocols; each codec uses its own part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CodecSettings {
    pub framer: FramerConfig,
    pub nxt: NxtSettings,
    pub ev3: Ev3Settings,
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

/// Takes the outputs of a codec.
pub type CodecEventSink<'a> = &'a mut dyn FnMut(CodecEvent<'_>);

/// Bytes of one link to messages and back. Holds the link's framing state; reads no clock and does no IO.
pub trait BrickCodec: fmt::Debug + Send {
    fn on_link_up(&mut self, now: Timestamp<HostClock>);

    /// Decodes one chunk, which arrived at `now`.
    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: CodecEventSink<'_>);

    /// The same for a chunk of one of several peers of a link. The default is for a brick that is alone on its link.
    fn push_from_peer(&mut self, now: Timestamp<HostClock>, _peer: PeerId, bytes: &[u8], sink: CodecEventSink<'_>) {
        self.push(now, bytes, sink);
    }

    /// When [`BrickCodec::tick`] must be called if no input comes before.
    fn deadline(&self) -> Option<Timestamp<HostClock>>;

    /// Handles timeouts and sends due requests.
    fn tick(&mut self, now: Timestamp<HostClock>, sink: CodecEventSink<'_>);

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

/// Emits a message of a brick whose protocol has no addresses.
pub(super) fn emit_message(sink: CodecEventSink<'_>, message: Message) {
    sink(CodecEvent::Message { from: DEFAULT_BRICK_ADDRESS, message });
}

/// Emits a text about a brick whose protocol has no addresses.
pub(super) fn emit_status_text(sink: CodecEventSink<'_>, severity: u8, text: impl Into<String>) {
    sink(CodecEvent::StatusText { from: DEFAULT_BRICK_ADDRESS, severity, text: text.into() });
}

const HEARTBEAT_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// A heartbeat once a second for bricks and cameras without one of their own, so that the station detects when they
/// come and go.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeartbeatSource {
    heartbeat: Heartbeat,
    last_sent: Option<Timestamp<HostClock>>,
}

impl HeartbeatSource {
    pub(super) const fn new(heartbeat: Heartbeat) -> Self {
        Self { heartbeat, last_sent: None }
    }

    /// The brick sent something at `now`: returns its heartbeat, if one is due.
    pub(super) fn heartbeat_if_due(&mut self, now: Timestamp<HostClock>) -> Option<Message> {
        if self.last_sent.is_some_and(|last| now - last < HEARTBEAT_PERIOD) {
            return None;
        }
        self.last_sent = Some(now);
        Some(Message::Heartbeat(self.heartbeat))
    }
}

/// The estimate as a mailbox of a LEGO brick gets it.
///
/// ```text
/// 0 u32 brick time, ms    4 f32 x, m    8 f32 y, m    12 f32 heading, rad    16 f32 sigma, m
/// 20 u8 flags    21 u8 reset counter    22 u16 sequence    little-endian
/// ```
pub(super) fn estimate_bytes(tick_ms: u32, pose: &PlanarPose, sigma_m: f64, sequence: u16) -> [u8; 24] {
    let floats = [pose.pose.x.0, pose.pose.y.0, pose.pose.heading.rad(), sigma_m];
    let parts = tick_ms
        .to_le_bytes()
        .into_iter()
        .chain(floats.into_iter().flat_map(|value| (value as f32).to_le_bytes()))
        .chain([validity_bits(pose.flags), pose.reset_counter])
        .chain(sequence.to_le_bytes());
    let mut bytes = [0; 24];
    for (byte, part) in bytes.iter_mut().zip(parts) {
        *byte = part;
    }
    bytes
}

/// Bit 0: the position is valid; bit 1: the heading is.
pub(super) const fn validity_bits(flags: PoseFlags) -> u8 {
    flags.position_valid as u8 | (flags.heading_valid as u8) << 1
}

//! Cameras that send the robot's position in lines of JSON: a few lines of Python with any vision library.
//!
//! Takes bytes of one or many senders of a link and returns fixes, replies to time requests and heartbeats; errors in a
//! line are sent back to its sender. SPEC.md beside this file defines the messages, docs/protocols/camera-json.md
//! explains their use. A camera has its own clock: the session requests its time and the station aligns it, as for a
//! camera that sends MAVLink.

mod floor_camera;
mod schema;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_telemetry::severity::{INFO, WARNING};
use posebridge_telemetry::{
    Address, ChannelName, HostClock, PeerId, ReceiveError, Recipients, SourceHealth, TimeDelta, Timestamp,
};
use serde_json::json;

use self::floor_camera::TagFix;
pub use self::floor_camera::{FloorCamera, TagCorners};
pub use self::schema::CameraJsonSettings;
use self::schema::{CameraFixMessage, CameraLine, CameraMessage, ExposureTime, FieldError, FixPlace};
use super::codec::{BrickCodec, CodecEvent, CodecEventSink, CodecSettings, DEFAULT_BRICK_ADDRESS, HeartbeatSource};
use super::line_splitter::{LineSplitter, SplitItem, printable};
use crate::dialect::ids;
use crate::framing::{FramerCounters, TransportKind};
use crate::message::{CommandLong, Heartbeat, Message, TimeSync, VisionFix, WireStamp};

/// Longest line, bytes without its end: all keys with all digits take 400.
const MAX_LINE_BYTES: usize = 1_024;
/// Most senders of a link that are kept apart; the oldest one is dropped first.
const MAX_PEERS: usize = 64;
/// Most queued replies; more are dropped, because errors are reported again.
const MAX_REPLIES: usize = 64;
const MAX_UNKNOWN_KEYS: usize = 8;
/// The message id of a line in [`ReceiveError`](posebridge_telemetry::ReceiveError)s, which has none.
const LINE_ID: u32 = 0;

/// A tag in a picture, for programs that calibrate the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenTag {
    pub camera: ChannelName,
    pub tag: u32,
    pub corners: TagCorners,
    /// Since the middle of the exposure, when the line was sent. Where nobody knows the exposure, since the picture was received.
    pub age: TimeDelta,
    pub is_exposure_known: bool,
}

/// The tag of a line that gives its corners; `None` of other lines.
pub fn read_seen_tag(line: &[u8]) -> Option<SeenTag> {
    let line = schema::parse_line(line).ok()?;
    let CameraMessage::Fix(CameraFixMessage { place: FixPlace::Picture(corners), tag: Some(tag), exposed, .. }) =
        line.message
    else {
        return None;
    };
    let (age, is_exposure_known) = match exposed {
        ExposureTime::Ago { least, most } => (TimeDelta::from_nanos((least + most).as_nanos() / 2), true),
        ExposureTime::BeforeReception(ago) => (ago, false),
        ExposureTime::Stamp(_) | ExposureTime::Unknown => (TimeDelta::ZERO, false),
    };
    Some(SeenTag { camera: line.camera, tag, corners: *corners, age, is_exposure_known })
}

#[derive(Debug)]
struct CameraJsonCodec {
    settings: CameraJsonSettings,
    peers: BTreeMap<PeerId, CameraPeer>,
    cameras: CameraTable,
    replies: VecDeque<(Recipients, Vec<u8>)>,
    counts: FramerCounters,
    unknown: BTreeSet<String>,
    is_error_reported: bool,
    is_overflow_reported: bool,
    requests: u64,
}

#[derive(Debug, Default)]
struct CameraPeer {
    splitter: LineSplitter<MAX_LINE_BYTES>,
    lines: u64,
    error_replies: ErrorReplies,
}

pub(super) fn open(settings: &CodecSettings) -> Box<dyn BrickCodec> {
    Box::new(CameraJsonCodec {
        settings: settings.fixes.clone(),
        peers: BTreeMap::new(),
        cameras: CameraTable::default(),
        replies: VecDeque::new(),
        counts: FramerCounters::default(),
        unknown: BTreeSet::new(),
        is_error_reported: false,
        is_overflow_reported: false,
        requests: 0,
    })
}

impl BrickCodec for CameraJsonCodec {
    fn on_link_up(&mut self, _now: Timestamp<HostClock>) {
        self.peers.clear();
        self.replies.clear();
        self.is_error_reported = false;
    }

    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: CodecEventSink<'_>) {
        self.push_from_peer(now, PeerId::default(), bytes, sink);
    }

    fn push_from_peer(&mut self, now: Timestamp<HostClock>, id: PeerId, bytes: &[u8], sink: CodecEventSink<'_>) {
        // Taken out while it is read, because its lines need the rest of the state.
        let mut peer = self.peers.remove(&id).unwrap_or_default();
        let mut splitter = std::mem::take(&mut peer.splitter);
        let mut take = |cut: SplitItem<'_>| self.handle_line(now, id, &mut peer, cut, sink);
        splitter.push(bytes, &mut take);
        if self.settings.framing == TransportKind::Datagram {
            splitter.finish(&mut |cut| self.handle_line(now, id, &mut peer, cut, sink));
        }
        peer.splitter = splitter;
        if self.peers.len() >= MAX_PEERS {
            self.peers.pop_first();
        }
        self.peers.insert(id, peer);
    }

    fn deadline(&self) -> Option<Timestamp<HostClock>> {
        // Half a line waits for its end; its length is limited.
        None
    }

    fn tick(&mut self, _now: Timestamp<HostClock>, _sink: CodecEventSink<'_>) {}

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.poll_addressed().map(|(_, bytes)| bytes)
    }

    fn poll_addressed(&mut self) -> Option<(Recipients, Vec<u8>)> {
        self.replies.pop_front()
    }

    fn encode(&mut self, _now: Timestamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "a camera is told nothing but questions, however many kinds of message there are"
        )]
        let line = match message {
            Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, .. }) => {
                encode_line(&json!({ "time_request": request_nanos }))
            }
            Message::Command(command) => match self.fix_request(command) {
                Some(line) => line,
                None => return 0,
            },
            _ => return 0,
        };
        out.extend_from_slice(&line);
        line.len()
    }

    fn counters(&self) -> FramerCounters {
        self.counts
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        self.cameras.source_health()
    }
}

impl CameraJsonCodec {
    fn handle_line(
        &mut self,
        now: Timestamp<HostClock>,
        id: PeerId,
        peer: &mut CameraPeer,
        cut: SplitItem<'_>,
        sink: CodecEventSink<'_>,
    ) {
        peer.lines += 1;
        let (line, flaw) = match cut {
            SplitItem::Line(line) => {
                let applied = schema::parse_line(line).and_then(|message| self.apply_message(now, &message, sink));
                let Err(flaw) = applied else {
                    return;
                };
                (line, flaw)
            }
            SplitItem::TooLong(bytes) => {
                let text = format!("a line of {bytes} bytes is longer than {MAX_LINE_BYTES}");
                self.count_unframed(bytes, sink);
                (&[][..], FieldError::for_line(text))
            }
        };
        self.count_error(line, &flaw, sink);
        let answer = peer.error_replies.reply_to(now, peer.lines, &flaw);
        if self.replies.len() < MAX_REPLIES {
            let to = Recipients::Peer(id);
            self.replies.extend(answer.map(|answer| (to, answer)));
        }
        if !std::mem::replace(&mut self.is_error_reported, true) {
            let quoted = printable(line);
            let text = format!("line {} `{quoted}`: {}", peer.lines, flaw.text);
            emit_status_text(sink, DEFAULT_BRICK_ADDRESS, WARNING, text);
        }
    }

    fn apply_message(
        &mut self,
        now: Timestamp<HostClock>,
        line: &CameraLine,
        sink: CodecEventSink<'_>,
    ) -> Result<(), FieldError> {
        let Some((from, camera, is_new)) = self.cameras.get_or_insert(line.camera) else {
            if !std::mem::replace(&mut self.is_overflow_reported, true) {
                let text = format!("there are more than {MAX_CAMERAS} cameras on one link");
                emit_status_text(sink, DEFAULT_BRICK_ADDRESS, WARNING, text);
            }
            return Err(FieldError {
                key: Some("camera"),
                text: format!("`camera` is one more than the {MAX_CAMERAS} of a link"),
            });
        };
        camera.lines += 1;
        camera.takes_requests = line.takes_requests.unwrap_or(camera.takes_requests);
        let pulse = camera.heartbeat.heartbeat_if_due(now);
        self.counts.frames += 1;
        if is_new {
            let text = format!("camera `{}` is {from} here", line.camera);
            emit_status_text(sink, from, INFO, text);
        }
        if let Some(message) = pulse {
            sink(CodecEvent::Message { from, message });
        }
        self.report_unknown_keys(from, &line.unknown, sink);
        match &line.message {
            CameraMessage::Fix(fix) => self.emit_fix(now, from, fix, sink)?,
            &CameraMessage::Time { request, nanos } => {
                // Zero would make a request of it.
                let answer = TimeSync { answer_nanos: nanos.max(1), request_nanos: request, target: None };
                sink(CodecEvent::Message { from, message: Message::TimeSync(answer) });
            }
            CameraMessage::Hello => {}
        }
        Ok(())
    }

    fn emit_fix(
        &self,
        now: Timestamp<HostClock>,
        from: Address,
        fix: &CameraFixMessage,
        sink: CodecEventSink<'_>,
    ) -> Result<(), FieldError> {
        if fix.quality.is_some_and(|quality| quality < self.settings.min_quality) {
            // Good to know and no flaw of the line: it is counted, and not used.
            let message_id = ids::VISION_POSITION_ESTIMATE;
            sink(CodecEvent::Error(ReceiveError::Payload { message_id }));
            return Ok(());
        }
        let (x, y, heading, covariance) = match &fix.place {
            FixPlace::Arena { x, y, heading, covariance } => (*x, *y, *heading, *covariance),
            FixPlace::Picture(corners) => {
                let Some(floor) = &self.settings.floor else {
                    let what = "has no place on the floor until the camera is calibrated (docs/camera.md) and the link has its file: `camera = \"FILE.toml\"`";
                    return Err(FieldError::for_key("corners_px", what));
                };
                if fix.tag.is_some_and(|tag| floor.is_on_floor(tag)) {
                    return Ok(());
                }
                let solved = floor.solve(corners);
                let TagFix { x, y, heading, covariance } =
                    solved.map_err(|error| FieldError::for_key("corners_px", &error.to_string()))?;
                (x, y, Some(heading), Some(covariance))
            }
        };
        let message = Message::VisionPosition(VisionFix {
            stamp: self.stamp(now, fix.exposed),
            x,
            y,
            heading,
            covariance,
            reset_counter: fix.reset_counter,
            tag: fix.tag,
        });
        sink(CodecEvent::Message { from, message });
        Ok(())
    }

    fn stamp(&self, now: Timestamp<HostClock>, exposed: ExposureTime) -> WireStamp {
        let interval = |least: TimeDelta, most: TimeDelta| WireStamp::HostInterval {
            sent: now - most,
            answered: now - least.max(TimeDelta::ZERO),
        };
        let CameraJsonSettings { delay, delay_spread, .. } = self.settings;
        match exposed {
            ExposureTime::Stamp(micros) => WireStamp::Micros64(micros),
            ExposureTime::Ago { least, most } => interval(least, most),
            ExposureTime::BeforeReception(ago) => interval(ago + delay - delay_spread, ago + delay + delay_spread),
            ExposureTime::Unknown => interval(delay - delay_spread, delay + delay_spread),
        }
    }

    fn report_unknown_keys(&mut self, from: Address, unknown: &[String], sink: CodecEventSink<'_>) {
        for key in unknown {
            if self.unknown.len() < MAX_UNKNOWN_KEYS && self.unknown.insert(key.clone()) {
                emit_status_text(sink, from, INFO, format!("the camera's `{key}` is not used"));
            }
        }
    }

    fn fix_request(&mut self, command: &CommandLong) -> Option<Vec<u8>> {
        let is_for_fix = command.command == ids::COMMAND_REQUEST_MESSAGE
            && command.params[0] == ids::VISION_POSITION_ESTIMATE as f32;
        let camera = self.cameras.get(command.target)?;
        if !is_for_fix || !camera.takes_requests {
            return None;
        }
        self.requests += 1;
        Some(encode_line(&json!({ "camera": camera.name.as_str(), "fix_request": self.requests })))
    }

    fn count_error(&mut self, line: &[u8], flaw: &FieldError, sink: CodecEventSink<'_>) {
        if flaw.key.is_some() {
            let message_id = LINE_ID;
            sink(CodecEvent::Error(ReceiveError::Payload { message_id }));
        } else if !line.is_empty() {
            self.count_unframed(line.len() as u32, sink);
        }
    }

    fn count_unframed(&mut self, bytes: u32, sink: CodecEventSink<'_>) {
        self.counts.garbage_bytes += u64::from(bytes);
        sink(CodecEvent::Error(ReceiveError::UnframedBytes { bytes }));
    }
}

fn emit_status_text(sink: CodecEventSink<'_>, from: Address, severity: u8, text: String) {
    sink(CodecEvent::StatusText { from, severity, text });
}

/// MAV_COMP_ID_CAMERA of minimal.xml; five more follow it.
const FIRST_COMPONENT: u8 = 100;
/// The system of a robot's own cameras.
const SYSTEM: u8 = 1;
/// As many cameras as MAVLink has component ids for.
const MAX_CAMERAS: usize = 6;

#[derive(Clone, Copy, Debug)]
struct Camera {
    name: ChannelName,
    takes_requests: bool,
    heartbeat: HeartbeatSource,
    lines: u64,
}

#[derive(Debug, Default)]
struct CameraTable(Vec<Camera>);

impl CameraTable {
    /// The camera with this name, its address, and whether it is new; `None` if there are too many already.
    fn get_or_insert(&mut self, name: ChannelName) -> Option<(Address, &mut Camera, bool)> {
        let known = self.0.iter().position(|camera| camera.name == name);
        let index = match known {
            Some(index) => index,
            None if self.0.len() >= MAX_CAMERAS => return None,
            None => {
                self.0.push(Camera {
                    name,
                    takes_requests: false,
                    heartbeat: HeartbeatSource::new(Heartbeat::CAMERA),
                    lines: 0,
                });
                self.0.len() - 1
            }
        };
        let camera = self.0.get_mut(index)?;
        Some((address(index), camera, known.is_none()))
    }

    fn get(&self, camera: Address) -> Option<&Camera> {
        let index = usize::from(camera.component.0.checked_sub(FIRST_COMPONENT)?);
        self.0.get(index).filter(|_| address(index) == camera)
    }

    fn source_health(&self) -> Vec<SourceHealth> {
        let cameras = self.0.iter().enumerate();
        cameras.map(|(index, camera)| SourceHealth { source: address(index), frames: camera.lines, lost: 0 }).collect()
    }
}

const fn address(index: usize) -> Address {
    Address::new(SYSTEM, FIRST_COMPONENT + index as u8)
}

/// One error reply per second and sender: a camera whose every line is wrong does not need thirty.
const ERROR_REPLY_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// When a sender was last sent an error, and the number suppressed since.
#[derive(Clone, Copy, Debug, Default)]
struct ErrorReplies {
    last: Option<Timestamp<HostClock>>,
    suppressed: u64,
}

impl ErrorReplies {
    /// The error reply for line number `line` of a sender; `None` if another one has just been sent.
    fn reply_to(&mut self, now: Timestamp<HostClock>, line: u64, flaw: &FieldError) -> Option<Vec<u8>> {
        if self.last.is_some_and(|last| now - last < ERROR_REPLY_PERIOD) {
            self.suppressed = self.suppressed.saturating_add(1);
            return None;
        }
        self.last = Some(now);
        let mut answer = json!({ "error": flaw.text, "line": line });
        if let Some(key) = flaw.key {
            answer["key"] = json!(key);
        }
        let unsaid = std::mem::take(&mut self.suppressed);
        if unsaid > 0 {
            answer["unsaid"] = json!(unsaid);
        }
        Some(encode_line(&answer))
    }
}

fn encode_line(value: &serde_json::Value) -> Vec<u8> {
    let mut line = value.to_string().into_bytes();
    line.push(b'\n');
    line
}

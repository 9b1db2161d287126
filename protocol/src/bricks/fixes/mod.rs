//! Cameras that say in lines of JSON where the robot is: a few lines of Python with any vision library.
//!
//! Gets bytes of one or many senders of a link and gives fixes, answers to time requests and signs of life; what is wrong with a line
//! goes back to who sent it. SPEC.md beside this file says what passes, docs/protocols/camera-json.md how to use it. A camera's clock is
//! its own: the session asks for it and the pipeline aligns it, as for a camera that speaks MAVLink.

mod answers;
mod cameras;
mod schema;
mod settings;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_telemetry::{Address, Audience, Defect, HostClock, PeerId, SourceHealth, Span, Stamp};

use self::answers::Complaints;
use self::cameras::{Cameras, MOST_CAMERAS};
use self::schema::{Flaw, Line, Said, SeenFix};
pub use self::settings::FixSettings;
use super::splitter::{Cut, Splitter, printable};
use super::{BrickCodec, BrickSettings, Heard, ONLY_BRICK};
use crate::dialect::ids;
use crate::framing::{Framing, ScanCounters};
use crate::message::{CommandLong, Message, TimeSync, VisionFix, WireStamp};

/// Longest line, bytes without its end: all keys with all digits take 400.
const LONGEST: usize = 1_024;
/// So many senders of a link are kept apart; the one that came first goes first.
const MOST_PEERS: usize = 64;
/// So many answers wait to be fetched; more are dropped, because complaints come again.
const MOST_ANSWERS: usize = 64;
/// So many names that mean nothing here are told.
const MOST_UNKNOWN: usize = 8;
/// MAV_SEVERITY_WARNING, _INFO.
const WARNING: u8 = 4;
const INFO: u8 = 6;
/// What a [`Defect`] calls a line, which has no number.
const LINE_ID: u32 = 0;

type Sink<'a> = dyn FnMut(Heard<'_>) + 'a;

/// The state of one link to cameras.
#[derive(Debug)]
struct Fixes {
    settings: FixSettings,
    peers: BTreeMap<PeerId, Peer>,
    cameras: Cameras,
    answers: VecDeque<(Audience, Vec<u8>)>,
    counts: ScanCounters,
    unknown: BTreeSet<String>,
    /// A bad line was quoted since the link came up.
    is_flaw_told: bool,
    is_crowd_told: bool,
    /// Fixes that were asked for.
    requests: u64,
}

/// One sender.
#[derive(Debug, Default)]
struct Peer {
    splitter: Splitter<LONGEST>,
    lines: u64,
    complaints: Complaints,
}

pub(super) fn open(settings: &BrickSettings) -> Box<dyn BrickCodec> {
    Box::new(Fixes {
        settings: settings.fixes,
        peers: BTreeMap::new(),
        cameras: Cameras::default(),
        answers: VecDeque::new(),
        counts: ScanCounters::default(),
        unknown: BTreeSet::new(),
        is_flaw_told: false,
        is_crowd_told: false,
        requests: 0,
    })
}

impl BrickCodec for Fixes {
    fn begin(&mut self, _now: Stamp<HostClock>) {
        self.peers.clear();
        self.answers.clear();
        self.is_flaw_told = false;
    }

    fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        self.push_from(now, PeerId::default(), bytes, sink);
    }

    fn push_from(&mut self, now: Stamp<HostClock>, id: PeerId, bytes: &[u8], sink: &mut dyn FnMut(Heard<'_>)) {
        // Taken out while it is read, because its lines need the rest of the state.
        let mut peer = self.peers.remove(&id).unwrap_or_default();
        let mut splitter = std::mem::take(&mut peer.splitter);
        let mut take = |cut: Cut<'_>| self.hear(now, (id, &mut peer), cut, sink);
        splitter.push(bytes, &mut take);
        if self.settings.framing == Framing::Datagram {
            splitter.finish(&mut |cut| self.hear(now, (id, &mut peer), cut, sink));
        }
        peer.splitter = splitter;
        if self.peers.len() >= MOST_PEERS {
            self.peers.pop_first();
        }
        self.peers.insert(id, peer);
    }

    fn deadline(&self) -> Option<Stamp<HostClock>> {
        // Half a line waits for its end; its length is limited.
        None
    }

    fn tick(&mut self, _now: Stamp<HostClock>, _sink: &mut dyn FnMut(Heard<'_>)) {}

    fn poll(&mut self) -> Option<Vec<u8>> {
        self.poll_to().map(|(_, bytes)| bytes)
    }

    fn poll_to(&mut self) -> Option<(Audience, Vec<u8>)> {
        self.answers.pop_front()
    }

    fn encode(&mut self, _now: Stamp<HostClock>, _from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "a camera is told nothing but questions, however many kinds of message there are"
        )]
        let line = match message {
            Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, .. }) => answers::time_request(*request_nanos),
            Message::Command(command) => match self.fix_request(command) {
                Some(line) => line,
                None => return 0,
            },
            _ => return 0,
        };
        out.extend_from_slice(&line);
        line.len()
    }

    fn counters(&self) -> ScanCounters {
        self.counts
    }

    fn sources(&self) -> Vec<SourceHealth> {
        self.cameras.sources()
    }
}

impl Fixes {
    fn hear(&mut self, now: Stamp<HostClock>, (id, peer): (PeerId, &mut Peer), cut: Cut<'_>, sink: &mut Sink<'_>) {
        peer.lines += 1;
        let (line, flaw) = match cut {
            Cut::Line(line) => {
                let heard = schema::read(line).and_then(|said| self.take(now, &said, sink));
                let Err(flaw) = heard else {
                    return;
                };
                (line, flaw)
            }
            Cut::TooLong(bytes) => {
                let text = format!("a line of {bytes} bytes is longer than {LONGEST}");
                self.count_garbage(bytes, sink);
                (&[][..], Flaw::whole(text))
            }
        };
        self.count_flaw(line, &flaw, sink);
        let answer = peer.complaints.about(now, peer.lines, &flaw);
        if self.answers.len() < MOST_ANSWERS {
            let to = Audience::Peer(id);
            self.answers.extend(answer.map(|answer| (to, answer)));
        }
        if !std::mem::replace(&mut self.is_flaw_told, true) {
            let quoted = printable(line);
            let text = format!("line {} `{quoted}`: {}", peer.lines, flaw.text);
            tell(sink, ONLY_BRICK, WARNING, text);
        }
    }

    /// Acts on what a line says.
    fn take(&mut self, now: Stamp<HostClock>, line: &Line, sink: &mut Sink<'_>) -> Result<(), Flaw> {
        let Some((from, camera, is_new)) = self.cameras.named(line.camera) else {
            if !std::mem::replace(&mut self.is_crowd_told, true) {
                let text = format!("there are more than {MOST_CAMERAS} cameras on one link");
                tell(sink, ONLY_BRICK, WARNING, text);
            }
            return Err(Flaw {
                key: Some("camera"),
                text: format!("`camera` is one more than the {MOST_CAMERAS} of a link"),
            });
        };
        camera.lines += 1;
        camera.takes_requests = line.takes_requests.unwrap_or(camera.takes_requests);
        let pulse = camera.pulse.heard(now);
        self.counts.frames += 1;
        if is_new {
            let text = format!("camera `{}` is {from} here", line.camera);
            tell(sink, from, INFO, text);
        }
        if let Some(message) = pulse {
            sink(Heard::Message { from, message });
        }
        self.tell_unknown(from, &line.unknown, sink);
        match line.said {
            Said::Fix(fix) => self.say_fix(now, from, &fix, sink),
            Said::Time { request, nanos } => {
                let answer = TimeSync {
                    // Zero would make a request of it.
                    answer_nanos: nanos.max(1),
                    request_nanos: request,
                    target: None,
                };
                let message = Message::TimeSync(answer);
                sink(Heard::Message { from, message });
            }
            Said::Hello => {}
        }
        Ok(())
    }

    fn say_fix(&self, now: Stamp<HostClock>, from: Address, fix: &SeenFix, sink: &mut Sink<'_>) {
        if fix.quality.is_some_and(|quality| quality < self.settings.least_quality) {
            // Good to know and no flaw of the line: it is counted, and not used.
            let message_id = ids::VISION_POSITION_ESTIMATE;
            sink(Heard::Defect(Defect::Payload { message_id }));
            return;
        }
        let latest = now - (self.settings.delay - self.settings.delay_spread).max(Span::ZERO);
        let stamp = match fix.exposed_micros {
            Some(micros) => WireStamp::Micros64(micros),
            None => WireStamp::Asked { sent: now - self.settings.delay - self.settings.delay_spread, answered: latest },
        };
        let message = Message::VisionPosition(VisionFix {
            stamp,
            x: fix.x,
            y: fix.y,
            heading: fix.heading,
            covariance: fix.covariance,
            reset_counter: fix.reset_counter,
        });
        sink(Heard::Message { from, message });
    }

    /// One word about each key that means nothing here.
    fn tell_unknown(&mut self, from: Address, unknown: &[String], sink: &mut Sink<'_>) {
        for key in unknown {
            if self.unknown.len() < MOST_UNKNOWN && self.unknown.insert(key.clone()) {
                tell(sink, from, INFO, format!("the camera's `{key}` is not used"));
            }
        }
    }

    /// The question for a fix, if a camera takes it.
    fn fix_request(&mut self, command: &CommandLong) -> Option<Vec<u8>> {
        let is_for_fix = command.command == ids::COMMAND_REQUEST_MESSAGE
            && command.params[0] == ids::VISION_POSITION_ESTIMATE as f32;
        let camera = self.cameras.at(command.target)?;
        if !is_for_fix || !camera.takes_requests {
            return None;
        }
        self.requests += 1;
        Some(answers::fix_request(camera.name, self.requests))
    }

    fn count_flaw(&mut self, line: &[u8], flaw: &Flaw, sink: &mut Sink<'_>) {
        if flaw.key.is_some() {
            let message_id = LINE_ID;
            sink(Heard::Defect(Defect::Payload { message_id }));
        } else if !line.is_empty() {
            self.count_garbage(line.len() as u32, sink);
        }
    }

    fn count_garbage(&mut self, bytes: u32, sink: &mut Sink<'_>) {
        self.counts.garbage_bytes += u64::from(bytes);
        sink(Heard::Defect(Defect::Garbage { bytes }));
    }
}

fn tell(sink: &mut Sink<'_>, from: Address, severity: u8, text: String) {
    sink(Heard::Note { from, severity, text });
}

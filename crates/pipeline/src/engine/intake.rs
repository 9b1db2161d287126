//! Bytes to messages: what came by one way, as far as whom it comes from and what it says.
//!
//! Everything that is found in the bytes is first judged (signature, filter, copy, echo) and passed on; only then does the engine
//! act on what it says, because that needs the whole pipeline and not this link alone.

use posebridge_protocol::dialect;
use posebridge_protocol::framing::{FrameRef, Scanned};
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{Occurrence, Way};
use posebridge_telemetry::{Address, Defect, Event, HostClock, LinkId, PeerId, Refusal, Stamp};

use super::bricks::Noted;
use super::forward::{Passage, sharing_of};
use super::{Pipeline, SEVERITY_WARNING};
use crate::peers::Believed;

/// How something came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// By which way.
    pub(super) way: Way,
    /// When its last byte was there. That may be before the pipeline's present, if it waited for its turn.
    pub(super) at: Stamp<HostClock>,
}

/// What a peer's scanner is told.
#[derive(Clone, Copy, Debug)]
pub(super) enum Came<'a> {
    /// Bytes.
    Bytes(&'a [u8]),
    /// Nothing, for as long as a frame is waited for.
    Gap,
    /// The end of the link: what waits is never completed.
    End,
}

/// A message that came, with its sender.
pub(super) struct Arrived {
    pub(super) source: Address,
    pub(super) occurrence: Occurrence,
    pub(super) message: Message,
}

/// What is found in one input's bytes.
struct Intake<'a> {
    link: LinkId,
    passage: Passage<'a>,
    refused_frames: u64,
    arrived: Vec<Arrived>,
    events: Vec<Event>,
    /// What is wrong with payloads, in words: who sent it, which message.
    complaints: Vec<(Address, u32, String)>,
}

/// So many senders and messages are told of.
const MOST_COMPLAINTS: usize = 64;

impl Pipeline {
    /// What came of one peer of a link at `at`.
    pub(super) fn handle_bytes(&mut self, at: Stamp<HostClock>, (id, peer): (LinkId, PeerId), came: Came<'_>) {
        let now = self.now;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if let Came::Bytes(bytes) = came {
            link.health.bytes_in += bytes.len() as u64;
        }
        if let Some(codec) = &mut link.codec {
            if let Came::Bytes(bytes) = came {
                let mut noted = Noted::default();
                codec.push_from(now, peer, bytes, &mut |heard| noted.take(heard));
                self.hear_brick(Arrival { way: Way { link: id, peer }, at }, noted);
            }
            return;
        }
        let way = Way { link: id, peer };
        let sharing = sharing_of(link, peer, now);
        let voice = link.voice.as_ref();
        let mut intake = Intake {
            link: id,
            passage: Passage::new(&mut self.router, now, way, sharing, voice),
            refused_frames: 0,
            arrived: std::mem::take(&mut self.spare),
            events: Vec::new(),
            complaints: Vec::new(),
        };
        let mut sink = |scanned: Scanned<'_>, verdict: Result<_, Refusal>| intake.take(scanned, verdict);
        match came {
            Came::Bytes(bytes) => link.peers.push(now, peer, bytes, &mut sink),
            Came::Gap => link.peers.give_up(now, peer, &mut sink),
            Came::End => link.peers.end(now, peer, &mut sink),
        }
        link.health.refused_frames += intake.refused_frames;
        let (mut arrived, events, complaints) = (intake.arrived, intake.events, intake.complaints);
        let seen = intake.passage.finish();
        if seen.is_something() {
            self.passages.push((id, seen));
        }
        for event in events {
            self.outputs.tell(event);
        }
        for complaint in complaints {
            self.complain(id, complaint);
        }
        for message in arrived.drain(..) {
            self.handle_message(Arrival { way, at }, &message);
        }
        // Its room is used again.
        self.spare = arrived;
    }

    /// Tells once why the payloads of a sender's message make no sense; each of them is counted as a defect.
    fn complain(&mut self, link: LinkId, (source, message_id, text): (Address, u32, String)) {
        let told = &mut self.told_payloads;
        if told.len() < MOST_COMPLAINTS && told.insert((link, source, message_id)) {
            self.tell(Event::Text { source, severity: SEVERITY_WARNING, text });
        }
    }
}

impl Intake<'_> {
    /// Takes one find, with what is known of its sender or why it must not be believed.
    fn take(&mut self, scanned: Scanned<'_>, verdict: Result<Believed, Refusal>) {
        match (scanned, verdict) {
            (Scanned::Frame(frame) | Scanned::Unknown(frame), Err(reason)) => {
                self.refused_frames += 1;
                let source = frame.source;
                self.tell(Defect::Refused { source, reason });
            }
            (Scanned::Frame(frame), Ok(Believed { check, missing })) => {
                if missing > 0 {
                    self.tell(Defect::Lost { source: frame.source, frames: missing });
                }
                match self.passage.take(&frame, check) {
                    Some(Occurrence::Namesake) => self.tell(Defect::Namesake { message_id: frame.message_id }),
                    // What the station said itself is no news, least of all its own estimate.
                    None | Some(Occurrence::Echo) => {}
                    Some(occurrence) => self.read(&frame, occurrence),
                }
            }
            (Scanned::Unknown(frame), Ok(Believed { check, .. })) => {
                self.passage.take(&frame, check);
            }
            (Scanned::Defect(defect), _) => self.tell(defect),
        }
    }

    fn read(&mut self, frame: &FrameRef<'_>, occurrence: Occurrence) {
        match dialect::decode(frame) {
            Ok(Some(message)) => self.arrived.push(Arrived { source: frame.source, occurrence, message }),
            Ok(None) => {}
            Err(error) => {
                let message_id = error.message_id();
                self.tell(Defect::Payload { message_id });
                let complaint = (frame.source, message_id, error.to_string());
                self.complaints.push(complaint);
            }
        }
    }

    fn tell(&mut self, defect: Defect) {
        let link = self.link;
        self.events.push(Event::Defect { link, defect });
    }
}

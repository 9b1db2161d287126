//! Bytes to messages: what came by one way, as far as whom it comes from and what it says.
//!
//! Everything that is found in the bytes is first judged (signature, filter, copy, echo) and passed on; only then does the engine
//! act on what it says, because that needs the whole pipeline and not this link alone.

use posebridge_protocol::dialect;
use posebridge_protocol::framing::{FrameRef, Scanned};
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{Occurrence, Way};
use posebridge_telemetry::{
    Address, Defect, Event, HostClock, LinkId, Output, PeerId, Refusal, Stamp,
};

use super::Pipeline;
use super::bricks::Noted;
use super::forward::Passage;
use crate::peers::Believed;

/// How something came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    /// By which way.
    pub(super) way: Way,
    /// When its last byte was there. That may be before the pipeline's present, if it waited for its turn.
    pub(super) at: Stamp<HostClock>,
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
}

impl Pipeline {
    /// Bytes of one peer of a link that came at `at`; `None` gives up what waits of it.
    pub(super) fn handle_bytes(
        &mut self,
        at: Stamp<HostClock>,
        (id, peer): (LinkId, PeerId),
        bytes: Option<&[u8]>,
    ) {
        let now = self.now;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if let Some(bytes) = bytes {
            link.health.bytes_in += bytes.len() as u64;
        }
        if let Some(codec) = &mut link.codec {
            if let Some(bytes) = bytes {
                let mut noted = Noted::default();
                codec.push(now, bytes, &mut |heard| noted.take(heard));
                self.hear_brick(
                    Arrival {
                        way: Way { link: id, peer },
                        at,
                    },
                    noted,
                );
            }
            return;
        }
        let way = Way { link: id, peer };
        let mut intake = Intake {
            link: id,
            passage: Passage::new(&mut self.router, now, way, link),
            refused_frames: 0,
            arrived: Vec::new(),
            events: Vec::new(),
        };
        let mut sink =
            |scanned: Scanned<'_>, verdict: Result<_, Refusal>| intake.take(scanned, verdict);
        match bytes {
            Some(bytes) => link.peers.push(now, peer, bytes, &mut sink),
            None => link.peers.give_up(now, peer, &mut sink),
        }
        link.health.refused_frames += intake.refused_frames;
        let (arrived, events) = (intake.arrived, intake.events);
        self.passages.push((id, intake.passage.finish()));
        self.outputs.extend(events.into_iter().map(Output::Event));
        for message in arrived {
            self.handle_message(Arrival { way, at }, &message);
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
                    self.tell(Defect::Lost {
                        source: frame.source,
                        frames: missing,
                    });
                }
                match self.passage.take(&frame, check) {
                    Some(Occurrence::Namesake) => self.tell(Defect::Namesake {
                        message_id: frame.message_id,
                    }),
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
            Ok(Some(message)) => self.arrived.push(Arrived {
                source: frame.source,
                occurrence,
                message,
            }),
            Ok(None) => {}
            Err(error) => self.tell(Defect::Payload {
                message_id: error.message_id(),
            }),
        }
    }

    fn tell(&mut self, defect: Defect) {
        let link = self.link;
        self.events.push(Event::Defect { link, defect });
    }
}

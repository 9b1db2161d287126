//! Frames of others on their way through: who is believed, what has come before, and what leaves on which link.
//!
//! Decisions about destinations are the router's ([`posebridge_protocol::routing`]); here they meet the links: whether a link
//! is up, has a second peer, speaks the frame's version, and has room. The bytes are passed on as they came.

use posebridge_protocol::dialect::{self, ids, is_signed};
use posebridge_protocol::framing::{FrameRef, WireVersion};
use posebridge_protocol::routing::{Check, Occurrence, Router, Sender, Sharing, Way, priority_of};
use posebridge_telemetry::{Address, Audience, HostClock, LinkId, LinkState, Output, PeerId, Priority, Stamp};

use super::Pipeline;
use crate::link_state::Link;
use crate::robot_voice::RobotVoice;

/// Looks at the frames of one input as they are found, and keeps those that go on.
pub(super) struct Passage<'a> {
    router: &'a mut Router,
    now: Stamp<HostClock>,
    from: Way,
    sharing: Sharing,
    /// The robot's voice on the link, which may have to answer a command in its place.
    voice: Option<&'a RobotVoice>,
    seen: Seen,
}

/// What a passage leaves behind.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// Frames that the inward filter kept out.
    filtered: u64,
    /// Frames that had come before by another way.
    duplicates: u64,
    /// Frames under the station's own address that it has not said.
    namesakes: u64,
    passed: Vec<Passed>,
}

/// A frame that goes on.
#[derive(Debug)]
pub(super) struct Passed {
    pub(super) message_id: u32,
    pub(super) source: Address,
    pub(super) sequence: u8,
    pub(super) is_signed: bool,
    version: WireVersion,
    pub(super) priority: Priority,
    /// By which way it came.
    pub(super) from: Way,
    to: Vec<(LinkId, Audience)>,
    pub(super) bytes: Vec<u8>,
}

impl Seen {
    /// Whether there is anything to be done about it.
    pub(super) const fn is_something(&self) -> bool {
        self.filtered > 0 || self.duplicates > 0 || self.namesakes > 0 || !self.passed.is_empty()
    }
}

/// Whether a peer has a link for itself.
pub(super) fn sharing_of(link: &Link, peer: PeerId, now: Stamp<HostClock>) -> Sharing {
    let told = link.health.port.peers;
    if link.peers.has_other_than(peer, now, told) { Sharing::Shared } else { Sharing::Alone }
}

impl<'a> Passage<'a> {
    /// A passage of what comes by one way at `now`; `voice` is the robot's on the link that it comes by.
    pub(super) fn new(
        router: &'a mut Router,
        now: Stamp<HostClock>,
        from: Way,
        sharing: Sharing,
        voice: Option<&'a RobotVoice>,
    ) -> Self {
        Self { router, now, from, sharing, voice, seen: Seen::default() }
    }

    /// What it leaves behind.
    pub(super) fn finish(self) -> Seen {
        self.seen
    }

    /// Takes a frame: whether it has come before, or `None` if it must not be believed.
    pub(super) fn take(&mut self, frame: &FrameRef<'_>, check: Check) -> Option<Occurrence> {
        if !self.router.admits(self.from.link, frame) {
            self.seen.filtered += 1;
            return None;
        }
        let sharing = self.sharing;
        let sender = Sender { check, sharing };
        let mut routed = self.router.route(self.now, self.from, frame, sender);
        match routed.occurrence {
            Occurrence::Redundant | Occurrence::Detour => self.seen.duplicates += 1,
            Occurrence::Namesake => self.seen.namesakes += 1,
            Occurrence::First | Occurrence::Echo => {}
        }
        if self.is_answered_here(frame) {
            routed.to.clear();
        }
        if !routed.to.is_empty() {
            self.seen.passed.push(Passed {
                message_id: frame.message_id,
                source: frame.source,
                sequence: frame.sequence,
                is_signed: is_signed(frame.raw),
                from: self.from,
                version: frame.version,
                priority: priority_of(frame),
                to: routed.to,
                bytes: frame.raw.to_vec(),
            });
        }
        Some(routed.occurrence)
    }

    /// Whether a frame commands the robot what the station does in its name.
    fn is_answered_here(&self, frame: &FrameRef<'_>) -> bool {
        let is_command = matches!(frame.message_id, ids::COMMAND_LONG | ids::COMMAND_INT);
        let Some(voice) = self.voice.filter(|_| is_command) else {
            return false;
        };
        let message = dialect::decode(frame).ok().flatten();
        message.is_some_and(|message| voice.takes(self.now, &message))
    }
}

impl Pipeline {
    /// Counts what was seen on a link and sends on what goes on.
    pub(super) fn finish_passage(&mut self, now: Stamp<HostClock>, id: LinkId, seen: &Seen) {
        if let Some(link) = self.links.get_mut(&id) {
            link.health.filtered += seen.filtered;
            link.health.duplicates += seen.duplicates;
            link.health.namesakes += seen.namesakes;
        }
        for frame in &seen.passed {
            for of_link in frame.to.chunk_by(|one, next| one.0 == next.0) {
                self.pass_on(now, of_link, frame);
            }
        }
    }

    /// Sends a frame to whom it is for on one link; it is limited and paid for once, as if it were for all of them.
    fn pass_on(&mut self, now: Stamp<HostClock>, to: &[(LinkId, Audience)], frame: &Passed) {
        let Some((id, link)) = to.first().and_then(|(id, _)| Some((*id, self.links.get_mut(id)?))) else {
            return;
        };
        let is_foreign = link.speaks == WireVersion::V1 && frame.version == WireVersion::V2;
        if link.state == LinkState::Down || is_foreign {
            link.health.drops_out += 1;
            return;
        }
        let length = frame.bytes.len();
        if frame.priority == Priority::Command {
            link.limiter.charge(now, length);
        } else if !link.limiter.admits(now, frame.source, frame.message_id, length) {
            link.health.thinned += 1;
            return;
        }
        if self.pass_on_counted(id, frame) {
            return;
        }
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        for (_, to) in to {
            link.health.bytes_out += length as u64;
            link.health.frames_out += 1;
            link.health.forwarded += 1;
            self.passed_on.push_back(Output::Transmit {
                link: id,
                to: *to,
                priority: frame.priority,
                bytes: frame.bytes.clone(),
            });
        }
    }
}

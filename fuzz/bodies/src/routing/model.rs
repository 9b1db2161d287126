//! What a router must do, in the plainest form: everything is remembered, by its bytes.
//!
//! Source: the model at the head of `protocol::routing`, and docs/routing.md.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::framing::{FrameRef, WireVersion};
use posebridge_protocol::routing::{
    Check, Forward, LinkRules, Occurrence, Routed, RouterConfig, Target, Way, is_stamped, target_of,
};
use posebridge_telemetry::{Address, Audience, HostClock, LinkId, Span, Stamp};

/// Ways that a router remembers.
pub(super) const MOST_ROUTES: usize = 4_096;
/// Who was not heard by a way for longer than this is not there any more.
const LIFETIME: Span = Span::from_millis(30_000);

/// By what a frame is known again.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Mark {
    Bytes(Vec<u8>),
    Content(u16, Address, u32, Vec<u8>),
}

/// By what the station knows its own words: checksum, sequence number, lowest byte of the message id.
type OwnMark = ([u8; 2], u8, u8);

fn own_mark(frame: &FrameRef<'_>) -> OwnMark {
    let header = match frame.version {
        WireVersion::V2 => 10,
        WireVersion::V1 => 6,
    };
    let end = header + frame.payload.len();
    let checksum = [frame.raw[end], frame.raw[end + 1]];
    (checksum, frame.sequence, frame.message_id.to_le_bytes()[0])
}

/// Everything that was heard.
pub(super) struct Model {
    config: RouterConfig,
    heard: BTreeMap<(Address, Way), Stamp<HostClock>>,
    noted: BTreeMap<Mark, (Stamp<HostClock>, Way)>,
    /// What the station has said itself, by its marks.
    said: BTreeSet<OwnMark>,
    /// More was heard than a router remembers: it may know less than this model.
    is_beyond: bool,
}

impl Model {
    pub(super) fn new(config: RouterConfig) -> Self {
        Self { config, heard: BTreeMap::new(), noted: BTreeMap::new(), said: BTreeSet::new(), is_beyond: false }
    }

    /// Whether a router does exactly what this model says. If not, it sends to some of the ways that this model gives, because the
    /// oldest have made room, and it may know a system of which it does not know the component any more.
    pub(super) const fn is_exact(&self) -> bool {
        !self.is_beyond
    }

    pub(super) fn forget(&mut self, link: LinkId) {
        self.heard.retain(|(_, way), _| way.link != link);
    }

    pub(super) fn say(&mut self, frame: &FrameRef<'_>) {
        self.said.insert(own_mark(frame));
    }

    pub(super) fn route(&mut self, now: Stamp<HostClock>, from: Way, frame: &FrameRef<'_>, check: Check) -> Routed {
        let occurrence = self.note(now, from, frame, check);
        let is_ours = frame.source == self.config.own;
        let to =
            if is_ours || occurrence != Occurrence::First { Vec::new() } else { self.destinations(now, from, frame) };
        Routed { occurrence, to }
    }

    /// Remembers a frame and says whether it came before.
    fn note(&mut self, now: Stamp<HostClock>, from: Way, frame: &FrameRef<'_>, check: Check) -> Occurrence {
        if frame.source == self.config.own {
            return if self.said.contains(&own_mark(frame)) { Occurrence::Echo } else { Occurrence::Namesake };
        }
        let mut marks = vec![Mark::Bytes(frame.raw.to_vec())];
        if let (Some(group), true) = (self.group(from.link), is_stamped(frame.message_id)) {
            let mut payload = frame.payload.to_vec();
            while payload.last() == Some(&0) {
                payload.pop();
            }
            marks.push(Mark::Content(group, frame.source, frame.message_id, payload));
        }
        let mut firsts = Vec::new();
        for mark in marks {
            let before = self.noted.get(&mark).copied();
            match before.filter(|(at, way)| now - *at < self.config.duplicate_window && *way != from) {
                Some((_, way)) => firsts.push(way),
                None => drop(self.noted.insert(mark, (now, from))),
            }
        }
        let is_redundant = |first: &Way| self.is_one(first.link, from.link);
        let occurrence = if firsts.is_empty() {
            Occurrence::First
        } else if firsts.iter().any(is_redundant) {
            Occurrence::Redundant
        } else {
            Occurrence::Detour
        };
        if check == Check::Verified && occurrence != Occurrence::Detour {
            self.hear(now, frame.source, from);
        }
        occurrence
    }

    /// Somebody was heard by a way.
    pub(super) fn hear(&mut self, now: Stamp<HostClock>, source: Address, from: Way) {
        self.heard.insert((source, from), now);
        self.is_beyond |= self.heard.len() >= MOST_ROUTES;
    }

    fn destinations(&self, now: Stamp<HostClock>, from: Way, frame: &FrameRef<'_>) -> Vec<(LinkId, Audience)> {
        let target = target_of(frame.message_id, frame.payload);
        let own = self.config.own;
        let all: Vec<(LinkId, Audience)> = match target {
            Target::Everybody => {
                let links = self.config.links.keys();
                links
                    .filter_map(|link| match *link {
                        link if link == from.link => Some((link, Audience::AllBut(from.peer))),
                        link => (!self.is_one(link, from.link)).then_some((link, Audience::All)),
                    })
                    .collect()
            }
            Target::Component(address) if address == own => Vec::new(),
            Target::System(system) => self.ways_to(now, from, |other| other.system == system),
            Target::Component(address) => {
                let is_heard = |(other, _): &(Address, Way)| *other == address;
                let mut known = self.heard.iter().filter(|(_, at)| now - **at <= LIFETIME);
                if self.is_exact() && known.any(|(key, _)| is_heard(key)) {
                    self.ways_to(now, from, |other| other == address)
                } else if self.is_exact() && address.system == own.system {
                    Vec::new()
                } else {
                    self.ways_to(now, from, |other| other.system == address.system)
                }
            }
        };
        let leaves = self.rules(from.link).is_none_or(|rules| rules.forward != Forward::Nothing);
        all.into_iter().filter(|(link, _)| leaves && self.may_leave(*link, target, frame)).collect()
    }

    /// By rising link and peer, each once.
    fn ways_to(
        &self,
        now: Stamp<HostClock>,
        from: Way,
        is_wanted: impl Fn(Address) -> bool,
    ) -> Vec<(LinkId, Audience)> {
        let mut ways: Vec<Way> = self
            .heard
            .iter()
            .filter(|((address, _), at)| is_wanted(*address) && now - **at <= LIFETIME)
            .map(|((_, way), _)| *way)
            .filter(|way| *way != from)
            .filter(|way| way.link == from.link || !self.is_one(way.link, from.link))
            .collect();
        ways.sort_unstable();
        ways.dedup();
        ways.into_iter().map(|way| (way.link, Audience::Peer(way.peer))).collect()
    }

    fn may_leave(&self, link: LinkId, target: Target, frame: &FrameRef<'_>) -> bool {
        self.rules(link).is_some_and(|rules| {
            let is_wanted = match rules.forward {
                Forward::All => true,
                Forward::Targeted => target != Target::Everybody,
                Forward::Nothing => false,
            };
            is_wanted && rules.outward.admits(frame.source, frame.message_id)
        })
    }

    fn rules(&self, link: LinkId) -> Option<&LinkRules> {
        self.config.links.get(&link)
    }

    fn group(&self, link: LinkId) -> Option<u16> {
        self.rules(link)?.group
    }

    /// The same link, or one of the same group.
    fn is_one(&self, a: LinkId, b: LinkId) -> bool {
        a == b || (self.group(a).is_some() && self.group(a) == self.group(b))
    }
}

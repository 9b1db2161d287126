//! The behaviour of a router in the plainest form: all frames are stored by their bytes.
//!
//! Source: the model in `protocol::routing`, and docs/routing.md.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::dialect::message_name;
use posebridge_protocol::framing::{FrameRef, WireVersion};
use posebridge_protocol::routing::{
    DuplicateStatus, Endpoint, ForwardPolicy, ForwardedDialects, LinkRules, MessageTarget, RouterConfig,
    RoutingDecision, SenderCheck, has_timestamp, target_of,
};
use posebridge_telemetry::{Address, HostClock, LinkId, Recipients, TimeDelta, Timestamp};

/// Ways that a router remembers.
pub(super) const MAX_ROUTES: usize = 4_096;
/// Who was not heard by a way for longer than this is not there any more.
const LIFETIME: TimeDelta = TimeDelta::from_millis(30_000);

/// By what a frame is known again.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum FrameMark {
    Bytes(Vec<u8>),
    Content(u16, Address, u32, Vec<u8>),
}

/// By what the station knows its own words: checksum, sequence number, lowest byte of the message id.
type SentFrameMark = ([u8; 2], u8, u8);

fn sent_frame_mark(frame: &FrameRef<'_>) -> SentFrameMark {
    let header = match frame.version {
        WireVersion::V2 => 10,
        WireVersion::V1 => 6,
    };
    let end = header + frame.payload.len();
    let checksum = [frame.raw[end], frame.raw[end + 1]];
    (checksum, frame.sequence, frame.message_id.to_le_bytes()[0])
}

/// Everything that was heard.
pub(super) struct RouterModel {
    config: RouterConfig,
    routes: BTreeMap<(Address, Endpoint), Timestamp<HostClock>>,
    recent_frames: BTreeMap<FrameMark, (Timestamp<HostClock>, Endpoint)>,
    /// What the station has said itself, by its marks.
    sent_frames: BTreeSet<SentFrameMark>,
    /// More was heard than a router remembers: it may know less than this model.
    is_beyond: bool,
}

impl RouterModel {
    pub(super) fn new(config: RouterConfig) -> Self {
        Self {
            config,
            routes: BTreeMap::new(),
            recent_frames: BTreeMap::new(),
            sent_frames: BTreeSet::new(),
            is_beyond: false,
        }
    }

    /// Whether a router does exactly what this model says. If not, it sends to some of the ways that this model gives, because the
    /// oldest have made room, and it may know a system of which it does not know the component any more.
    pub(super) const fn is_exact(&self) -> bool {
        !self.is_beyond
    }

    pub(super) fn forget(&mut self, link: LinkId) {
        self.routes.retain(|(_, way), _| way.link != link);
    }

    pub(super) fn record_sent(&mut self, frame: &FrameRef<'_>) {
        self.sent_frames.insert(sent_frame_mark(frame));
    }

    pub(super) fn route(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
        check: SenderCheck,
    ) -> RoutingDecision {
        let occurrence = self.check_duplicate(now, from, frame, check);
        let is_ours = frame.source == self.config.own;
        let to = if is_ours || occurrence != DuplicateStatus::New {
            Vec::new()
        } else {
            self.destinations(now, from, frame)
        };
        RoutingDecision { duplicate_status: occurrence, to }
    }

    /// Remembers a frame and says whether it came before.
    fn check_duplicate(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
        check: SenderCheck,
    ) -> DuplicateStatus {
        if frame.source == self.config.own {
            return if self.sent_frames.contains(&sent_frame_mark(frame)) {
                DuplicateStatus::Echo
            } else {
                DuplicateStatus::AddressConflict
            };
        }
        let mut marks = vec![FrameMark::Bytes(frame.raw.to_vec())];
        if let (Some(group), true) = (self.group(from.link), has_timestamp(frame.message_id)) {
            let mut payload = frame.payload.to_vec();
            while payload.last() == Some(&0) {
                payload.pop();
            }
            marks.push(FrameMark::Content(group, frame.source, frame.message_id, payload));
        }
        let mut firsts = Vec::new();
        for mark in marks {
            let before = self.recent_frames.get(&mark).copied();
            match before.filter(|(at, way)| now - *at < self.config.duplicate_window && *way != from) {
                Some((_, way)) => firsts.push(way),
                None => drop(self.recent_frames.insert(mark, (now, from))),
            }
        }
        let is_redundant = |first: &Endpoint| self.same_group(first.link, from.link);
        let occurrence = if firsts.is_empty() {
            DuplicateStatus::New
        } else if firsts.iter().any(is_redundant) {
            DuplicateStatus::Duplicate
        } else {
            DuplicateStatus::Loop
        };
        if check == SenderCheck::Verified && occurrence != DuplicateStatus::Loop {
            self.learn_route(now, frame.source, from);
        }
        occurrence
    }

    /// Somebody was heard by a way.
    pub(super) fn learn_route(&mut self, now: Timestamp<HostClock>, source: Address, from: Endpoint) {
        self.routes.insert((source, from), now);
        self.is_beyond |= self.routes.len() >= MAX_ROUTES;
    }

    fn destinations(
        &self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
    ) -> Vec<(LinkId, Recipients)> {
        let target = target_of(frame.message_id, frame.payload);
        let own = self.config.own;
        let all: Vec<(LinkId, Recipients)> = match target {
            MessageTarget::Broadcast => {
                let links = self.config.links.keys();
                links
                    .filter_map(|link| match *link {
                        link if link == from.link => Some((link, Recipients::AllExcept(from.peer))),
                        link => (!self.same_group(link, from.link)).then_some((link, Recipients::All)),
                    })
                    .collect()
            }
            MessageTarget::Component(address) if address == own => Vec::new(),
            MessageTarget::System(system) => self.endpoints_of(now, from, |other| other.system == system),
            MessageTarget::Component(address) => {
                let is_heard = |(other, _): &(Address, Endpoint)| *other == address;
                let mut known = self.routes.iter().filter(|(_, at)| now - **at <= LIFETIME);
                if self.is_exact() && known.any(|(key, _)| is_heard(key)) {
                    self.endpoints_of(now, from, |other| other == address)
                } else if self.is_exact() && address.system == own.system {
                    Vec::new()
                } else {
                    self.endpoints_of(now, from, |other| other.system == address.system)
                }
            }
        };
        let leaves = self.rules(from.link).is_none_or(|rules| rules.forward != ForwardPolicy::Disabled);
        all.into_iter().filter(|(link, _)| leaves && self.may_leave(*link, target, frame)).collect()
    }

    /// By rising link and peer, each once.
    fn endpoints_of(
        &self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        is_wanted: impl Fn(Address) -> bool,
    ) -> Vec<(LinkId, Recipients)> {
        let mut ways: Vec<Endpoint> = self
            .routes
            .iter()
            .filter(|((address, _), at)| is_wanted(*address) && now - **at <= LIFETIME)
            .map(|((_, way), _)| *way)
            .filter(|way| *way != from)
            .filter(|way| way.link == from.link || !self.same_group(way.link, from.link))
            .collect();
        ways.sort_unstable();
        ways.dedup();
        ways.into_iter().map(|way| (way.link, Recipients::Peer(way.peer))).collect()
    }

    fn may_leave(&self, link: LinkId, target: MessageTarget, frame: &FrameRef<'_>) -> bool {
        self.rules(link).is_some_and(|rules| {
            let is_wanted = match rules.forward {
                ForwardPolicy::All | ForwardPolicy::ByRole => true,
                ForwardPolicy::Targeted => target != MessageTarget::Broadcast,
                ForwardPolicy::Disabled => false,
            };
            let is_known_there = match rules.dialects {
                ForwardedDialects::All => true,
                ForwardedDialects::Stock => {
                    message_name(frame.message_id).is_some_and(|name| !name.starts_with("PB_"))
                        || rules.outward.messages.allow.contains(&frame.message_id)
                }
            };
            is_wanted && is_known_there && rules.outward.admits(frame.source, frame.message_id)
        })
    }

    fn rules(&self, link: LinkId) -> Option<&LinkRules> {
        self.config.links.get(&link)
    }

    fn group(&self, link: LinkId) -> Option<u16> {
        self.rules(link)?.group
    }

    /// The same link, or one of the same group.
    fn same_group(&self, a: LinkId, b: LinkId) -> bool {
        a == b || (self.group(a).is_some() && self.group(a) == self.group(b))
    }
}

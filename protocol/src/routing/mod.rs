//! Whom a frame is passed on to: a station between several links is also a router.
//!
//! Gets the frames that [`crate::framing`] finds, with the endpoint by which each came, and says to which links and peers it goes
//! on. It is a value: it sends nothing, reads no clock and changes no byte. Which frames are used is not decided here, except
//! that a frame that came before from another endpoint is distinguished from a new one ([`DuplicateStatus`]).
//!
//! # Model
//! ```text
//! target          0, none, or message id unknown    every other link, and the other peers of the same link
//! system s        s ≠ own, or component 0           the endpoints by which s was heard
//! component s/c   heard                             the endpoints by which s/c was heard
//! component s/c   not heard, s ≠ own                the endpoints by which s was heard
//! component s/c   not heard, s = own                nobody; nor anybody for the station's own address
//! ```
//! Never back to the endpoint that it came from, and never to another link of the same group: those lead to the same robot. Every
//! rule of the links (whether to forward at all, filters) is applied on top.
//!
//! # Sources
//! MAVLink guide, "Routing": broadcasts go everywhere, targeted messages only to known destinations, unknown messages are
//! forwarded like broadcasts.

mod duplicates;
mod endpoints;
mod rules;

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, HostClock, LinkId, Priority, Recipients, TimeDelta, Timestamp};

pub use duplicates::has_timestamp;
pub use endpoints::{Endpoint, MAX_PEERS, MessageTarget, retarget, target_of};
pub use rules::{AllowBlockList, ForwardPolicy, FrameFilter, LinkRateLimiter, LinkRules, RateLimits, message_id_named};

use self::duplicates::{DuplicateGuard, SentFrameLog, content_key, frame_key};
use self::endpoints::RouteTable;
use crate::dialect::ids;
use crate::framing::FrameRef;

/// A route expires after this long without a frame.
pub const ROUTE_LIFETIME: TimeDelta = endpoints::LIFETIME;
/// COMMAND_CANCEL of common.xml.
const COMMAND_CANCEL: u32 = 80;

/// Whether a frame's sender is who its header says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SenderCheck {
    /// He is: the checksum holds, and on a link with a key the signature.
    Verified,
    /// Unknown: the message is in no dialect, so that its checksum cannot be verified, or it may come without the signature
    /// that its link asks for. Passed on, but nothing is learnt from it.
    Unverifiable,
}

/// Whether a link has peers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkSharing {
    /// Only the peer itself: nothing goes back there.
    Exclusive,
    /// Others, too.
    Shared,
}

/// What is known of a frame's sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SenderInfo {
    /// Whether he is who the header says.
    pub check: SenderCheck,
    /// Whether he has the link for himself.
    pub sharing: LinkSharing,
}

/// A sender on a link that others may share.
impl From<SenderCheck> for SenderInfo {
    fn from(check: SenderCheck) -> Self {
        Self { check, sharing: LinkSharing::Shared }
    }
}

/// Whether a frame has come before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DuplicateStatus {
    /// It has not, or only by the very same endpoint.
    New,
    /// It has, over a redundant link to the same sender: it says nothing new.
    Duplicate,
    /// It has, by a link that has nothing to do with this one: somewhere the links form a loop. It goes nowhere, but only who
    /// knows for whom he waits on which link can say whether it is news.
    Loop,
    /// The station has said it itself: a link echoes, or it went round a loop. It goes nowhere and says nothing.
    Echo,
    /// It bears the station's address, but the station has not said it: another sender has the same one. It goes nowhere.
    AddressConflict,
}

/// What is to become of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RoutingDecision {
    /// Whether it has come before. If it has, it goes nowhere.
    pub duplicate_status: DuplicateStatus,
    /// Where it goes on to, by rising link id.
    pub to: Vec<(LinkId, Recipients)>,
}

/// What a [`FrameRouter`] is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct RouterConfig {
    /// The station's own address; what is meant for it alone goes nowhere else.
    pub own: Address,
    /// How long a frame is remembered to know it again; zero turns this off.
    pub duplicate_window: TimeDelta,
    /// The rules of each link.
    pub links: BTreeMap<LinkId, LinkRules>,
}

/// Knows who was heard where and which frames have come, and decides where each goes on to.
#[derive(Clone, Debug)]
pub struct FrameRouter {
    config: RouterConfig,
    routes: RouteTable,
    duplicates: DuplicateGuard,
    sent_frames: SentFrameLog,
}

impl FrameRouter {
    /// A router without any frames.
    pub fn new(config: RouterConfig) -> Self {
        Self {
            routes: RouteTable::default(),
            duplicates: DuplicateGuard::new(config.duplicate_window),
            sent_frames: SentFrameLog::default(),
            config,
        }
    }

    /// The station itself says this frame, on whichever link.
    pub fn record_sent(&mut self, frame: &[u8]) {
        self.sent_frames.record(frame);
    }

    /// The station sends this frame in the name of a sender that is received from `endpoint`: when it comes back from another endpoint, it is a duplicate.
    ///
    /// His own frames stay his own, even one with the same bytes, as long as they come by that endpoint.
    pub fn record_sent_for(&mut self, now: Timestamp<HostClock>, endpoint: Endpoint, frame: &[u8]) {
        self.duplicates.record(now, endpoint, frame_key(frame));
    }

    /// Whether a link's inward filter lets a frame in: one that it does not is neither used nor forwarded.
    pub fn admits(&self, link: LinkId, frame: &FrameRef<'_>) -> bool {
        self.config.links.get(&link).is_none_or(|rules| rules.inward.admits(frame.source, frame.message_id))
    }

    /// Takes note of a frame that was let in at `now` and decides where it goes.
    ///
    /// A frame with the station's own address goes nowhere and adds no route, whoever sent it.
    pub fn route(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
        sender: impl Into<SenderInfo>,
    ) -> RoutingDecision {
        let SenderInfo { check, sharing } = sender.into();
        let is_own_address = frame.source == self.config.own;
        // The station's component speaks in the systems of robots, too.
        let may_be_own = is_own_address || frame.source.component == self.config.own.component;
        let is_echo = may_be_own && self.sent_frames.contains(frame.raw);
        if is_echo || is_own_address {
            let occurrence = if is_echo { DuplicateStatus::Echo } else { DuplicateStatus::AddressConflict };
            let to = Vec::new();
            return RoutingDecision { duplicate_status: occurrence, to };
        }
        let occurrence = self.classify_duplicate(now, from, frame);
        self.decide(now, from, frame, SenderInfo { check, sharing }, occurrence)
    }

    /// By which other endpoint a frame came first, while that is remembered.
    pub fn first_endpoint(&self, now: Timestamp<HostClock>, from: Endpoint, frame: &FrameRef<'_>) -> Option<Endpoint> {
        let by_bytes = self.duplicates.first_endpoint(now, from, frame_key(frame.raw));
        let group = self.group(from.link).filter(|_| has_timestamp(frame.message_id));
        by_bytes.or_else(|| self.duplicates.first_endpoint(now, from, content_key(group?, frame)))
    }

    /// Decides where a frame goes that is new although [`Self::route`] found it to be a copy: only the caller knows that another sender
    /// with the same address sent the same bytes by [`Self::first_endpoint`].
    pub fn route_as_new(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
        sender: impl Into<SenderInfo>,
    ) -> RoutingDecision {
        self.decide(now, from, frame, sender.into(), DuplicateStatus::New)
    }

    fn decide(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
        sender: SenderInfo,
        occurrence: DuplicateStatus,
    ) -> RoutingDecision {
        let SenderInfo { check, sharing } = sender;
        // A loop is no route: it would send commands around. A redundant link is one.
        if check == SenderCheck::Verified && occurrence != DuplicateStatus::Loop {
            self.routes.observe(now, frame.source, from);
        }
        let to = match occurrence {
            DuplicateStatus::New => self.destinations(now, (from, sharing), frame),
            DuplicateStatus::Duplicate
            | DuplicateStatus::Loop
            | DuplicateStatus::Echo
            | DuplicateStatus::AddressConflict => Vec::new(),
        };
        RoutingDecision { duplicate_status: occurrence, to }
    }

    /// Where a frame goes whose target's endpoint only the caller knows: there, if the rules let it.
    pub fn destinations_at(
        &self,
        from: Endpoint,
        frame: &FrameRef<'_>,
        recipient: Endpoint,
    ) -> Vec<(LinkId, Recipients)> {
        let target = target_of(frame.message_id, frame.payload);
        let leaves = self.config.links.get(&from.link).is_none_or(|rules| rules.forward != ForwardPolicy::Disabled);
        let may_go = leaves && recipient != from && self.is_allowed_out(recipient.link, target, frame);
        may_go.then_some((recipient.link, Recipients::Peer(recipient.peer))).into_iter().collect()
    }

    /// Does the work that no reply waits for; best called when an input's answers have left.
    pub fn run_deferred_work(&mut self, now: Timestamp<HostClock>) {
        self.duplicates.sort_and_expire(now);
    }

    /// Forgets who was heard on a link, because it was lost.
    pub fn forget_link(&mut self, link: LinkId) {
        self.routes.forget_link(link);
    }

    /// Whether two links are one, or redundant links of one group: what is heard on either comes from the same robot.
    pub fn are_redundant(&self, a: LinkId, b: LinkId) -> bool {
        a == b || (self.group(a).is_some() && self.group(a) == self.group(b))
    }

    /// The link that stands for a group of redundant links: that with the lowest id; the link itself if it is in none.
    pub fn first_of_group(&self, link: LinkId) -> LinkId {
        let Some(group) = self.group(link) else {
            return link;
        };
        let mut links = self.config.links.iter();
        links.find(|(_, rules)| rules.group == Some(group)).map_or(link, |(first, _)| *first)
    }

    fn group(&self, link: LinkId) -> Option<u16> {
        self.config.links.get(&link)?.group
    }

    /// Takes note of a frame and says whether it came by another endpoint before. Equal bytes and equal content may have come from two
    /// endpoints; what a redundant link has brought is no news, even if a detour was quicker still.
    fn classify_duplicate(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
    ) -> DuplicateStatus {
        let by_bytes = self.duplicates.record(now, from, frame_key(frame.raw));
        let by_content = self
            .group(from.link)
            .filter(|_| has_timestamp(frame.message_id))
            .and_then(|group| self.duplicates.record(now, from, content_key(group, frame)));
        let leads_here = |first: Endpoint| self.are_redundant(first.link, from.link);
        if by_bytes.is_some_and(leads_here) || by_content.is_some_and(leads_here) {
            DuplicateStatus::Duplicate
        } else if by_bytes.or(by_content).is_some() {
            DuplicateStatus::Loop
        } else {
            DuplicateStatus::New
        }
    }

    fn destinations(
        &self,
        now: Timestamp<HostClock>,
        (from, sharing): (Endpoint, LinkSharing),
        frame: &FrameRef<'_>,
    ) -> Vec<(LinkId, Recipients)> {
        let leaves = self.config.links.get(&from.link).is_none_or(|rules| rules.forward != ForwardPolicy::Disabled);
        if !leaves {
            return Vec::new();
        }
        let target = target_of(frame.message_id, frame.payload);
        let may_leave = |link: LinkId| {
            (sharing == LinkSharing::Shared || link != from.link) && self.is_allowed_out(link, target, frame)
        };
        match target {
            // Nothing is collected before it is known that it leaves: of most links the frame has nowhere to go.
            MessageTarget::Broadcast => {
                let all = self.broadcast_destinations(from);
                all.filter(|(link, _)| may_leave(*link)).collect()
            }
            MessageTarget::Component(address) if address == self.config.own => Vec::new(),
            MessageTarget::System(_) | MessageTarget::Component(_) => {
                let mut to = self.known_endpoints(now, from, target);
                to.retain(|(link, _)| may_leave(*link));
                to
            }
        }
    }

    fn broadcast_destinations(&self, from: Endpoint) -> impl Iterator<Item = (LinkId, Recipients)> {
        let links = self.config.links.keys();
        links.filter_map(move |link| match *link {
            link if link == from.link => Some((link, Recipients::AllExcept(from.peer))),
            link if self.are_redundant(link, from.link) => None,
            link => Some((link, Recipients::All)),
        })
    }

    fn known_endpoints(
        &self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        target: MessageTarget,
    ) -> Vec<(LinkId, Recipients)> {
        let endpoints = match target {
            MessageTarget::Broadcast => return Vec::new(),
            MessageTarget::System(system) => self.routes.to_system(now, system),
            MessageTarget::Component(address) => {
                let exact = self.routes.to_component(now, address);
                if exact.is_empty() && address.system != self.config.own.system {
                    self.routes.to_system(now, address.system)
                } else {
                    exact
                }
            }
        };
        let is_other = |endpoint: &Endpoint| {
            *endpoint != from && (endpoint.link == from.link || !self.are_redundant(endpoint.link, from.link))
        };
        endpoints
            .into_iter()
            .filter(is_other)
            .map(|endpoint| (endpoint.link, Recipients::Peer(endpoint.peer)))
            .collect()
    }

    fn is_allowed_out(&self, link: LinkId, target: MessageTarget, frame: &FrameRef<'_>) -> bool {
        let Some(rules) = self.config.links.get(&link) else {
            return false;
        };
        let is_wanted = match rules.forward {
            ForwardPolicy::All => true,
            ForwardPolicy::Targeted => target != MessageTarget::Broadcast,
            ForwardPolicy::Disabled => false,
        };
        is_wanted && rules.outward.admits(frame.source, frame.message_id)
    }
}

/// The priority of a forwarded frame on a slow link: commands to one and their answers are never dropped.
pub fn priority_of(frame: &FrameRef<'_>) -> Priority {
    let is_command =
        matches!(frame.message_id, ids::COMMAND_INT | ids::COMMAND_LONG | ids::COMMAND_ACK | COMMAND_CANCEL);
    if is_command && target_of(frame.message_id, frame.payload) != MessageTarget::Broadcast {
        Priority::Command
    } else {
        Priority::Forwarded
    }
}

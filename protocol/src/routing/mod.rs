//! Routes frames: a station between several links is also a router (docs/routing.md; MAVLink guide, "Routing").
//!
//! It is a value: it sends nothing, reads no clock and changes no byte. It does not decide which frames are used, but
//! distinguishes duplicates from another endpoint ([`DuplicateStatus`]). A frame is never forwarded back to its endpoint,
//! nor to another link of the same group: those lead to the same robot.

mod duplicates;
mod endpoints;
mod rules;

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, Priority, Recipients, TimeDelta, Timestamp};

pub use duplicates::has_timestamp;
pub use endpoints::{Endpoint, MAX_PEERS, MessageTarget, ROUTE_LIFETIME, retarget, target_of};
pub use rules::{
    AllowBlockList, ForwardPolicy, ForwardedDialects, FrameFilter, LinkRateLimiter, LinkRules, RateLimits,
};

use self::duplicates::{DuplicateGuard, SentFrameLog, content_key, frame_key};
use self::endpoints::RouteTable;
use crate::dialect::ids;
use crate::framing::FrameRef;

/// COMMAND_CANCEL of common.xml.
const COMMAND_CANCEL: u32 = 80;

/// Whether a frame's sender is authentic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SenderCheck {
    /// The checksum is right, and on a link with a key the signature.
    Verified,
    /// Unknown: the message is in no dialect, so that its checksum cannot be verified, or its link accepts it without a
    /// signature. Forwarded, but no route is learned from it.
    Unverifiable,
}

/// Whether a peer shares its link with others; nothing is forwarded back on an exclusive one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkSharing {
    Exclusive,
    Shared,
}

/// The authentication of a frame's sender, and whether it shares its link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SenderInfo {
    pub check: SenderCheck,
    pub sharing: LinkSharing,
}

/// On a link that others may share.
impl From<SenderCheck> for SenderInfo {
    fn from(check: SenderCheck) -> Self {
        Self { check, sharing: LinkSharing::Shared }
    }
}

/// Whether a frame was received before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DuplicateStatus {
    /// Not before, or only from the same endpoint.
    New,
    /// From a redundant link to the same sender: it is not used again.
    Duplicate,
    /// From an unrelated link: the links form a loop. It is not forwarded, but only the caller, who knows on which link
    /// a reply is expected, can decide whether to use it.
    Loop,
    /// The station sent it itself: a link echoes, or it went round a loop. It is neither forwarded nor used.
    Echo,
    /// It has the station's address, but the station did not send it: another sender has the same address. It is not
    /// forwarded.
    AddressConflict,
}

/// The routing of one frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RoutingDecision {
    pub duplicate_status: DuplicateStatus,
    /// The links and recipients to which it is forwarded, by rising link id; none for a duplicate.
    pub to: Vec<(LinkId, Recipients)>,
}

/// The configuration of a [`FrameRouter`].
#[derive(Clone, Debug, PartialEq)]
pub struct RouterConfig {
    /// The station's own address; frames for it alone are not forwarded.
    pub own: Address,
    /// How long frames are remembered to detect duplicates; zero turns this off.
    pub duplicate_window: TimeDelta,
    pub links: BTreeMap<LinkId, LinkRules>,
}

/// Learns routes, detects duplicates, and decides where each frame is forwarded.
#[derive(Clone, Debug)]
pub struct FrameRouter {
    config: RouterConfig,
    routes: RouteTable,
    duplicates: DuplicateGuard,
    sent_frames: SentFrameLog,
}

impl FrameRouter {
    pub fn new(config: RouterConfig) -> Self {
        Self {
            routes: RouteTable::default(),
            duplicates: DuplicateGuard::new(config.duplicate_window),
            sent_frames: SentFrameLog::default(),
            config,
        }
    }

    pub fn record_sent(&mut self, frame: &[u8]) {
        self.sent_frames.record(frame);
    }

    /// The station sends this frame in the name of a sender that is received from `endpoint`: when it returns from
    /// another endpoint, it is a duplicate.
    ///
    /// The sender's own frames stay its own, even one with the same bytes, as long as they come from that endpoint.
    pub fn record_sent_for(&mut self, now: Timestamp<HostClock>, endpoint: Endpoint, frame: &[u8]) {
        self.duplicates.record(now, endpoint, frame_key(frame));
    }

    /// Whether a link's inward filter accepts a frame; rejected ones are neither used nor forwarded.
    pub fn admits(&self, link: LinkId, frame: &FrameRef<'_>) -> bool {
        self.config.links.get(&link).is_none_or(|rules| rules.inward.admits(frame.source, frame.message_id))
    }

    /// Records a frame that was admitted at `now` and decides where it is forwarded.
    ///
    /// A frame with the station's own address is not forwarded and adds no route.
    pub fn route(
        &mut self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        frame: &FrameRef<'_>,
        sender: impl Into<SenderInfo>,
    ) -> RoutingDecision {
        let is_own_address = frame.source == self.config.own;
        // The station's component speaks in the systems of robots, too.
        let may_be_own = is_own_address || frame.source.component == self.config.own.component;
        let is_echo = may_be_own && self.sent_frames.contains(frame.raw);
        if is_echo || is_own_address {
            let duplicate_status = if is_echo { DuplicateStatus::Echo } else { DuplicateStatus::AddressConflict };
            return RoutingDecision { duplicate_status, to: Vec::new() };
        }
        let duplicate_status = self.classify_duplicate(now, from, frame);
        self.decide(now, from, frame, sender.into(), duplicate_status)
    }

    /// The other endpoint from which a frame came first, while that is remembered.
    pub fn first_endpoint(&self, now: Timestamp<HostClock>, from: Endpoint, frame: &FrameRef<'_>) -> Option<Endpoint> {
        let by_bytes = self.duplicates.first_endpoint(now, from, frame_key(frame.raw));
        let group = self.group(from.link).filter(|_| has_timestamp(frame.message_id));
        by_bytes.or_else(|| self.duplicates.first_endpoint(now, from, content_key(group?, frame)))
    }

    /// Decides where a frame is forwarded that [`Self::route`] took for a duplicate: only the caller knows that another
    /// sender with the same address sent the same bytes from [`Self::first_endpoint`].
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
        duplicate_status: DuplicateStatus,
    ) -> RoutingDecision {
        // A loop is no route: it would send commands around. A redundant link is one.
        if sender.check == SenderCheck::Verified && duplicate_status != DuplicateStatus::Loop {
            self.routes.observe(now, frame.source, from);
        }
        let is_new = duplicate_status == DuplicateStatus::New;
        let to = if is_new { self.destinations(now, from, sender.sharing, frame) } else { Vec::new() };
        RoutingDecision { duplicate_status, to }
    }

    /// The destinations of a frame whose target's endpoint only the caller knows, subject to the rules.
    pub fn destinations_at(
        &self,
        from: Endpoint,
        frame: &FrameRef<'_>,
        recipient: Endpoint,
    ) -> Vec<(LinkId, Recipients)> {
        let target = target_of(frame.message_id, frame.payload);
        let may_go =
            self.forwards_from(from.link) && recipient != from && self.is_allowed_out(recipient.link, target, frame);
        may_go.then_some((recipient.link, Recipients::Peer(recipient.peer))).into_iter().collect()
    }

    pub fn forward_policy(&self, link: LinkId) -> ForwardPolicy {
        self.config.links.get(&link).map_or(ForwardPolicy::ByRole, |rules| rules.forward)
    }

    /// The peers of a link where an address was heard.
    pub fn peers_of(&self, now: Timestamp<HostClock>, link: LinkId, address: Address) -> Vec<PeerId> {
        let endpoints = self.routes.to_component(now, address).into_iter();
        endpoints.filter(|endpoint| endpoint.link == link).map(|endpoint| endpoint.peer).collect()
    }

    /// Does work that is not urgent; call it after the replies to an input were sent.
    pub fn run_deferred_work(&mut self, now: Timestamp<HostClock>) {
        self.duplicates.sort_and_expire(now);
    }

    pub fn forget_link(&mut self, link: LinkId) {
        self.routes.forget_link(link);
    }

    /// Whether two links are the same or redundant links of one group: both lead to the same robot.
    pub fn are_redundant(&self, a: LinkId, b: LinkId) -> bool {
        a == b || (self.group(a).is_some() && self.group(a) == self.group(b))
    }

    /// The link with the lowest id in a group of redundant links; the link itself if it is in none.
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

    /// Records a frame and classifies it. Equal bytes and equal content may have come from two endpoints; a copy from a
    /// redundant link is a duplicate, even if a detour was faster still.
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

    fn forwards_from(&self, link: LinkId) -> bool {
        self.config.links.get(&link).is_none_or(|rules| rules.forward != ForwardPolicy::Disabled)
    }

    fn destinations(
        &self,
        now: Timestamp<HostClock>,
        from: Endpoint,
        sharing: LinkSharing,
        frame: &FrameRef<'_>,
    ) -> Vec<(LinkId, Recipients)> {
        if !self.forwards_from(from.link) {
            return Vec::new();
        }
        let target = target_of(frame.message_id, frame.payload);
        let may_leave = |link: LinkId| {
            let is_here = link == from.link;
            (sharing == LinkSharing::Shared || !is_here)
                && (is_here || !self.are_redundant(link, from.link))
                && self.is_allowed_out(link, target, frame)
        };
        let endpoints = match target {
            MessageTarget::Broadcast => {
                let links = self.config.links.keys().copied().filter(|link| may_leave(*link));
                let recipients =
                    |link| if link == from.link { Recipients::AllExcept(from.peer) } else { Recipients::All };
                return links.map(|link| (link, recipients(link))).collect();
            }
            MessageTarget::Component(address) if address == self.config.own => return Vec::new(),
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
        let others = endpoints.into_iter().filter(|endpoint| *endpoint != from && may_leave(endpoint.link));
        others.map(|endpoint| (endpoint.link, Recipients::Peer(endpoint.peer))).collect()
    }

    fn is_allowed_out(&self, link: LinkId, target: MessageTarget, frame: &FrameRef<'_>) -> bool {
        let Some(rules) = self.config.links.get(&link) else {
            return false;
        };
        let is_forwarded = match rules.forward {
            ForwardPolicy::All | ForwardPolicy::ByRole => true,
            ForwardPolicy::Targeted => target != MessageTarget::Broadcast,
            ForwardPolicy::Disabled => false,
        };
        is_forwarded && rules.admits_outward(frame.source, frame.message_id)
    }
}

/// The priority of a forwarded frame on a slow link: commands to one recipient and their replies are never dropped.
pub fn priority_of(frame: &FrameRef<'_>) -> Priority {
    let is_command =
        matches!(frame.message_id, ids::COMMAND_INT | ids::COMMAND_LONG | ids::COMMAND_ACK | COMMAND_CANCEL);
    if is_command && target_of(frame.message_id, frame.payload) != MessageTarget::Broadcast {
        Priority::Command
    } else {
        Priority::Forwarded
    }
}

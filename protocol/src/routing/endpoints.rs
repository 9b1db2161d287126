//! Endpoints, the routes to them, and the target of a message, read from its payload without decoding it.
//!
//! The offset of a target in the payload is computed with the generated encoders when it is first needed: each message is
//! encoded twice with different targets, and the byte that differs is the field. Decoding would not do: one enumeration
//! value that is newer than our dialect makes the generated decoder reject a command that another system understands.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use mavlink::dialects::common;
use mavlink_core::{MavlinkVersion, Message};
use posebridge_telemetry::{Address, ComponentId, HostClock, LinkId, PeerId, SystemId, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::dialect::RenumberError;
use crate::dialect::encoder::rewrite;
use crate::dialect::generated::posebridge;

/// Most distinguished peers of a link, and most routes and senders: the limit of a UDP port.
pub const MAX_PEERS: usize = 4_096;

/// The peer of a link from which a frame came. The default is the only peer of the first link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Endpoint {
    pub link: LinkId,
    pub peer: PeerId,
}

/// A route expires after this long without a frame: thirty missed heartbeats.
pub const ROUTE_LIFETIME: TimeDelta = TimeDelta::from_millis(30_000);
const MAX_ROUTES: usize = MAX_PEERS;

/// More routes than this behind one endpoint are invented: eight bits name this many systems.
const MANY_ROUTES: usize = 255;

/// Routes learned from received frames.
#[derive(Clone, Debug, Default)]
pub(super) struct RouteTable(BTreeMap<(Address, Endpoint), Timestamp<HostClock>>);

impl RouteTable {
    pub(super) fn observe(&mut self, now: Timestamp<HostClock>, source: Address, endpoint: Endpoint) {
        if self.0.len() >= MAX_ROUTES && !self.0.contains_key(&(source, endpoint)) {
            self.evict_routes(now);
        }
        self.0.insert((source, endpoint), now);
    }

    pub(super) fn to_component(&self, now: Timestamp<HostClock>, address: Address) -> BTreeSet<Endpoint> {
        self.endpoints_in_range(now, address, address)
    }

    pub(super) fn to_system(&self, now: Timestamp<HostClock>, system: SystemId) -> BTreeSet<Endpoint> {
        let component = |number| Address { system, component: ComponentId(number) };
        self.endpoints_in_range(now, component(0), component(u8::MAX))
    }

    pub(super) fn forget_link(&mut self, link: LinkId) {
        self.0.retain(|(_, endpoint), _| endpoint.link != link);
    }

    fn endpoints_in_range(&self, now: Timestamp<HostClock>, first: Address, last: Address) -> BTreeSet<Endpoint> {
        let lowest = Endpoint { link: LinkId(0), peer: PeerId(0) };
        let highest = Endpoint { link: LinkId(u16::MAX), peer: PeerId(u32::MAX) };
        self.0
            .range((first, lowest)..=(last, highest))
            .filter(|(_, last_seen)| now - **last_seen <= ROUTE_LIFETIME)
            .map(|((_, endpoint), _)| *endpoint)
            .collect()
    }

    /// A sender that invents addresses displaces its own entries: drops the older half of the routes of the endpoint
    /// with the most, at once, so that a flood costs no search per frame. If no endpoint has many, the flood comes from
    /// invented endpoints, and the link with the most routes loses as many.
    fn evict_routes(&mut self, now: Timestamp<HostClock>) {
        self.0.retain(|_, last_seen| now - *last_seen <= ROUTE_LIFETIME);
        if self.0.len() < MAX_ROUTES {
            return;
        }
        let (mut of_endpoints, mut of_links) = (BTreeMap::new(), BTreeMap::new());
        for (_, endpoint) in self.0.keys() {
            *of_endpoints.entry(*endpoint).or_insert(0_usize) += 1;
            *of_links.entry(endpoint.link).or_insert(0_usize) += 1;
        }
        let loudest_endpoint = of_endpoints.into_iter().max_by_key(|(_, routes)| *routes);
        let loudest_link = of_links.into_iter().max_by_key(|(_, routes)| *routes);
        match (loudest_endpoint, loudest_link) {
            (Some((endpoint, routes)), _) if routes >= MANY_ROUTES => {
                self.evict_older_half(|found| found == endpoint);
            }
            (_, Some((link, _))) => self.evict_older_half(|found| found.link == link),
            _ => {}
        }
    }

    fn evict_older_half(&mut self, is_one: impl Fn(Endpoint) -> bool) {
        let routes = self.0.iter().filter(|((_, endpoint), _)| is_one(*endpoint));
        let mut by_silence: Vec<_> = routes.map(|(key, last_seen)| (*last_seen, *key)).collect();
        by_silence.sort_unstable();
        for (_, key) in by_silence.iter().take(by_silence.len().div_ceil(2)) {
            self.0.remove(key);
        }
    }
}

const MAX_PAYLOAD: usize = 255;

/// The recipients of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageTarget {
    /// It names no target, target 0, or its definition is unknown.
    Broadcast,
    System(SystemId),
    Component(Address),
}

impl MessageTarget {
    pub const fn system(self) -> Option<SystemId> {
        match self {
            Self::Broadcast => None,
            Self::System(system) => Some(system),
            Self::Component(address) => Some(address.system),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct TargetOffsets {
    message_id: u32,
    system: u8,
    component: Option<u8>,
}

static OFFSETS: LazyLock<Vec<TargetOffsets>> = LazyLock::new(|| {
    let standard = common::MavMessage::all_ids().iter();
    let own = posebridge::MavMessage::all_ids().iter();
    let mut offsets: Vec<TargetOffsets> = standard
        .filter_map(|id| offsets_of::<common::MavMessage>(*id))
        .chain(own.filter_map(|id| offsets_of::<posebridge::MavMessage>(*id)))
        .collect();
    offsets.sort_unstable_by_key(|entry| entry.message_id);
    offsets
});

/// Trailing zeros of the payload may be truncated.
pub fn target_of(message_id: u32, payload: &[u8]) -> MessageTarget {
    let Ok(index) = OFFSETS.binary_search_by_key(&message_id, |entry| entry.message_id) else {
        return MessageTarget::Broadcast;
    };
    let TargetOffsets { system, component, .. } = OFFSETS[index];
    let byte = |offset: u8| payload.get(usize::from(offset)).copied().unwrap_or(0);
    match (byte(system), component.map_or(0, byte)) {
        (0, _) => MessageTarget::Broadcast,
        (system, 0) => MessageTarget::System(SystemId(system)),
        (system, component) => {
            MessageTarget::Component(Address { system: SystemId(system), component: ComponentId(component) })
        }
    }
}

/// Changes the target of a complete frame: the system, and the component if the frame names one. Updates the checksum;
/// nothing else changes. A frame without a target is unchanged, as after an error.
pub fn retarget(message_id: u32, frame: &mut [u8], to: Address) -> Result<(), RenumberError> {
    let index = OFFSETS.binary_search_by_key(&message_id, |entry| entry.message_id);
    let offsets = index.map_err(|_unknown| RenumberError::NoFrame)?;
    let TargetOffsets { system, component, .. } = OFFSETS[offsets];
    rewrite(frame, |frame, header| {
        let position = |offset: u8| header.payload_at() + usize::from(offset);
        // What is cut off is zero: a broadcast.
        if position(system) >= header.end() {
            return Err(RenumberError::NoFrame);
        }
        frame[position(system)] = to.system.0;
        let component = component.map(position).filter(|position| *position < header.end());
        if let Some(component) = component.filter(|position| frame[*position] != 0) {
            frame[component] = to.component.0;
        }
        Ok(())
    })
}

fn offsets_of<M: Message>(message_id: u32) -> Option<TargetOffsets> {
    let mut message = M::default_message_from_id(message_id)?;
    Some(TargetOffsets {
        message_id,
        system: offset_of(&mut message, M::target_system_id_mut)?,
        component: offset_of(&mut message, M::target_component_id_mut),
    })
}

/// The offset on the wire of the field that `field` accesses; `None` if the message does not have it.
fn offset_of<M: Message>(message: &mut M, field: fn(&mut M) -> Option<&mut u8>) -> Option<u8> {
    let mut written_with = |value: u8| {
        *field(message)? = value;
        let mut bytes = [0; MAX_PAYLOAD];
        message.ser(MavlinkVersion::V2, &mut bytes);
        Some(bytes)
    };
    let (zero, full) = (written_with(0x00)?, written_with(0xFF)?);
    let offset = zero.iter().zip(&full).position(|(a, b)| a != b)?;
    u8::try_from(offset).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    fn endpoint(link: u16, peer: u32) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(peer) }
    }

    fn sender(number: u32) -> Address {
        Address::new((number / 256 % 256) as u8, (number % 256) as u8)
    }

    #[test]
    fn invented_senders_evict_routes_of_their_own_endpoint() {
        let mut routes = RouteTable::default();
        let robot = Address::new(1, 1);
        routes.observe(at(0), robot, endpoint(0, 0));
        routes.observe(at(0), robot, endpoint(1, 0));
        for number in 0..60_000 {
            routes.observe(at(1), sender(number + 512), endpoint(1, 7));
            assert!(routes.0.len() <= MAX_ROUTES);
        }
        assert!(routes.to_component(at(2), robot).into_iter().eq([endpoint(0, 0), endpoint(1, 0)]));
        assert!(routes.0.len() > MAX_ROUTES / 4);
        assert_eq!(routes.to_component(at(2), sender(60_511)).len(), 1);
    }

    #[test]
    fn invented_endpoints_evict_no_route_of_another_link() {
        let mut routes = RouteTable::default();
        let robot = Address::new(1, 1);
        routes.observe(at(0), robot, endpoint(0, 0));
        for number in 0..60_000 {
            routes.observe(at(1), sender(number + 512), endpoint(1, number));
            assert!(routes.0.len() <= MAX_ROUTES);
        }
        assert_eq!(routes.to_component(at(2), robot).len(), 1);
    }

    #[test]
    fn a_command_for_another_system_is_otherwise_the_same_command() {
        use crate::dialect::{Encoder, decode};
        use crate::framing::{VerifiedFrame, WireVersion, verify};
        use crate::message::{CommandLong, Message};
        let command = |target| {
            Message::Command(CommandLong { target, command: 400, params: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0] })
        };
        let mut bytes = Vec::new();
        Encoder::new(WireVersion::V2).encode(Address::new(254, 190), &command(Address::new(7, 1)), &mut bytes);
        assert_eq!(retarget(76, &mut bytes, Address::new(9, 3)), Ok(()));
        let VerifiedFrame::Frame(frame) = verify(&bytes) else {
            panic!("its checksum is right");
        };
        assert_eq!(decode(&frame).unwrap(), Some(command(Address::new(9, 3))));
        assert_eq!(
            retarget(0, &mut bytes, Address::new(9, 3)),
            Err(RenumberError::NoFrame),
            "a heartbeat is for everybody"
        );
    }

    #[test]
    fn a_message_without_target_and_one_of_no_dialect_are_for_everybody() {
        assert_eq!(target_of(0, &[1; 9]), MessageTarget::Broadcast);
        assert_eq!(target_of(42_100, &[1; 13]), MessageTarget::Broadcast);
        assert_eq!(target_of(60_000, &[1; 255]), MessageTarget::Broadcast);
    }
}

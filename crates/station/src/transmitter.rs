//! The sending half of a station: the role and the recipients of a message, and the forwarding of frames.
//!
//! It borrows what it needs for one pass of sending; its callers decide what is due and what is sent.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::dialect::{RenumberError, ids};
use posebridge_protocol::message::{CommandAck, CommandInt, CommandLong, Message, SetMessageInterval, TimeSync};
use posebridge_protocol::routing::{Endpoint, ForwardPolicy, FrameRouter};
use posebridge_telemetry::{
    Address, HostClock, LinkId, LinkState, Output, PeerId, Priority, Recipients, RobotId, Timestamp,
};

use crate::config::OutputKind;
use crate::egress::{Egress, OutgoingMessage};
use crate::estimate_publisher::PublishedMessage;
use crate::forwarded_frame::ForwardedFrame;
use crate::link_context::LinkContext;
use crate::output_queue::OutputQueue;
use crate::receive_pass::ForwardingReport;
use crate::robot_table::RobotTable;
use crate::sender_identity::RobotIndex;
use crate::sessions::{SenderRole, Sessions, session_priority};
use crate::vehicle_proxy::VEHICLE_COMPONENT;
use crate::vehicle_status::status_message_id;

/// Sends messages and forwards frames, at one instant.
pub(crate) struct Transmitter<'a> {
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) own_address: Address,
    pub(crate) links: &'a mut BTreeMap<LinkId, LinkContext>,
    pub(crate) router: &'a mut FrameRouter,
    pub(crate) sessions: &'a mut Sessions,
    pub(crate) robots: &'a RobotTable,
    pub(crate) egress: &'a mut Egress,
    pub(crate) outputs: &'a mut OutputQueue,
}

/// A message with its sender, priority and recipients.
#[derive(Clone, Copy)]
struct Transmission<'a> {
    link: LinkId,
    sender: Sender,
    message: &'a Message,
    priority: Priority,
    to: Recipients,
}

#[derive(Clone, Copy)]
enum Sender {
    Station,
    /// The station's component in a robot's system.
    Estimator(Address),
    Vehicle(Address, Endpoint),
}

impl Transmitter<'_> {
    /// Sends a session's message; on a link that is down it is lost, and the session repeats it when the link is back.
    pub(crate) fn send_session_message(&mut self, id: LinkId, role: SenderRole, message: &Message) {
        if self.links.get(&id).is_none_or(|link| link.state == LinkState::Down) {
            return;
        }
        self.send_as(id, role, message, session_priority(message));
    }

    /// Sends a message to all peers of a link, as the station or as a robot.
    pub(crate) fn send_as(&mut self, id: LinkId, role: SenderRole, message: &Message, priority: Priority) {
        match role {
            SenderRole::Station => self.send(id, message, priority),
            SenderRole::Vehicle(robot) => self.send_as_vehicle(id, robot, message, priority),
        }
    }

    pub(crate) fn send(&mut self, link: LinkId, message: &Message, priority: Priority) {
        self.transmit(Transmission { link, sender: Sender::Station, message, priority, to: Recipients::All });
    }

    pub(crate) fn send_to_peer(&mut self, to: Endpoint, message: &Message, priority: Priority) {
        let Endpoint { link, peer } = to;
        self.transmit(Transmission { link, sender: Sender::Station, message, priority, to: Recipients::Peer(peer) });
    }

    /// Sends the message of a robot's session as a vehicle, unless the robot sends it itself or the station must not
    /// send in its name.
    fn send_as_vehicle(&mut self, link: LinkId, robot: RobotId, message: &Message, priority: Priority) {
        let now = self.now;
        let Some(vehicles) = self.sessions.vehicles(link) else {
            return;
        };
        let is_heartbeat = matches!(message, Message::Heartbeat(_));
        let id = if is_heartbeat { Some(ids::HEARTBEAT) } else { status_message_id(message) };
        let is_sent_by_robot = id.is_some_and(|id| vehicles.is_sent_by_robot(now, robot, id));
        if vehicles.is_suppressed(now, robot) || is_sent_by_robot {
            return;
        }
        if let Some(sender) = self.vehicle_sender(link, robot) {
            self.transmit(Transmission { link, sender, message, priority, to: Recipients::All });
        }
        if is_heartbeat {
            self.release_heartbeats(link);
        }
    }

    /// The sender of a robot as a vehicle on a link; `None` if it is not one there.
    fn vehicle_sender(&self, link: LinkId, robot: RobotId) -> Option<Sender> {
        let address = self.sessions.vehicles(link)?.address(robot)?;
        let last_seen = self.robots.find(robot).and_then(|index| self.robots.get(index).last_seen);
        Some(Sender::Vehicle(address, last_seen.map_or_else(Endpoint::default, |(endpoint, _)| endpoint)))
    }

    pub(crate) fn send_codec_output(&mut self, id: LinkId) {
        let is_up = self.links.get(&id).is_some_and(|link| link.state == LinkState::Up);
        let codec = |links: &mut BTreeMap<LinkId, LinkContext>| links.get_mut(&id)?.codec.as_mut()?.poll_addressed();
        while let Some((to, bytes)) = codec(self.links) {
            if is_up {
                // Nothing takes the place of a lost request: the robot would wait for ever.
                self.push_permitted(id, to, Priority::Command, bytes);
            }
        }
    }

    /// Queues bytes for those of the recipients that are no robots of other stations, and counts them.
    fn push_permitted(&mut self, id: LinkId, to: Recipients, priority: Priority, bytes: Vec<u8>) {
        let permitted = self.permitted(id, to);
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let Some(permitted) = permitted else {
            link.count_sent(&bytes);
            self.outputs.push(Output::Transmit { link: id, to, priority, bytes });
            return;
        };
        for to in permitted {
            link.count_sent(&bytes);
            self.outputs.push(Output::Transmit { link: id, to, priority, bytes: bytes.clone() });
        }
    }

    /// The recipients that are no robots of other stations; `None` for all of them, as where this station owns each robot that it hears.
    fn permitted(&self, id: LinkId, to: Recipients) -> Option<Vec<Recipients>> {
        if !self.robots.has_standby() {
            return None;
        }
        let home = self.router.first_of_group(id);
        let mut standby = self.robots.standby_addresses(home).peekable();
        standby.peek()?;
        let routes = standby.flat_map(|address| self.router.peers_of(self.now, id, address));
        let routed: Vec<PeerId> = routes.collect();
        let owned: Vec<PeerId> = self.robots.owned_peers(id).collect();
        let is_standby = |peer: PeerId| {
            !owned.contains(&peer) && (routed.contains(&peer) || self.robots.standby_at(id, peer).is_some())
        };
        let link = self.links.get(&id)?;
        let known = || owned.iter().copied().chain(link.ground_stations.iter().copied());
        // Before a robot is heard any peer may be it. A codec does not tell who is there.
        let is_any_doubtful = link.codec.is_some() || self.robots.awaits_standby(home);
        let is_permitted =
            |peer: &PeerId| !is_standby(*peer) && (!is_any_doubtful || known().any(|known| known == *peer));
        if let Recipients::Peer(peer) = to {
            return (!is_permitted(&peer)).then(Vec::new);
        }
        let present: BTreeSet<PeerId> = link.framers.present().into_iter().chain(known()).collect();
        let permitted = present.into_iter().filter(|peer| to.includes(*peer)).filter(is_permitted);
        Some(permitted.map(Recipients::Peer).collect())
    }

    /// Sends a robot's output: as the robot where a ground station expects it from the vehicle, else as the station.
    pub(crate) fn send_published(&mut self, index: RobotIndex, published: &PublishedMessage) {
        let now = self.now;
        let PublishedMessage { link, kind, ref message, priority } = *published;
        let robot = self.robots.get(index).id;
        let mut sender = Sender::Station;
        if let Some(vehicles) = self.sessions.vehicles(link)
            && kind.is_vehicle_output()
            && vehicles.address(robot).is_some()
        {
            if vehicles.is_sent_by_robot(now, robot, kind.message_id()) {
                return;
            }
            if !vehicles.is_suppressed(now, robot)
                && let Some(vehicle) = self.vehicle_sender(link, robot)
            {
                sender = vehicle;
            }
        }
        let at_home = self.robots.at_home(link, self.router);
        let is_at_home = self.router.first_of_group(link) == robot.link;
        if index > 0 && matches!(sender, Sender::Station) && !is_at_home {
            sender = self.estimator_sender(index);
        }
        let is_crowded = self.links.get(&link).is_some_and(LinkContext::is_crowded);
        let is_shared = is_crowded || (!at_home.is_empty() && at_home != [index]);
        let transmission = Transmission { link, sender, message, priority, to: Recipients::All };
        if is_shared {
            self.send_on_shared_link(index, transmission);
        } else {
            self.transmit(transmission);
        }
    }

    /// On a link with several robots a robot gets only its own outputs, and ground stations get all of them.
    fn send_on_shared_link(&mut self, index: RobotIndex, transmission: Transmission<'_>) {
        let id = transmission.link;
        if let Some(peer) = self.robots.identities.peer_on(index, id) {
            self.transmit(Transmission { to: Recipients::Peer(peer), sender: Sender::Station, ..transmission });
        }
        let Some(link) = self.links.get(&id) else {
            return;
        };
        let ground_stations: Vec<PeerId> = link.ground_stations.iter().copied().collect();
        let sender = match transmission.sender {
            Sender::Station if index > 0 => self.estimator_sender(index),
            Sender::Station | Sender::Estimator(_) | Sender::Vehicle(..) => transmission.sender,
        };
        for peer in ground_stations {
            self.transmit(Transmission { to: Recipients::Peer(peer), sender, ..transmission });
        }
    }

    /// The station's component in a robot's system, so that receivers can distinguish the robots' outputs.
    fn estimator_sender(&self, index: RobotIndex) -> Sender {
        let system = self.robots.get(index).vehicle_address.system;
        Sender::Estimator(Address { system, component: self.own_address.component })
    }

    /// Encodes a message and queues its bytes.
    fn transmit(&mut self, transmission: Transmission<'_>) {
        let now = self.now;
        let Transmission { link: id, sender, message, priority, to } = transmission;
        if let (Some([]), Recipients::Peer(_)) = (self.permitted(id, to).as_deref(), to) {
            return;
        }
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let address = match sender {
            Sender::Station => self.own_address,
            Sender::Estimator(address) | Sender::Vehicle(address, _) => address,
        };
        let outgoing = OutgoingMessage { link: id, sender: address, message, priority };
        let Some(bytes) = self.egress.send(now, link, outgoing) else {
            return;
        };
        match sender {
            Sender::Vehicle(_, endpoint) => self.router.record_sent_for(now, endpoint, &bytes),
            Sender::Station | Sender::Estimator(_) if link.codec.is_none() => self.router.record_sent(&bytes),
            Sender::Station | Sender::Estimator(_) => {}
        }
        let in_crowd = to == Recipients::All && link.is_crowded();
        let Some(peers) = in_crowd.then(|| recipients_in_crowd(now, id, link, self.router, message)).flatten() else {
            self.push_permitted(id, to, priority, bytes);
            return;
        };
        for peer in peers {
            self.push_permitted(id, Recipients::Peer(peer), priority, bytes.clone());
        }
    }

    /// Counts and forwards the routed frames of this input.
    pub(crate) fn forward_frames(&mut self) {
        for (id, report) in std::mem::take(&mut self.outputs.reports) {
            let ForwardingReport { filtered, duplicates, address_conflicts, unchangeable, forwarded } = report;
            if let Some(link) = self.links.get_mut(&id) {
                link.health.drops_out += unchangeable;
                link.health.filtered += filtered;
                link.health.duplicates += duplicates;
                link.health.address_conflicts += address_conflicts;
            }
            for mut frame in forwarded {
                let held_on = self.hold_heartbeat(&frame);
                frame.to.retain(|(link, _)| !held_on.contains(link));
                for to_link in frame.to.chunk_by(|one, next| one.0 == next.0) {
                    self.forward_frame(to_link, &frame);
                }
            }
        }
    }

    /// Holds the heartbeat of a camera or another component back on links for ground stations until that of a vehicle has been sent, and
    /// returns those links: ground stations treat the sender of the first heartbeat as the vehicle. One of each sender is held; a later one
    /// replaces it.
    fn hold_heartbeat(&mut self, frame: &ForwardedFrame) -> Vec<LinkId> {
        // A signed frame keeps its number: later ones of its sender must not overtake it.
        if frame.message_id != ids::HEARTBEAT || frame.is_signed || frame.source.component == VEHICLE_COMPONENT {
            return Vec::new();
        }
        let links = frame.to.chunk_by(|one, next| one.0 == next.0);
        let held_on = links.filter_map(|to_link| {
            let (id, _) = to_link.first()?;
            // A frame that keeps its number must not be overtaken by a later one of its sender.
            let is_renumbered = !self.router.are_redundant(frame.from.link, *id);
            let vehicles = self.sessions.vehicles_mut(*id).filter(|_| is_renumbered)?;
            if vehicles.is_unmodified(self.now, frame.source) {
                return None;
            }
            let held = ForwardedFrame { to: to_link.to_vec(), bytes: frame.bytes.clone(), ..*frame };
            vehicles.hold_heartbeat(self.now, held).then_some(*id)
        });
        held_on.collect()
    }

    /// Forwards the heartbeats that waited on a link for the vehicle's.
    fn release_heartbeats(&mut self, id: LinkId) {
        let now = self.now;
        let Some(vehicles) = self.sessions.vehicles_mut(id) else {
            return;
        };
        let (held, dropped) = (vehicles.release_heartbeats(now), vehicles.take_dropped_heartbeats());
        if let Some(link) = self.links.get_mut(&id) {
            link.health.rate_limited += dropped;
        }
        for frame in held {
            self.forward_frame(&frame.to, &frame);
        }
    }

    fn forward_frame(&mut self, to: &[(LinkId, Recipients)], frame: &ForwardedFrame) {
        let now = self.now;
        let Some((id, link)) = to.first().and_then(|(id, _)| Some((*id, self.links.get_mut(id)?))) else {
            return;
        };
        if !self.egress.admit_forwarded(now, id, link, frame) || self.forward_renumbered(id, frame) {
            return;
        }
        let listeners = self.broadcast_listeners(id, frame.from);
        let peers = self.links.get(&id).map_or(1, |link| link.framers.count().max(1));
        let copies = to.iter().map(|(_, to)| match to {
            Recipients::Peer(_) => 1,
            Recipients::All | Recipients::AllExcept(_) => listeners.as_ref().map_or(peers, Vec::len),
        });
        let copies = copies.sum();
        let sender = self.links.get_mut(&frame.from.link);
        let may_be_copied = sender.is_none_or(|sender| sender.charge_forwarding(now, frame.from.peer, copies));
        if !may_be_copied {
            if let Some(link) = self.links.get_mut(&id) {
                link.health.rate_limited += 1;
            }
            return;
        }
        for (_, to) in to {
            match (to, &listeners) {
                (Recipients::All | Recipients::AllExcept(_), Some(listeners)) => {
                    for peer in listeners {
                        self.push_forwarded(id, Recipients::Peer(*peer), frame);
                    }
                }
                _ => self.push_forwarded(id, *to, frame),
            }
        }
    }

    fn push_forwarded(&mut self, id: LinkId, to: Recipients, frame: &ForwardedFrame) {
        let permitted = self.permitted(id, to);
        if let (Some([]), Recipients::Peer(peer)) = (permitted.as_deref(), to) {
            self.outputs.withheld.insert(Endpoint { link: id, peer });
        }
        for to in permitted.unwrap_or_else(|| vec![to]) {
            if let Some(link) = self.links.get_mut(&id) {
                link.count_forwarded(&frame.bytes);
                let output = Output::Transmit { link: id, to, priority: frame.priority, bytes: frame.bytes.clone() };
                self.outputs.forwarded.push_back(output);
            }
        }
    }

    /// The peers of a link that receive the broadcasts of an endpoint; `None` for all of them.
    ///
    /// The twenty broadcasts per second of a robot or its camera must not be sent to every other robot: a weak robot
    /// has no time for them. So where several robots share the link only its ground stations get them, and nobody on
    /// the link of one other robot without a known ground station. In a crowd, whose peers may be robots that have not shown it
    /// yet, it is the ground stations alone, and a lone robot for those that are no robots. The broadcasts of a ground station are
    /// sent to all.
    fn broadcast_listeners(&self, id: LinkId, from: Endpoint) -> Option<Vec<PeerId>> {
        let is_ground_station = self.sessions.vehicles(from.link).is_some()
            || self.links.get(&from.link)?.ground_stations.contains(&from.peer);
        if is_ground_station || self.router.forward_policy(id) == ForwardPolicy::All {
            return None;
        }
        let link = self.links.get(&id)?;
        let robots = self.robots.at_home(id, self.router);
        let sender = self.robots.identities.only_at(from);
        let is_of_other_robot = robots.first().is_some_and(|robot| sender.is_some_and(|sender| sender != *robot));
        if robots.len() < 2 && !is_of_other_robot && !link.is_crowded() {
            return None;
        }
        let lone_robot =
            if let ([robot], None) = (robots, sender) { self.robots.identities.peer_on(*robot, id) } else { None };
        let peers = link.ground_stations.iter().copied().chain(lone_robot.filter(|_| link.is_crowded()));
        Some(peers.filter(|peer| (id, *peer) != (from.link, from.peer)).collect())
    }

    /// Forwards a frame to a link for ground stations, with the announced address of its sender and the next sequence
    /// number of that address there. False if it is to be forwarded without change.
    ///
    /// Not every frame of a sender is for this link (replies to others, filtered and rate-limited frames), and a robot
    /// shares its address with the station: by the original numbers a ground station would compute losses that are
    /// none.
    fn forward_renumbered(&mut self, id: LinkId, frame: &ForwardedFrame) -> bool {
        // A sender on the link itself, or on one redundant to it, reaches some peers there without the station.
        if self.router.are_redundant(frame.from.link, id) || self.sessions.vehicles(id).is_none() {
            return false;
        }
        let home = self.router.first_of_group(frame.from.link);
        let announced = self.robots.announced_address(frame.from, home, frame.source);
        // Under its own ids it would be another robot's there, and signed it cannot be changed.
        let is_unchangeable = announced.is_some() && frame.is_signed;
        let bytes = if is_unchangeable { None } else { self.readdress(id, frame, announced.unwrap_or(frame.source)) };
        match bytes {
            Some(bytes) => self.send_renumbered(id, frame, bytes),
            None if announced.is_some() => {
                if let Some(link) = self.links.get_mut(&id) {
                    link.health.drops_out += 1;
                }
            }
            None => return false,
        }
        true
    }

    /// Gives a frame the sender `from` with its next number on a link; `None` if the frame cannot be changed. Records
    /// for the link's vehicles which messages a robot sends itself.
    fn readdress(&mut self, id: LinkId, frame: &ForwardedFrame, from: Address) -> Option<Vec<u8>> {
        let now = self.now;
        // A sender with a robot's address on a link without robots must not silence the station.
        let is_from_robot = self.robots.len() == 0 || !self.robots.at_home(frame.from.link, self.router).is_empty();
        let is_signed_link = self.links.get(&id)?.verifier.is_signed();
        if is_from_robot && from.component == VEHICLE_COMPONENT && frame.message_id == ids::HEARTBEAT {
            self.sessions.follow_heartbeat(now, id);
        }
        let vehicles = self.sessions.vehicles_mut(id)?;
        if is_from_robot && from.component == VEHICLE_COMPONENT {
            vehicles.record_forwarded(now, from.system, frame.message_id);
            if is_signed_link {
                vehicles.record_on_signed_link(now, from.system);
            }
        }
        let readdressed = if vehicles.is_unmodified(now, from) {
            Err(RenumberError::Signed)
        } else {
            self.egress.readdress(id, &frame.bytes, from)
        };
        if readdressed == Err(RenumberError::Signed) && is_from_robot {
            if frame.is_signed {
                vehicles.record_unmodified(now, from);
            }
            // Should the next one be ours, it follows that.
            self.egress.follow_sequence(id, from, frame.sequence);
        }
        readdressed.ok()
    }

    /// Sends a renumbered frame among the station's own, because the robot's sequence is the station's, too, and frames
    /// must be sent in the order of their numbers; to all peers of the link, because one that misses a frame would
    /// count it as lost.
    fn send_renumbered(&mut self, id: LinkId, frame: &ForwardedFrame, bytes: Vec<u8>) {
        let permitted = self.permitted(id, Recipients::All);
        let Some(link) = self.links.get_mut(&id) else { return };
        self.router.record_sent_for(self.now, frame.from, &bytes);
        link.count_forwarded(&bytes);
        let output = |to, bytes| Output::Transmit { link: id, to, priority: frame.priority, bytes };
        match permitted {
            None => self.outputs.push(output(Recipients::All, bytes)),
            Some(permitted) => permitted.into_iter().for_each(|to| self.outputs.push(output(to, bytes.clone()))),
        }
        if frame.message_id == ids::HEARTBEAT && frame.source.component == VEHICLE_COMPONENT {
            self.release_heartbeats(id);
        }
    }
}

/// The peers of a crowded link that get a message of the station for all; `None` for all of them. What each peer asks for must not be sent
/// to each other one: the answers to five hundred robots would be a quarter of a million datagrams.
#[expect(clippy::wildcard_enum_match_arm, reason = "what has no target is for those that watch")]
fn recipients_in_crowd(
    now: Timestamp<HostClock>,
    id: LinkId,
    link: &LinkContext,
    router: &FrameRouter,
    message: &Message,
) -> Option<Vec<PeerId>> {
    let target = match message {
        Message::Heartbeat(_) => return None,
        Message::TimeSync(sync) if sync.answer_nanos == 0 => return None,
        Message::TimeSync(TimeSync { target, .. }) | Message::CommandAck(CommandAck { target, .. }) => *target,
        Message::SetMessageInterval(SetMessageInterval { target, .. })
        | Message::Command(CommandLong { target, .. })
        | Message::CommandInt(CommandInt { target, .. }) => Some(*target),
        other => other.service_target(),
    };
    if let Some(target) = target {
        let peers = router.peers_of(now, id, target);
        if !peers.is_empty() {
            return Some(peers);
        }
    }
    Some(link.ground_stations.union(&link.parameter_clients).copied().collect())
}

impl OutputKind {
    /// Whether a ground station expects it from the vehicle.
    const fn is_vehicle_output(self) -> bool {
        match self {
            Self::Attitude
            | Self::DistanceSensor
            | Self::GlobalPosition
            | Self::HeadUpDisplay
            | Self::AttitudeQuaternion => true,
            Self::PlanarPose
            | Self::Odometry
            | Self::LocalPosition
            | Self::EstimatorStatus
            | Self::FusionHealth
            | Self::NamedValue
            | Self::FloatArray => false,
        }
    }
}

//! The robots as vehicles on a link for ground stations.
//!
//! A ground station shows a vehicle if component 1 of a system sends HEARTBEAT, and takes the attitude from that
//! component alone. A robot that does not use MAVLink sends nothing there, and one that does sends no attitude. So the
//! station sends as the robot on such a link, and receivers must not detect that two senders share one address:
//!
//! - Frames that are forwarded to the link take the next number of the same sequence ([`Encoder::readdress`]); payload and checksum
//!   seed stay as they are. Each sender has a sequence of its own, because not all of its frames are for this link.
//! - Messages that the robot sends itself are not sent a second time.
//! - Signed frames must not be changed and are forwarded as they are. Meanwhile the station does not send as that robot.
//! - On a link with a key, unsigned frames of others are renumbered like everywhere, and stay unsigned. The station's own are signed
//!   there, and signed frames must not be mixed with unsigned ones of the robot: the station does not send as the robot there,
//!   either. docs/adr/README.md, decision 10, gives the reasons.
//!
//! What is asked of the vehicle is answered for it where it cannot answer itself ([`VehicleProxies::responding_vehicle`]).
//!
//! [`Encoder::readdress`]: posebridge_protocol::dialect::Encoder::readdress

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{CommandLong, Message};
use posebridge_protocol::routing::Endpoint;
use posebridge_protocol::session::{HeartbeatMode, PlanService, Session, SessionOutput, SessionSender};
use posebridge_telemetry::{Address, ComponentId, HostClock, RobotId, SystemId, TimeDelta, Timestamp};

use crate::config::OutputKind;
use crate::forwarded_frame::ForwardedFrame;
use crate::link_context::LinkContext;
use crate::robot::Robot;
use crate::vehicle_status::STATUS_MESSAGES;

/// MAV_COMP_ID_AUTOPILOT1: the component that a ground station takes for the vehicle.
pub(crate) const VEHICLE_COMPONENT: ComponentId = ComponentId(1);
/// A message that was not forwarded for this long is no longer sent by the robot: five heartbeats.
const RECENT_WINDOW: TimeDelta = TimeDelta::from_millis(5_000);

/// Other heartbeats wait for that of a vehicle, which comes once a second.
const MAX_HEARTBEAT_HOLD: TimeDelta = TimeDelta::from_millis(1_500);
/// Heartbeats that wait on a link: more than the components of several robots.
const MAX_HELD: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CommandResponder {
    /// The station, because the robot cannot: it does not use MAVLink, or uses another component.
    Station,
    /// The robot, except for messages that the station sends in its name, and for what a brick of our dialect lacks.
    Robot,
}

/// The kinds of requests that a vehicle answers beside commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum VehicleService {
    /// Its version, modes and files about itself.
    Description,
    Parameters,
    Plans,
    Files,
    Logs,
}

impl VehicleService {
    /// The service that a message answers for.
    const fn of_answer(message_id: u32) -> Option<Self> {
        match message_id {
            ids::AUTOPILOT_VERSION => Some(Self::Description),
            ids::PARAM_VALUE => Some(Self::Parameters),
            ids::MISSION_COUNT | ids::MISSION_ACK | ids::MISSION_CURRENT => Some(Self::Plans),
            ids::FILE_TRANSFER_PROTOCOL => Some(Self::Files),
            ids::LOG_ENTRY | ids::LOG_DATA => Some(Self::Logs),
            _ => None,
        }
    }
}

/// What a message asks of a vehicle.
enum VehicleRequest {
    /// A command, and the message that it is about, if any.
    Command {
        about: Option<u32>,
    },
    /// A command about the drive to goals.
    Drive,
    Service(VehicleService),
}

impl CommandResponder {
    /// Who replies for a robot on `link`; `None` if it must not appear as a vehicle.
    pub(crate) fn for_robot(robot: &Robot, link: &LinkContext, own_address: Address) -> Option<Self> {
        let is_vehicle_address = robot.wire_address.component == robot.vehicle_address.component;
        let responder = if link.codec.is_some() || !is_vehicle_address { Self::Station } else { Self::Robot };
        (robot.vehicle_address != own_address).then_some(responder)
    }
}

#[derive(Debug, Default)]
pub(crate) struct VehicleProxies {
    vehicles: BTreeMap<RobotId, VehicleProxy>,
    /// When a vehicle's own frame, of a message that the station might send, was last forwarded here.
    last_forwarded: BTreeMap<(SystemId, u32), Timestamp<HostClock>>,
    /// When a frame that must not be changed was last forwarded here.
    last_unmodified: BTreeMap<Address, Timestamp<HostClock>>,
    /// When a vehicle's own frame was last forwarded here, on a link with a key.
    last_on_signed_link: BTreeMap<SystemId, Timestamp<HostClock>>,
    /// Systems whose vehicle sends our own dialect: bricks that were programmed for this station.
    of_own_dialect: BTreeSet<SystemId>,
    /// Services that a vehicle has been heard to answer for itself.
    own_services: BTreeSet<(SystemId, VehicleService)>,
    /// Heartbeats of other components that wait for the next one of any vehicle, the last of each sender, and when they came.
    held_heartbeats: BTreeMap<(Endpoint, Address), (Timestamp<HostClock>, ForwardedFrame)>,
    /// Of any vehicle.
    last_heartbeat: Option<Timestamp<HostClock>>,
    /// Heartbeats that were held and never sent.
    dropped_heartbeats: u64,
    /// The robot with the lowest id if several have one address.
    by_address: BTreeMap<Address, RobotId>,
    /// Vehicles whose session may have output.
    active: BTreeSet<RobotId>,
    /// When each vehicle's session is due, or earlier.
    due: BTreeSet<(Timestamp<HostClock>, RobotId)>,
}

#[derive(Debug)]
struct VehicleProxy {
    address: Address,
    responder: CommandResponder,
    session: Session<HostClock>,
    /// Its place in [`VehicleProxies::due`].
    due: Option<Timestamp<HostClock>>,
}

impl VehicleProxies {
    /// Adds a robot to this link with the session of its address there. Does nothing if it was added before.
    pub(crate) fn add(&mut self, robot: RobotId, session: Session<HostClock>, responder: CommandResponder) {
        if self.vehicles.contains_key(&robot) {
            return;
        }
        let address = session.own_address();
        let first = self.by_address.entry(address).or_insert(robot);
        *first = robot.min(*first);
        self.vehicles.insert(robot, VehicleProxy { address, responder, session, due: None });
        self.active.insert(robot);
        self.plan(robot);
    }

    fn plan(&mut self, robot: RobotId) {
        let Some(vehicle) = self.vehicles.get_mut(&robot) else {
            return;
        };
        if let Some(due) = vehicle.due {
            self.due.remove(&(due, robot));
        }
        vehicle.due = vehicle.session.deadline();
        self.due.extend(vehicle.due.map(|due| (due, robot)));
    }

    /// The robot's address on this link; `None` if it does not appear there.
    pub(crate) fn address(&self, robot: RobotId) -> Option<Address> {
        self.vehicles.get(&robot).map(|vehicle| vehicle.address)
    }

    /// Calls a function with a vehicle's session, then updates its schedule.
    pub(crate) fn with_session<T>(
        &mut self,
        robot: RobotId,
        act: impl FnOnce(&mut Session<HostClock>) -> T,
    ) -> Option<T> {
        let done = act(&mut self.vehicles.get_mut(&robot)?.session);
        self.active.insert(robot);
        self.plan(robot);
        Some(done)
    }

    /// Holds a forwarded heartbeat back until a vehicle has sent one; false, and holds nothing, if none has for a while.
    pub(crate) fn hold_heartbeat(&mut self, now: Timestamp<HostClock>, frame: ForwardedFrame) -> bool {
        let is_vehicle_present = self.last_heartbeat.is_some_and(|last| now - last < MAX_HEARTBEAT_HOLD);
        let sender = (frame.from, frame.source);
        // What waited before is out of date, whether this one waits or not.
        self.dropped_heartbeats += u64::from(self.held_heartbeats.remove(&sender).is_some());
        let is_held = is_vehicle_present && self.held_heartbeats.len() < MAX_HELD;
        if is_held {
            self.held_heartbeats.insert(sender, (now, frame));
        }
        is_held
    }

    /// The heartbeats that waited for that of a vehicle, which is sent now. Of a vehicle that was silent meanwhile they are out of date: their
    /// senders may be gone.
    pub(crate) fn release_heartbeats(&mut self, now: Timestamp<HostClock>) -> Vec<ForwardedFrame> {
        self.last_heartbeat = Some(now);
        let held = std::mem::take(&mut self.held_heartbeats).into_values();
        let (fresh, stale): (Vec<_>, Vec<_>) = held.partition(|(since, _)| now - *since < MAX_HEARTBEAT_HOLD);
        self.dropped_heartbeats += stale.len() as u64;
        fresh.into_iter().map(|(_, frame)| frame).collect()
    }

    /// How many held heartbeats were not sent since the last call.
    pub(crate) const fn take_dropped_heartbeats(&mut self) -> u64 {
        std::mem::replace(&mut self.dropped_heartbeats, 0)
    }

    /// Whether the station knows the state of a vehicle: its robot cannot tell it, or is a brick of our dialect. An autopilot knows its own.
    pub(crate) fn is_described_here(&self, now: Timestamp<HostClock>, robot: RobotId) -> bool {
        self.vehicles.get(&robot).is_some_and(|vehicle| {
            self.is_served_here(now, robot, vehicle) || self.of_own_dialect.contains(&vehicle.address.system)
        })
    }

    /// Whether the station alone sends as the vehicle: neither the robot does, nor an autopilot beside a companion computer.
    fn is_served_here(&self, now: Timestamp<HostClock>, robot: RobotId, vehicle: &VehicleProxy) -> bool {
        vehicle.responder == CommandResponder::Station && !self.is_sent_by_robot(now, robot, ids::HEARTBEAT)
    }

    /// Whether the station sends a message in the name of a vehicle, as long as that does not send it itself.
    fn is_sent_here(&self, now: Timestamp<HostClock>, robot: RobotId, message_id: u32) -> bool {
        OutputKind::of_message(message_id).is_some()
            || (STATUS_MESSAGES.contains(&message_id) && self.is_described_here(now, robot))
    }

    pub(crate) fn set_heartbeat_mode(&mut self, now: Timestamp<HostClock>, robot: RobotId, mode: HeartbeatMode) {
        self.with_session(robot, |session| session.set_heartbeat_mode(now, mode));
    }

    /// Passes a request to the session of its vehicle, if the station is to reply.
    pub(crate) fn handle(&mut self, now: Timestamp<HostClock>, from: SessionSender, message: &Message) {
        if let Some(robot) = self.responding_vehicle(now, message) {
            self.with_session(robot, |session| session.handle_from_peer(now, from, message));
        }
    }

    /// Stores the value of a parameter and returns the vehicles whose parameters were requested.
    pub(crate) fn store_parameter(&mut self, index: usize, value: f32) -> Vec<RobotId> {
        let vehicles = self.vehicles.iter_mut();
        vehicles.filter_map(|(robot, vehicle)| vehicle.session.report_parameter(index, value).map(|_| *robot)).collect()
    }

    pub(crate) fn tick(&mut self, now: Timestamp<HostClock>) {
        let due: Vec<RobotId> = self.due.iter().take_while(|(due, _)| *due <= now).map(|(_, robot)| *robot).collect();
        for robot in due {
            self.with_session(robot, |session| {
                if session.is_due(now) {
                    session.tick(now);
                }
            });
        }
    }

    pub(crate) fn poll(&mut self) -> Option<(RobotId, SessionOutput<HostClock>)> {
        while let Some(robot) = self.active.first().copied() {
            if let Some(output) = self.vehicles.get_mut(&robot).and_then(|vehicle| vehicle.session.poll()) {
                return Some((robot, output));
            }
            self.active.remove(&robot);
        }
        None
    }

    pub(crate) fn is_idle(&self) -> bool {
        self.active.iter().all(|robot| self.vehicles.get(robot).is_none_or(|vehicle| vehicle.session.is_idle()))
    }

    pub(crate) fn is_due(&self, now: Timestamp<HostClock>) -> bool {
        self.deadline().is_some_and(|due| due <= now)
    }

    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.due.first().map(|(due, _)| *due)
    }

    /// The vehicle of a system sends our own dialect, which need not be forwarded here.
    pub(crate) fn record_own_dialect(&mut self, system: SystemId) {
        self.of_own_dialect.insert(system);
    }

    /// A vehicle was restarted: another program may run on it.
    pub(crate) fn record_restart(&mut self, system: SystemId) {
        self.own_services.retain(|(own, _)| *own != system);
    }

    /// A vehicle's own frame is forwarded on the link.
    pub(crate) fn record_forwarded(&mut self, now: Timestamp<HostClock>, from: SystemId, message_id: u32) {
        let service =
            VehicleService::of_answer(message_id).filter(|service| self.own_services.insert((from, *service)));
        // Its own list takes the place of ours, which has the same address.
        if let (Some(VehicleService::Parameters), Some(robot)) =
            (service, self.by_address.get(&Address { system: from, component: VEHICLE_COMPONENT }).copied())
        {
            self.with_session(robot, Session::stop_listing);
        }
        // The others are never requested; so the map stays small whatever comes.
        let is_status = message_id == ids::HEARTBEAT || STATUS_MESSAGES.contains(&message_id);
        if is_status || OutputKind::of_message(message_id).is_some() {
            self.last_forwarded.insert((from, message_id), now);
        }
    }

    /// A frame is forwarded unchanged, because it must not be changed.
    pub(crate) fn record_unmodified(&mut self, now: Timestamp<HostClock>, from: Address) {
        self.last_unmodified.insert(from, now);
    }

    /// A vehicle's own frame is forwarded on a link with a key, where the station's with the same address would be
    /// signed.
    pub(crate) fn record_on_signed_link(&mut self, now: Timestamp<HostClock>, from: SystemId) {
        self.last_on_signed_link.insert(from, now);
    }

    /// Whether a sender's frames are forwarded with their own numbers.
    pub(crate) fn is_unmodified(&self, now: Timestamp<HostClock>, from: Address) -> bool {
        is_recent(now, self.last_unmodified.get(&from))
    }

    /// Whether frames with the robot's address are forwarded among which the station must not send: signed ones, or any
    /// where the link has a key.
    pub(crate) fn is_suppressed(&self, now: Timestamp<HostClock>, robot: RobotId) -> bool {
        self.address(robot).is_some_and(|own| {
            self.is_unmodified(now, own) || is_recent(now, self.last_on_signed_link.get(&own.system))
        })
    }

    pub(crate) fn is_sent_by_robot(&self, now: Timestamp<HostClock>, robot: RobotId, message_id: u32) -> bool {
        let own = self.address(robot);
        is_recent(now, own.and_then(|own| self.last_forwarded.get(&(own.system, message_id))))
    }

    /// The vehicle of a request to which the station is to reply:
    ///
    /// - any request where the robot cannot, because it speaks no MAVLink or uses another component, and no other sender is the vehicle;
    /// - commands about messages that the station sends in its name;
    /// - of a robot that sends our own dialect, and so is a brick that was programmed for this station: what it is, parameters, plans, files
    ///   and logs, unless it has been heard to answer such requests itself; with plans, if it takes goals, also the commands that start and
    ///   stop its drive. Its other commands are its own.
    ///
    /// Every other robot that speaks MAVLink is left alone.
    pub(crate) fn responding_vehicle(&self, now: Timestamp<HostClock>, message: &Message) -> Option<RobotId> {
        let (target, request) = vehicle_request(message)?;
        let is_for_all = target.component == ComponentId(0);
        let target = if is_for_all { Address { component: VEHICLE_COMPONENT, ..target } } else { target };
        let robot = self.by_address.get(&target)?;
        let vehicle = self.vehicles.get(robot)?;
        if self.is_suppressed(now, *robot) {
            return None;
        }
        let lacks = |service| {
            self.of_own_dialect.contains(&target.system) && !self.own_services.contains(&(target.system, service))
        };
        let is_ours = match request {
            VehicleRequest::Command { about } => {
                about.is_some_and(|id| self.is_sent_here(now, *robot, id) && !self.is_sent_by_robot(now, *robot, id))
            }
            VehicleRequest::Drive => {
                vehicle.session.plan_service() == Some(PlanService::Owner) && lacks(VehicleService::Plans)
            }
            VehicleRequest::Service(service) => lacks(service),
        };
        (self.is_served_here(now, *robot, vehicle) || is_ours).then_some(*robot)
    }

    /// Whether a request is for one vehicle alone and the station replies in its place: then nobody else needs it.
    pub(crate) fn is_answered_here(&self, now: Timestamp<HostClock>, message: &Message) -> bool {
        let is_for_one = vehicle_request(message).is_some_and(|(target, _)| target.component == VEHICLE_COMPONENT);
        is_for_one && self.responding_vehicle(now, message).is_some()
    }
}

fn is_recent(now: Timestamp<HostClock>, last: Option<&Timestamp<HostClock>>) -> bool {
    last.is_some_and(|last| now - *last < RECENT_WINDOW)
}

/// The target of a request, and what is asked.
#[expect(clippy::wildcard_enum_match_arm, reason = "only these are requests, however many kinds of messages there are")]
fn vehicle_request(message: &Message) -> Option<(Address, VehicleRequest)> {
    let service = |target: &Address, service| Some((*target, VehicleRequest::Service(service)));
    match message {
        Message::SetMessageInterval(request) => {
            Some((request.target, VehicleRequest::Command { about: Some(request.message_id) }))
        }
        Message::Command(command) => Some((command.target, requested_by(command))),
        Message::CommandInt(command) => Some((command.target, requested_by(&command.to_long()))),
        Message::ParamRequestList { target }
        | Message::ParamRequestRead { target, .. }
        | Message::ParamSet { target, .. }
        | Message::ParamSetUnsupported { target, .. } => service(target, VehicleService::Parameters),
        Message::Plan(request) => service(&request.target, VehicleService::Plans),
        Message::MissionItem(item) => service(&item.target, VehicleService::Plans),
        Message::FileTransfer(request) => service(&request.target, VehicleService::Files),
        Message::Log(_) => service(&message.service_target()?, VehicleService::Logs),
        _ => None,
    }
}

fn requested_by(command: &CommandLong) -> VehicleRequest {
    let about = match command.command {
        ids::COMMAND_GET_HOME_POSITION => Some(ids::HOME_POSITION),
        _ => command.named_message(),
    };
    if ids::is_description(command.command, about) {
        VehicleRequest::Service(VehicleService::Description)
    } else if ids::is_drive_command(command.command) {
        VehicleRequest::Drive
    } else {
        VehicleRequest::Command { about }
    }
}

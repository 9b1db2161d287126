//! The MAVLink services beside the telemetry: heartbeats, time requests, parameters and commands, link by link.
//!
//! On every link the station has a session as itself; on a link for ground stations it has one for each robot, too.

use std::collections::BTreeMap;
use std::sync::Arc;

use posebridge_estimator::PARAMS;
use posebridge_protocol::dialect::commands::SUPPORTED_COMMANDS;
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::routing::{DuplicateStatus, Endpoint, FrameRouter};
use posebridge_protocol::session::{
    HeartbeatMode, PlanService, RequestedMessages, ServedCommands, ServedFile, Session, SessionConfig, SessionOutput,
    SessionSender,
};
use posebridge_telemetry::{Address, HostClock, LinkId, Priority, RobotId, SystemId, TimeDelta, Timestamp};

use crate::config::{AnnouncedAs, LinkConfig, OUTPUTS, StationConfig};
use crate::metadata_files::metadata_files;
use crate::parameter_reports::ParameterReports;
use crate::receive::ReceivedMessage;
use crate::robot::Robot;
use crate::robot_table::RobotTable;
use crate::sender_identity::{PEER_TIMEOUT, RobotIndex};
use crate::vehicle_proxy::{CommandResponder, VehicleProxies};

/// MAV_TYPE_ONBOARD_CONTROLLER.
const ONBOARD_CONTROLLER: u8 = 18;
/// MAV_STATE_ACTIVE.
const ACTIVE: u8 = 4;
const HEARTBEAT_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// Commands that are handled also when they are for all components: operator commands, and requests for messages, to
/// which any component that supports them may reply.
const SERVED_COMMANDS: [u16; SUPPORTED_COMMANDS.len() + 2] = {
    let [storage, start, stop, pose, reset, calibration, source] = SUPPORTED_COMMANDS;
    let (interval, message) = (ids::COMMAND_GET_MESSAGE_INTERVAL, ids::COMMAND_REQUEST_MESSAGE);
    [interval, message, storage, start, stop, pose, reset, calibration, source]
};

/// The participant as which the station sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum SenderRole {
    Station,
    /// As a robot, on a link for ground stations.
    Vehicle(RobotId),
}

impl SenderRole {
    const fn robot(self) -> Option<RobotId> {
        match self {
            Self::Station => None,
            Self::Vehicle(robot) => Some(robot),
        }
    }
}

#[derive(Debug)]
pub(crate) struct Sessions {
    links: BTreeMap<LinkId, LinkSessions>,
    /// The configuration of a robot's session as a vehicle.
    vehicle: SessionConfig,
    /// The files by which a vehicle describes itself.
    files: Arc<[ServedFile]>,
    own_system: SystemId,
    has_ground_stations: bool,
}

#[derive(Debug)]
struct LinkSessions {
    station: Session<HostClock>,
    is_for_ground_stations: bool,
    /// The robots as vehicles; none unless the link is for ground stations.
    vehicles: VehicleProxies,
    reports: ParameterReports,
}

impl Sessions {
    pub(crate) fn new(config: &StationConfig, now: Timestamp<HostClock>) -> Self {
        let links = config.links.iter().map(|link| {
            let sessions = LinkSessions {
                station: open_session(link, config, now),
                is_for_ground_stations: link.announced_as == AnnouncedAs::StationAndVehicle && link.brick.is_none(),
                vehicles: VehicleProxies::default(),
                reports: ParameterReports::default(),
            };
            (link.id, sessions)
        });
        let links: BTreeMap<LinkId, LinkSessions> = links.collect();
        let vehicle = SessionConfig {
            heartbeat: Heartbeat::ROVER,
            timesync_period: None,
            requested_messages: RequestedMessages::default(),
            ..station_session_config(config)
        };
        Self {
            has_ground_stations: links.values().any(|link| link.is_for_ground_stations),
            links,
            vehicle,
            files: metadata_files().into(),
            own_system: config.own_address.system,
        }
    }

    pub(crate) const fn has_ground_stations(&self) -> bool {
        self.has_ground_stations
    }

    /// The links for ground stations, with the robots as vehicles.
    pub(crate) fn ground_station_links(&self) -> impl Iterator<Item = LinkId> {
        self.links.iter().filter(|(_, link)| link.is_for_ground_stations).map(|(id, _)| *id)
    }

    /// `None` if the link is not for ground stations.
    pub(crate) fn vehicles(&self, id: LinkId) -> Option<&VehicleProxies> {
        self.links.get(&id).filter(|link| link.is_for_ground_stations).map(|link| &link.vehicles)
    }

    pub(crate) fn vehicles_mut(&mut self, id: LinkId) -> Option<&mut VehicleProxies> {
        self.links.get_mut(&id).filter(|link| link.is_for_ground_stations).map(|link| &mut link.vehicles)
    }

    /// Updates which robots appear as vehicles, and which side sends heartbeats. `responder` returns the side that replies for a robot;
    /// `None` if it must not appear.
    pub(crate) fn update_presence(
        &mut self,
        now: Timestamp<HostClock>,
        robots: &mut RobotTable,
        router: &FrameRouter,
        responder: impl Fn(&Robot) -> Option<CommandResponder>,
    ) {
        if !self.has_ground_stations || !robots.take_presence_change(now) {
            return;
        }
        let mode = |is_alive| if is_alive { HeartbeatMode::Active } else { HeartbeatMode::Suppressed };
        let station_mode = mode(robots.is_any_alive(now));
        for (id, link) in self.links.iter_mut().filter(|(_, link)| link.is_for_ground_stations) {
            let vehicles = &mut link.vehicles;
            let mut has_new_vehicle = false;
            link.station.set_heartbeat_mode(now, station_mode);
            for robot in robots.detected() {
                // A robot that is received on a link itself needs no session of the station there.
                if vehicles.address(robot.id).is_none()
                    && !router.are_redundant(*id, robot.id.link)
                    && let Some(responder) = responder(robot)
                {
                    let config = SessionConfig { own: robot.vehicle_address, ..self.vehicle.clone() };
                    let mut session = Session::new(config, now);
                    session.offer_parameters(link.station.offered_parameters());
                    // What concerns the station as a whole is answered once where both are components of one system.
                    let is_own_system = robot.vehicle_address.system == self.own_system;
                    session.serve_commands(ServedCommands::AllBut(if is_own_system {
                        &SUPPORTED_COMMANDS
                    } else {
                        &[]
                    }));
                    let plans = if robot.accepts_goals { PlanService::Owner } else { PlanService::Empty };
                    session.serve_as_vehicle(Arc::clone(&self.files), plans);
                    vehicles.add(robot.id, session, responder);
                    has_new_vehicle = true;
                }
                vehicles.set_heartbeat_mode(now, robot.id, mode(robot.is_alive(now)));
            }
            if has_new_vehicle {
                link.station.beat_now(now);
            }
        }
    }

    /// A robot's own heartbeat is forwarded on a link for ground stations: the station's goes right behind it.
    pub(crate) fn follow_heartbeat(&mut self, now: Timestamp<HostClock>, id: LinkId) {
        if let Some(link) = self.links.get_mut(&id).filter(|link| link.is_for_ground_stations) {
            link.station.follow_heartbeat(now);
        }
    }

    /// The vehicle of a system sends our own dialect.
    pub(crate) fn record_own_dialect(&mut self, system: SystemId) {
        for link in self.links.values_mut() {
            link.vehicles.record_own_dialect(system);
        }
    }

    /// The robot of a system was restarted.
    pub(crate) fn record_restart(&mut self, system: SystemId) {
        for link in self.links.values_mut() {
            link.vehicles.record_restart(system);
        }
    }

    /// Whether a message asks the station, or a robot in whose name it replies, for something that costs an answer.
    pub(crate) fn are_asked(&self, now: Timestamp<HostClock>, id: LinkId, message: &Message) -> bool {
        let Some(link) = self.links.get(&id) else {
            return false;
        };
        link.station.is_asked(message) || link.vehicles.responding_vehicle(now, message).is_some()
    }

    /// Passes a message to the sessions of its link; `robot` is its sender, if that is one.
    ///
    /// The request of a duplicate was handled before. A message that went round a loop was not sent on this link; only
    /// a robot is always handled on its own link, because a copy may have been faster. But replies are expected on the
    /// link of the request, and so are heartbeats.
    pub(crate) fn handle(
        &mut self,
        now: Timestamp<HostClock>,
        endpoint: Endpoint,
        received: &ReceivedMessage,
        robot: Option<RobotIndex>,
    ) {
        let message = &received.message;
        let is_accepted = match received.duplicate_status {
            DuplicateStatus::New => true,
            DuplicateStatus::Loop if robot.is_none() => is_answer(message),
            DuplicateStatus::Duplicate | DuplicateStatus::Loop => !is_request(message),
            DuplicateStatus::Echo | DuplicateStatus::AddressConflict => return,
        };
        let Some(link) = self.links.get_mut(&endpoint.link) else {
            return;
        };
        if !is_accepted {
            link.station.record_activity(now, received.source);
            return;
        }
        // A copy may have come by another peer than its sender's own.
        let peer = (received.duplicate_status == DuplicateStatus::New).then_some(endpoint.peer);
        let sender = SessionSender { address: received.source, peer };
        link.station.handle_from_peer(now, sender, message);
        link.vehicles.handle(now, sender, message);
    }

    /// The next output of a link's sessions, with its role. The vehicles are first, and with them their heartbeats.
    pub(crate) fn poll(&mut self, id: LinkId) -> Option<(SenderRole, SessionOutput<HostClock>)> {
        let link = self.links.get_mut(&id)?;
        if let Some((robot, output)) = link.vehicles.poll() {
            return Some((SenderRole::Vehicle(robot), output));
        }
        Some((SenderRole::Station, link.station.poll()?))
    }

    pub(crate) fn are_idle(&self) -> bool {
        self.links.values().all(|link| link.station.is_idle() && link.vehicles.is_idle())
    }

    pub(crate) fn is_due(&mut self, now: Timestamp<HostClock>) -> bool {
        self.links
            .values_mut()
            .any(|link| link.station.is_due(now) || link.vehicles.is_due(now) || link.reports.is_due(now))
    }

    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let deadlines = self
            .links
            .values()
            .flat_map(|link| [link.station.deadline(), link.vehicles.deadline(), link.reports.deadline()]);
        deadlines.flatten().min()
    }

    pub(crate) fn tick(&mut self, now: Timestamp<HostClock>, id: LinkId) {
        if let Some(link) = self.links.get_mut(&id) {
            link.station.tick(now);
            link.vehicles.tick(now);
            if let Some((robot, index)) = link.reports.take_due(now) {
                let role = robot.map_or(SenderRole::Station, SenderRole::Vehicle);
                self.with_session(id, role, |session| {
                    if let Some(report) = session.parameter(index) {
                        session.queue_message(report);
                    }
                });
            }
        }
    }

    pub(crate) fn with_session<T>(
        &mut self,
        id: LinkId,
        role: SenderRole,
        act: impl FnOnce(&mut Session<HostClock>) -> T,
    ) -> Option<T> {
        let link = self.links.get_mut(&id)?;
        match role {
            SenderRole::Station => Some(act(&mut link.station)),
            SenderRole::Vehicle(robot) => link.vehicles.with_session(robot, act),
        }
    }

    /// After a peer's clock restarted: sends time requests in quick succession to align it.
    pub(crate) fn handle_peer_restart(&mut self, now: Timestamp<HostClock>, id: LinkId, peer: Address) {
        if let Some(link) = self.links.get_mut(&id) {
            link.station.peer_restarted(now, peer);
        }
    }

    /// Stores the value of a parameter. Each participant that was asked for parameters reports it, one after the other.
    pub(crate) fn store_parameter(&mut self, index: usize, value: f32) {
        for link in self.links.values_mut() {
            for robot in link.vehicles.store_parameter(index, value) {
                link.reports.add(Some(robot), index);
            }
            if link.station.report_parameter(index, value).is_some() {
                link.reports.add(None, index);
            }
        }
    }

    /// The report of a parameter to the one that has set it, which need not wait for those to all others.
    pub(crate) fn answer_parameter_set(&mut self, id: LinkId, role: SenderRole, index: usize) -> Option<Message> {
        self.links.get_mut(&id)?.reports.remove(role.robot(), index);
        self.with_session(id, role, |session| session.parameter(index))?
    }
}

fn open_session(link: &LinkConfig, config: &StationConfig, now: Timestamp<HostClock>) -> Session<HostClock> {
    let mut session_config = station_session_config(config);
    if link.brick.is_some() {
        // A link without MAVLink gets no requests for messages.
        session_config.requested_messages = RequestedMessages::default();
    }
    let mut session = Session::new(session_config, now);
    let params = &config.robot.filter_config.params;
    // In capitals, as MAVLink's parameters are: MAVProxy requests no others.
    session.offer_parameters(PARAMS.iter().map(|row| (row.key.to_ascii_uppercase(), (row.read)(params) as f32)));
    session.serve_commands(ServedCommands::These(&SERVED_COMMANDS));
    session
}

fn station_session_config(config: &StationConfig) -> SessionConfig {
    SessionConfig {
        own: config.own_address,
        heartbeat: Heartbeat {
            vehicle_type: ONBOARD_CONTROLLER,
            autopilot: Heartbeat::NOT_AN_AUTOPILOT,
            base_mode: 0,
            system_status: ACTIVE,
        },
        heartbeat_period: HEARTBEAT_PERIOD,
        timesync_period: Some(config.timesync_period),
        peer_timeout: PEER_TIMEOUT,
        requested_messages: RequestedMessages {
            of_robots: config.brick_message_intervals.clone(),
            of_autopilots: config.autopilot_message_intervals.clone(),
        },
        offered_messages: OUTPUTS.iter().map(|output| output.message_id).collect(),
    }
}

/// The priority of a session's message on a slow link: heartbeats and time requests are repeated, the others are not.
pub(crate) const fn session_priority(message: &Message) -> Priority {
    if matches!(message, Message::Heartbeat(_) | Message::TimeSync(_)) { Priority::Session } else { Priority::Command }
}

/// Whether a message is a request that must not be handled twice.
pub(crate) const fn is_request(message: &Message) -> bool {
    matches!(
        message,
        Message::SetMessageInterval(_)
            | Message::Command(_)
            | Message::CommandInt(_)
            | Message::ParamRequestList { .. }
            | Message::ParamRequestRead { .. }
            | Message::ParamSet { .. }
            | Message::ParamSetUnsupported { .. }
            | Message::Plan(_)
            | Message::MissionItem(_)
            | Message::FileTransfer(_)
            | Message::Log(_)
    )
}

/// Whether a message is a reply to a request of the station on some link.
const fn is_answer(message: &Message) -> bool {
    if let Message::TimeSync(sync) = message {
        sync.answer_nanos != 0
    } else {
        matches!(message, Message::CommandAck(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::{LINK, STATION, config};
    use posebridge_protocol::message::{CommandLong, TimeSync};
    use posebridge_telemetry::PeerId;

    const SENDER: Address = Address::new(7, 1);

    /// The numbers of outputs for a message that comes from some peers, each time a millisecond later, after the first heartbeat
    /// and the first time request.
    fn receive(message: &Message, by: &[(u32, DuplicateStatus)]) -> Vec<usize> {
        let mut sessions = Sessions::new(&config(), Timestamp::ZERO);
        let take_outputs = |sessions: &mut Sessions| std::iter::from_fn(|| sessions.poll(LINK)).count();
        sessions.tick(Timestamp::ZERO, LINK);
        take_outputs(&mut sessions);
        let outputs = (1..).zip(by).map(|(millis, (peer, duplicate_status))| {
            let endpoint = Endpoint { link: LINK, peer: PeerId(*peer) };
            let received = ReceivedMessage {
                source: SENDER,
                duplicate_status: *duplicate_status,
                is_signed: false,
                message: message.clone(),
            };
            sessions.handle(Timestamp::from_millis(millis), endpoint, &received, None);
            take_outputs(&mut sessions)
        });
        outputs.collect()
    }

    #[test]
    fn a_copy_of_a_command_is_not_carried_out_again() {
        let [_, _, _, _, reset, ..] = SUPPORTED_COMMANDS;
        let command = Message::Command(CommandLong { target: STATION, command: reset, params: [0.0; 7] });
        let statuses = [DuplicateStatus::New, DuplicateStatus::Duplicate, DuplicateStatus::Loop, DuplicateStatus::Echo];
        assert_eq!(receive(&command, &statuses.map(|status| (0, status))), [1, 0, 0, 0]);
    }

    #[test]
    fn each_peer_with_an_address_answers_a_time_request_once_and_a_copy_does_not() {
        let answer = Message::TimeSync(TimeSync { answer_nanos: 5, request_nanos: 0, target: None });
        let new = [0, 0, 1, 1].map(|peer| (peer, DuplicateStatus::New));
        let all = [&new[..], &[(2, DuplicateStatus::Duplicate)]].concat();
        assert_eq!(receive(&answer, &all), [1, 0, 1, 0, 0]);
    }
}

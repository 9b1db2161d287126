//! Missions between ground stations and robots: requests and commands in, goals and reports out.
//!
//! What a mission gives is sent behind the rest of an input, so that estimates and acknowledgements are first.

use posebridge_protocol::message::{CommandResult, Message, PositionTarget, Setpoint};
use posebridge_protocol::routing::Endpoint;
use posebridge_protocol::session::{PlanRequest, SessionSender};
use posebridge_telemetry::{Estimate, LinkId, LinkState, Priority, RobotId, SystemId, severity};

use crate::link_command::LinkCommand;
use crate::mission::{Mission, MissionAction, PlanClient};
use crate::operator::CommandTarget;
use crate::receive::ReceiveInfo;
use crate::sender_identity::RobotIndex;
use crate::sessions::SenderRole;
use crate::station::Station;

/// Why a mission pauses for someone who steers.
const BY_HAND: &str = "steered by hand";

impl Station {
    /// A request about the plan of a robot as a vehicle.
    pub(crate) fn handle_plan_request(
        &mut self,
        received: ReceiveInfo,
        robot: RobotId,
        by: SessionSender,
        request: &PlanRequest,
    ) {
        let Some(index) = self.robots.find(robot) else {
            return;
        };
        let Endpoint { link, peer } = received.endpoint;
        let client = PlanClient { endpoint: Endpoint { link, peer: by.peer.unwrap_or(peer) }, address: by.address };
        let (now, origin) = (self.time.now, self.robots.get(index).extractor.origin);
        self.open_mission(index).handle_request(now, client, request, origin);
    }

    /// Carries out a command about the drive of a robot. A refusal is reported to all ground stations.
    pub(crate) fn execute_drive_command(&mut self, index: RobotIndex, command: &LinkCommand) -> CommandResult {
        let robot = self.robots.get(index);
        if robot.ownership().is_standby() {
            let text = self.robots.labelled(index, &robot.owned_elsewhere());
            self.report_own_text(severity::WARNING, text);
            return CommandResult::Denied;
        }
        let (now, origin) = (self.time.now, robot.extractor.origin);
        match self.open_mission(index).handle_command(now, command, origin) {
            Ok(()) => CommandResult::Accepted,
            Err(refusal) => {
                self.report_own_text(severity::WARNING, self.robots.labelled(index, &refusal.text));
                refusal.result
            }
        }
    }

    /// Pauses the mission of a vehicle that a message steers: steering by hand has priority over the plan.
    pub(crate) fn observe_steering(&mut self, link: LinkId, sender: Option<RobotIndex>, message: &Message) {
        if self.missions.is_empty() {
            return;
        }
        let Some(system) = steered_system(message) else {
            return;
        };
        let has_vehicles = self.sessions.vehicles(link).is_some();
        for index in self.missions.robots() {
            let robot = self.robots.get(index);
            let named = if has_vehicles { robot.vehicle_address.system } else { robot.wire_address.system };
            if named == system && sender != Some(index) {
                self.interrupt_mission(index, BY_HAND);
            }
        }
    }

    /// Pauses the missions of robots that are driven by hand in the simulator.
    pub(crate) fn interrupt_missions(&mut self, target: CommandTarget) {
        let robots = match target {
            CommandTarget::Station => self.missions.robots(),
            CommandTarget::Robot(index) => vec![index],
        };
        for index in robots {
            self.interrupt_mission(index, BY_HAND);
        }
    }

    pub(crate) fn interrupt_mission(&mut self, index: RobotIndex, why: &'static str) {
        if let Some(mission) = self.missions.find(index) {
            mission.interrupt(why);
        }
    }

    pub(crate) fn record_mission_estimate(&mut self, index: RobotIndex, estimate: &Estimate) {
        let now = self.time.now;
        if let Some(mission) = self.missions.find(index) {
            mission.record_estimate(now, estimate);
        }
    }

    /// Sends what missions give.
    pub(crate) fn run_missions(&mut self) {
        if self.missions.is_empty() {
            return;
        }
        let now = self.time.now;
        for index in self.missions.take_ready(now) {
            let origin = self.robots.get(index).extractor.origin;
            for action in self.missions.advance(now, index, origin) {
                self.perform(index, action);
            }
        }
    }

    /// The mission of a robot; a new one knows the robot's present estimate.
    fn open_mission(&mut self, index: RobotIndex) -> &mut Mission {
        if self.missions.find(index).is_none() {
            let robot = self.robots.get(index);
            let known = robot.last_seen.map(|(_, last)| last).zip(robot.estimator.latest_estimate());
            if let Some((last, estimate)) = known {
                self.missions.open(index).record_estimate(last, &estimate);
            }
        }
        self.missions.open(index)
    }

    fn perform(&mut self, index: RobotIndex, action: MissionAction) {
        let robot = self.robots.get(index);
        let role = SenderRole::Vehicle(robot.id);
        match action {
            MissionAction::Answer(client, message) => {
                self.transmitter().send_session_message(client.endpoint.link, role, &message);
            }
            MissionAction::Announce(message) => {
                let links: Vec<LinkId> = self.sessions.ground_station_links().collect();
                for link in links {
                    self.transmitter().send_session_message(link, role, &message);
                }
            }
            MissionAction::Drive(setpoint) => self.send_setpoint(index, setpoint),
            MissionAction::Report { severity, text } => {
                self.report_own_text(severity, self.robots.labelled(index, &text));
            }
        }
    }

    /// Sends a robot where to drive, if it is this station's; what is lost is not sent again here.
    pub(crate) fn send_setpoint(&mut self, index: RobotIndex, setpoint: Setpoint) {
        let robot = self.robots.get(index);
        if robot.ownership().is_standby() {
            return;
        }
        let target = robot.wire_address;
        let Some((endpoint, _)) = robot.last_seen else {
            return;
        };
        if self.links.get(&endpoint.link).is_some_and(|link| link.state == LinkState::Up) {
            let message = Message::PositionTarget(PositionTarget { target, setpoint });
            self.transmitter().send_to_peer(endpoint, &message, Priority::Command);
        }
    }
}

/// The system that a message steers.
#[expect(clippy::wildcard_enum_match_arm, reason = "only these steer, however many kinds of messages there are")]
const fn steered_system(message: &Message) -> Option<SystemId> {
    match message {
        Message::ManualControl(control) => Some(control.system),
        Message::PositionTarget(request) => Some(request.target.system),
        _ => None,
    }
}

//! Commands and requests to a running station: tunables, pose, calibration, sensors, recordings.
//!
//! A command of the program is an input of its own. A request over a link is part of the link's bytes, which are the
//! input: it is carried out when the bytes are handled and never becomes a second input, so that a replay does it once
//! and at the same point.
//!
//! Every command emits an [`Event::Text`]; the sender of a rejected request over a link gets the reason. Values of
//! tunables come over links as 32-bit floats and are converted to the shortest decimal number with these bits: 0.999
//! there is 0.999 in the configuration.
//!
//! # Sources
//! MAVLink guide, "Parameter Protocol" and "Command Protocol"; docs/ground-stations.md.

use posebridge_estimator::{FilterCommand, PARAMS, Params};
use posebridge_protocol::dialect::commands::{CommandError, decode_command};
use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{CommandResult, Message, Setpoint};
use posebridge_telemetry::{
    Address, Command, Event, FilterComparison, FusionOutcome, LinkId, LinkState, MetersPerSecond, OnlineCalibration,
    Output, ParameterName, ParameterStorage, Priority, RadiansPerSecond, Request, RobotId, SensorId, SensorSwitch,
    SimulatorCommand, StartPose, severity,
};

use crate::link_command::LinkCommand;
use crate::message_requests::{RequestContext, RequestReply};
use crate::operator::{CommandTarget, TargetedCommand};
use crate::receive::ReceiveInfo;
use crate::robot::Robot;
use crate::sender_identity::RobotIndex;
use crate::sessions::SenderRole;
use crate::station::Station;

/// The effect of a command, or the reason why it was rejected: a line for people.
type CommandOutcome = Result<String, String>;

impl Station {
    pub(crate) fn handle_command(&mut self, command: Command) {
        self.handle_targeted_command(TargetedCommand { target: CommandTarget::Station, command });
    }

    pub(crate) fn handle_robot_command(&mut self, robot: RobotId, command: Command) {
        match self.robots.find(robot) {
            Some(index) => {
                self.handle_targeted_command(TargetedCommand { target: CommandTarget::Robot(index), command });
            }
            None => self.report_outcome(&Err(format!("no robot {robot}"))),
        }
    }

    fn handle_targeted_command(&mut self, command: TargetedCommand) {
        let is_held_key = self.operator.is_key_repeat(command);
        let outcome = self.execute(command);
        // One line for a key that is held, not several each second.
        if !(is_held_key && outcome.is_ok()) {
            self.report_outcome(&outcome);
        }
    }

    /// Handles the result of the program's work.
    pub(crate) fn handle_report(&mut self, severity: u8, text: &str) {
        // A note for programs that read the recording.
        if severity >= severity::DEBUG {
            return;
        }
        if self.sessions.has_ground_stations() {
            self.status_texts.push_report(self.time.now, severity, text);
        }
        self.outputs.emit(Event::Text { source: self.config.own_address, severity, text: text.to_owned() });
        if let Some(link) = self.operator.requested_on {
            self.send_text_answer(link, severity, text);
        }
    }

    pub(crate) fn handle_parameter_set(&mut self, link: LinkId, role: SenderRole, index: usize, value: f32) {
        let Some(row) = PARAMS.get(index) else {
            return;
        };
        let name = ParameterName::from_bytes(row.key.as_bytes());
        let command = Command::SetParameter { name, value: shortest_decimal(value) };
        let outcome = self.execute(TargetedCommand { target: CommandTarget::Station, command });
        // That nothing has changed is an answer, too.
        self.answer_parameter_set(link, role, index);
        self.report_outcome(&outcome);
        if let Err(why) = &outcome {
            self.send_text_answer(link, severity::WARNING, why);
        }
    }

    /// A peer sets a tunable with an unreadable type: without a reply it would repeat the request until it gives up.
    pub(crate) fn handle_unsupported_type(&mut self, link: LinkId, role: SenderRole, index: usize, kind: u8) {
        let Some(row) = PARAMS.get(index) else {
            return;
        };
        // 9 is REAL32. Short, because it has to fit into a STATUSTEXT.
        let why = format!("{}: send MAV_PARAM_TYPE 9, not {kind}", row.key);
        self.answer_parameter_set(link, role, index);
        self.send_text_answer(link, severity::WARNING, &why);
        self.report_own_text(severity::WARNING, why);
    }

    pub(crate) fn handle_unknown_parameter(&mut self, link: LinkId, requested: &str) {
        let why = format!("no parameter `{}`", ParameterName::from_bytes(requested.as_bytes()));
        self.send_text_answer(link, severity::WARNING, &why);
        self.report_own_text(severity::WARNING, why);
    }

    /// A command from a link that no session handles itself.
    pub(crate) fn handle_link_command(
        &mut self,
        received: ReceiveInfo,
        role: SenderRole,
        by: Address,
        request: &LinkCommand,
    ) {
        let id = received.endpoint.link;
        let command = &request.command;
        let requester = self.requesting_robot(received, by);
        let context = RequestContext {
            config: &self.config,
            now: self.time.now,
            robots: &self.robots,
            link: id,
            role,
            requester,
        };
        let heartbeat = self.sessions.with_session(id, role, |session| session.active_heartbeat()).flatten();
        let answer = match context.answer(command, heartbeat) {
            Some(answer) => answer,
            None => RequestReply::of(self.execute_link_command(id, role, requester, request)),
        };
        // A vehicle is never silent, as an autopilot is not: a ground station would repeat the command until it gives up.
        if role == SenderRole::Station && answer.may_be_left_to_others(command) {
            return;
        }
        self.sessions.with_session(id, role, |session| {
            session.acknowledge_command(by, command.command, answer.result);
        });
        match requester.filter(|_| role == SenderRole::Station && self.robots.at_home(id, &self.router).len() > 1) {
            // What is one robot's would mislead the others of the link.
            Some(_) => {
                self.drain_sessions(received);
                for message in &answer.messages {
                    self.transmitter().send_to_peer(received.endpoint, message, Priority::Command);
                }
            }
            None => {
                self.sessions.with_session(id, role, |session| {
                    for message in answer.messages {
                        session.queue_message(message);
                    }
                });
            }
        }
    }

    /// The robot that sends a request; `None` if the sender is not a robot.
    pub(crate) fn requesting_robot(&self, received: ReceiveInfo, by: Address) -> Option<RobotIndex> {
        let home = self.router.first_of_group(received.endpoint.link);
        self.robots.identities.find(received.endpoint, home, by)
    }

    /// Carries out a command from a link, and reports the result. A robot as a vehicle accepts only commands about
    /// robots and parameters.
    fn execute_link_command(
        &mut self,
        link: LinkId,
        role: SenderRole,
        requester: Option<RobotIndex>,
        request: &LinkCommand,
    ) -> CommandResult {
        let command = &request.command;
        if let SenderRole::Vehicle(robot) = role
            && ids::is_drive_command(command.command)
            && let Some(index) = self.robots.find(robot).filter(|index| self.robots.get(*index).accepts_goals)
        {
            return self.execute_drive_command(index, request);
        }
        let target = match role {
            // A robot among others means itself.
            SenderRole::Station => Some(match requester.filter(|_| self.robots.len() > 1) {
                Some(robot) => CommandTarget::Robot(robot),
                None => CommandTarget::Station,
            }),
            SenderRole::Vehicle(robot) => self.robots.find(robot).map(CommandTarget::Robot),
        };
        let Some(target) = target else {
            return CommandResult::Unsupported;
        };
        let outcome = match decode_command(command) {
            Ok(command) if role != SenderRole::Station && !is_for_vehicle(command) => {
                return CommandResult::Unsupported;
            }
            Ok(command) => {
                self.operator.requested_on = Some(link);
                self.execute(TargetedCommand { target, command })
            }
            Err(CommandError::Unknown { .. }) => return CommandResult::Unsupported,
            Err(error) => Err(error.to_string()),
        };
        self.report_outcome(&outcome);
        match outcome {
            Ok(_) => CommandResult::Accepted,
            Err(why) => {
                self.send_text_answer(link, severity::WARNING, &why);
                CommandResult::Denied
            }
        }
    }

    /// Carries out a command; the text about one robot begins with its name.
    fn execute(&mut self, TargetedCommand { target, command }: TargetedCommand) -> CommandOutcome {
        let outcome = self.carry_out(target, command);
        match target {
            CommandTarget::Robot(index) if command.is_for_robots() => {
                let robot = self.robots.get(index).id;
                outcome.map(|done| format!("robot {robot}: {done}")).map_err(|why| format!("robot {robot}: {why}"))
            }
            CommandTarget::Robot(_) | CommandTarget::Station => outcome,
        }
    }

    /// Fails for a command to a robot that another station owns.
    fn require_owned(&self, target: CommandTarget, command: &Command) -> Result<(), String> {
        let is_for_one = match target {
            CommandTarget::Robot(_) => command.is_for_robots(),
            CommandTarget::Station => matches!(
                command,
                Command::SetPose { .. } | Command::ResetPose | Command::Drive { .. } | Command::Simulator(_)
            ),
        };
        let robot = self.robots.get(target.posed_robot());
        if is_for_one && robot.ownership().is_standby() { Err(robot.owned_elsewhere()) } else { Ok(()) }
    }

    fn carry_out(&mut self, target: CommandTarget, command: Command) -> CommandOutcome {
        self.require_owned(target, &command)?;
        match command {
            Command::SetPose { pose, position_sigma_m, heading_sigma_rad } => {
                self.set_pose(target.posed_robot(), &StartPose { pose, position_sigma_m, heading_sigma_rad })
            }
            Command::ResetPose => self.reset_pose(target.posed_robot()),
            Command::SetParameter { name, value } => self.set_parameter(name, value),
            Command::Parameters(storage) => self.store_parameters(storage),
            Command::OnlineCalibration(learning) => {
                self.command_robots(target, "does not learn", &FilterCommand::SetOnlineCalibration(learning))?;
                if target == CommandTarget::Station {
                    self.robots.settings.online_calibration = Some(learning);
                }
                Ok(match learning {
                    OnlineCalibration::Frozen => "calibration frozen".to_owned(),
                    OnlineCalibration::Enabled => "calibration learned further".to_owned(),
                })
            }
            Command::ResetCalibration => {
                self.command_robots(target, "does not learn", &FilterCommand::ResetCalibration)?;
                Ok("calibration reset to what is configured".to_owned())
            }
            Command::SwitchSource { sensor, to } => Ok(self.switch_sensor(target, sensor, to)),
            Command::CompareFilters(to) => Ok(self.compare_filters(to)),
            Command::StartRecording => {
                let values = self.parameter_values();
                self.emit_request(Request::StartRecording { values });
                Ok("a new recording was asked for".to_owned())
            }
            Command::StopRecording => {
                self.emit_request(Request::StopRecording);
                Ok("the recording's end was asked for".to_owned())
            }
            Command::Drive { forward, turn } => self.drive(target, forward, turn),
            Command::Simulator(command) => {
                command.validate().map_err(|error| error.to_string())?;
                let robot = match target {
                    CommandTarget::Station => None,
                    CommandTarget::Robot(index) => Some(self.robots.get(index).id),
                };
                if matches!(command, SimulatorCommand::Drive { .. } | SimulatorCommand::Path) {
                    self.interrupt_missions(target);
                }
                self.emit_request(Request::Simulator { robot, command });
                Ok(command.to_string())
            }
        }
    }

    /// Sends a robot speeds, if it is one that takes goals.
    fn drive(&mut self, target: CommandTarget, forward: MetersPerSecond, turn: RadiansPerSecond) -> CommandOutcome {
        let index = target.posed_robot();
        if !(forward.0.is_finite() && turn.0.is_finite()) {
            return Err("not driven: a speed is not finite".to_owned());
        }
        if !self.robots.get(index).accepts_goals {
            return Err("not driven: the robot takes no speeds (`robot.accepts_goals`, docs/missions.md)".to_owned());
        }
        self.interrupt_missions(target);
        self.send_setpoint(index, Setpoint::BodyVelocity { forward, turn });
        Ok(format!("driven by a program: {} m/s, {} rad/s", forward.0, turn.0))
    }

    fn set_pose(&mut self, index: RobotIndex, start: &StartPose) -> CommandOutcome {
        self.robots.changed.insert(index);
        if self.robots.get_mut(index).set_pose(start) == FusionOutcome::Malformed {
            return Err("the pose was not set: a number is not finite or a sigma is negative".to_owned());
        }
        self.robots.keep_first_pose(Some(*start));
        let pose = &start.pose;
        Ok(format!("pose set to x {:.3} m, y {:.3} m, {:.1} deg", pose.x.0, pose.y.0, pose.heading.rad().to_degrees()))
    }

    fn reset_pose(&mut self, index: RobotIndex) -> CommandOutcome {
        if let Some(start) = self.robots.get(index).estimator.config.start {
            return self.set_pose(index, &start);
        }
        let robot = self.robots.get_mut(index);
        if !robot.apply(&FilterCommand::ResetPose) {
            return Err(format!("the filter {} cannot forget its pose", robot.estimator.entry.name));
        }
        self.robots.keep_first_pose(None);
        self.robots.changed.insert(index);
        Ok("pose forgotten: the next fix decides".to_owned())
    }

    fn set_parameter(&mut self, name: ParameterName, value: f64) -> CommandOutcome {
        let row = PARAMS.iter().find(|row| row.key == name.as_str());
        let row = row.ok_or_else(|| format!("no parameter `{name}`"))?;
        if !row.range.contains(&value) {
            // Short, because it has to fit into a STATUSTEXT.
            let (low, high) = (row.range.start(), row.range.end());
            return Err(format!("{name} {value:?} not in {low}..{high}"));
        }
        let mut params = self.config.robot.filter_config.params;
        let before = (row.read)(&params);
        (row.write)(&mut params, value);
        self.apply_params(params)?;
        Ok(format!("{name} set to {value} (was {before})"))
    }

    fn store_parameters(&mut self, storage: ParameterStorage) -> CommandOutcome {
        let params = match storage {
            ParameterStorage::Save => {
                self.operator.saved_params = self.config.robot.filter_config.params;
                let values = self.parameter_values();
                self.emit_request(Request::SaveParameters { values });
                return Ok("parameters handed over to be saved".to_owned());
            }
            ParameterStorage::Reload => self.operator.saved_params,
            ParameterStorage::Default => Params::default(),
        };
        self.apply_params(params)?;
        Ok(match storage {
            ParameterStorage::Default => "parameters set to their defaults".to_owned(),
            ParameterStorage::Save | ParameterStorage::Reload => "parameters as saved last".to_owned(),
        })
    }

    /// Sets tunables of the filter and reports those that changed.
    fn apply_params(&mut self, params: Params) -> Result<(), String> {
        // Thermometers have filters of their own, which begin with the tunables of the station.
        let command = FilterCommand::SetParams(params);
        self.command_robots(CommandTarget::Station, "is tuned only by its start", &command)?;
        let before = std::mem::replace(&mut self.config.robot.filter_config.params, params);
        for (index, row) in PARAMS.iter().enumerate() {
            if (row.read)(&before).to_bits() != (row.read)(&params).to_bits() {
                self.sessions.store_parameter(index, (row.read)(&params) as f32);
            }
        }
        Ok(())
    }

    /// Reports the value of a tunable to the one that has set it.
    fn answer_parameter_set(&mut self, link: LinkId, role: SenderRole, index: usize) {
        if let Some(report) = self.sessions.answer_parameter_set(link, role, index) {
            self.transmitter().send_session_message(link, role, &report);
        }
    }

    /// Sends a command to the estimators of the target robots; the first one that rejects it gives the reason.
    fn command_robots(
        &mut self,
        target: CommandTarget,
        otherwise: &str,
        command: &FilterCommand,
    ) -> Result<(), String> {
        let mut refused = None;
        for robot in self.targeted_robots(target) {
            if !robot.apply(command) {
                refused.get_or_insert(robot.estimator.entry.name);
            }
        }
        if target == CommandTarget::Station {
            for robot in self.robots.prepared_mut() {
                robot.apply(command);
            }
        }
        refused.map_or(Ok(()), |filter| Err(format!("the filter {filter} {otherwise}")))
    }

    fn targeted_robots(&mut self, target: CommandTarget) -> &mut [Robot] {
        match target {
            CommandTarget::Station => self.robots.all_mut(),
            CommandTarget::Robot(index) => std::slice::from_mut(self.robots.get_mut(index)),
        }
    }

    fn switch_sensor(&mut self, target: CommandTarget, sensor: SensorId, to: SensorSwitch) -> String {
        for robot in self.targeted_robots(target) {
            robot.switch_sensor(sensor, to);
        }
        if target == CommandTarget::Station {
            for robot in self.robots.prepared_mut() {
                robot.switch_sensor(sensor, to);
            }
            self.robots.settings.sensors.insert(sensor, to);
        }
        let is = match to {
            SensorSwitch::On => "used",
            SensorSwitch::Off => "left out",
        };
        format!("source {sensor} ({}) is {is}", sensor.name())
    }

    fn compare_filters(&mut self, to: FilterComparison) -> String {
        self.robots.settings.comparison = Some(to);
        let config = &self.config;
        for robot in self.robots.all_mut() {
            robot.compare_filters(to, config.robot_config(robot.block()));
        }
        match to {
            FilterComparison::On => {
                let names: Vec<_> = self.robots.first().compared.filters().collect();
                format!("compared: {}", names.join(", "))
            }
            FilterComparison::Off => "filters are compared no longer".to_owned(),
        }
    }

    fn parameter_values(&self) -> Vec<(ParameterName, f64)> {
        let params = &self.config.robot.filter_config.params;
        let named = PARAMS.iter().map(|row| {
            let name = ParameterName::from_bytes(row.key.as_bytes());
            (name, (row.read)(params))
        });
        named.collect()
    }

    fn emit_request(&mut self, request: Request) {
        self.outputs.push(Output::Request(request));
    }

    /// A status text to the sender of a request over a link; ground stations get it anyway, with all other texts of the
    /// station.
    fn send_text_answer(&mut self, link: LinkId, severity: u8, text: &str) {
        if !self.links.contains_key(&link) || self.sessions.vehicles(link).is_some() {
            return;
        }
        for part in self.status_texts.split_text(severity, text) {
            self.send_answer(link, &part);
        }
    }

    /// Sends a reply; it is lost if the link is down.
    fn send_answer(&mut self, link: LinkId, message: &Message) {
        if self.links.get(&link).is_some_and(|link| link.state == LinkState::Up) {
            self.transmitter().send(link, message, Priority::Command);
        }
    }

    fn report_outcome(&mut self, outcome: &CommandOutcome) {
        match outcome {
            Ok(done) => self.report_own_text(severity::INFO, done.clone()),
            Err(why) => self.report_own_text(severity::WARNING, why.clone()),
        }
    }

    pub(crate) fn report_own_text(&mut self, severity: u8, text: String) {
        let source = self.config.own_address;
        self.emit(Event::Text { source, severity, text });
    }
}

/// Whether a command may be given to a robot as a vehicle: those about robots, and about the parameters that are shown there.
const fn is_for_vehicle(command: Command) -> bool {
    command.is_for_robots() || matches!(command, Command::Parameters(_))
}

/// The shortest decimal number that has this value as a 32-bit float.
fn shortest_decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| f64::from(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_over_a_link_is_the_decimal_that_was_typed() {
        for typed in [0.999, 0.000_03, 148.0, 0.1, 1e-10, 500.0, -0.3] {
            assert_eq!(shortest_decimal(typed as f32), typed);
        }
        assert!(shortest_decimal(f32::NAN).is_nan());
        assert_eq!(shortest_decimal(f32::NEG_INFINITY), f64::NEG_INFINITY);
        assert!(shortest_decimal(f32::MAX).is_finite());
    }

    #[test]
    fn both_ends_of_every_range_can_be_set_over_a_link() {
        for row in PARAMS {
            for end in [*row.range.start(), *row.range.end()] {
                assert!(row.range.contains(&shortest_decimal(end as f32)), "{}", row.key);
            }
        }
    }
}

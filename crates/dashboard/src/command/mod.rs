//! Commands as JSON: `{"command": "<name>", ...fields}`, of those for a robot with `"robot": "<link>/<system>/<component>"`, or with
//! `"fleet_robot": "<name>"` for a robot of the fleet, which another station may own.
//!
//! [`COMMANDS`] is the table for parsing, validation, the schema and docs/dashboard.md. Input is untrusted, so an error
//! names the field, its value and the permitted ones.

mod fields;
mod table;

pub use fields::{CommandError, CommandField, FieldKind};
pub use table::{COMMANDS, CommandRow, CommandTarget, FLEET_ROBOT_FIELD, MAX_FLEET_ROBOT_CHARS, ROBOT_FIELD};

use posebridge_telemetry::{Command, Input, ParameterName, RobotId, SensorId, SimulatorCommand};
use serde_json::{Map, Value};

use crate::api::StationInfo;
use crate::model::ParameterRow;
use crate::views::parse_robot_name;
use fields::{FieldValues, format_value, one_of, truncate};

/// A valid JSON command, converted to the station's type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParsedCommand {
    pub name: &'static str,
    /// Target, if the command names one.
    pub robot: Option<RobotId>,
    pub command: Command,
}

impl ParsedCommand {
    pub const fn input(&self) -> Input {
        match self.robot {
            Some(robot) => Input::RobotCommand { robot, command: self.command },
            None => Input::Command(self.command),
        }
    }
}

/// A valid command that came from a person.
#[derive(Clone, Debug, PartialEq)]
pub enum CommandRequest {
    /// For this station.
    Own(ParsedCommand),
    Fleet(FleetRequest),
}

/// A command for a robot of the fleet. Its owner parses it again.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetRequest {
    pub name: &'static str,
    /// The robot's name in the fleet.
    pub robot: String,
    /// The JSON object without the robot.
    pub command: Value,
}

/// Parses a command that may be for a robot of the fleet.
pub fn parse_request(text: &[u8]) -> Result<CommandRequest, CommandError> {
    let mut fields = read_object(text)?;
    let Some(named) = fields.remove(FLEET_ROBOT_FIELD) else {
        return parse_object(fields).map(CommandRequest::Own);
    };
    let row = find_row(fields.get("command").cloned())?;
    match row.target {
        CommandTarget::Robot => {}
        CommandTarget::Station => {
            fields.insert(FLEET_ROBOT_FIELD.to_owned(), named);
            return parse_object(fields).map(CommandRequest::Own);
        }
    }
    if fields.contains_key(ROBOT_FIELD) {
        return Err(CommandError::TwoRobots { command: row.name });
    }
    let is_name = |text: &&str| (1..=MAX_FLEET_ROBOT_CHARS).contains(&text.len());
    let robot = named.as_str().filter(is_name).ok_or_else(|| CommandError::WrongValue {
        command: row.name,
        field: FLEET_ROBOT_FIELD,
        found: format_value(&named),
        wanted: "the name of a robot as /v1/fleet has it".to_owned(),
    })?;
    let ParsedCommand { name, .. } = parse_object(fields.clone())?;
    Ok(CommandRequest::Fleet(FleetRequest { name, robot: robot.to_owned(), command: Value::Object(fields) }))
}

/// Parses a command for this station.
pub fn parse(text: &[u8]) -> Result<ParsedCommand, CommandError> {
    parse_object(read_object(text)?)
}

fn read_object(text: &[u8]) -> Result<Map<String, Value>, CommandError> {
    let value: Value =
        serde_json::from_slice(text).map_err(|error| CommandError::InvalidJson { why: error.to_string() })?;
    match value {
        Value::Object(fields) => Ok(fields),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) | Value::Array(_) => {
            Err(CommandError::NotAnObject)
        }
    }
}

fn parse_object(mut fields: Map<String, Value>) -> Result<ParsedCommand, CommandError> {
    let row = find_row(fields.remove("command"))?;
    let robot = match row.target {
        CommandTarget::Robot => fields.remove(ROBOT_FIELD).map(|value| robot_of(row, &value)).transpose()?,
        CommandTarget::Station => None,
    };
    reject_unknown_fields(row, &fields)?;
    let values = FieldValues::read(row.name, row.fields, &fields)?;
    Ok(ParsedCommand { name: row.name, robot, command: (row.build)(&values) })
}

fn robot_of(row: &CommandRow, value: &Value) -> Result<RobotId, CommandError> {
    let robot = value.as_str().and_then(parse_robot_name);
    robot.ok_or_else(|| CommandError::WrongValue {
        command: row.name,
        field: ROBOT_FIELD,
        found: format_value(value),
        wanted: "the id of a robot as /v1/robots has it, such as \"0/1/1\"".to_owned(),
    })
}

fn find_row(name: Option<Value>) -> Result<&'static CommandRow, CommandError> {
    let known = || {
        let names: Vec<&str> = COMMANDS.iter().map(|row| row.name).collect();
        names.join(", ")
    };
    let name = match name {
        None => return Err(CommandError::MissingName { known: known() }),
        Some(Value::String(name)) => name,
        Some(other) => format_value(&other),
    };
    let row = COMMANDS.iter().find(|row| row.name == name);
    row.ok_or_else(|| CommandError::UnknownName { name: truncate(&name), known: known() })
}

fn reject_unknown_fields(row: &CommandRow, found: &Map<String, Value>) -> Result<(), CommandError> {
    let is_known = |key: &&String| row.fields.iter().any(|field| field.name == **key);
    let Some(unknown) = found.keys().find(|key| !is_known(key)) else {
        return Ok(());
    };
    let robot = (row.target == CommandTarget::Robot).then_some(ROBOT_FIELD);
    let known: Vec<&str> = row.fields.iter().map(|field| field.name).chain(robot).collect();
    Err(CommandError::UnknownField {
        command: row.name,
        field: truncate(unknown),
        known: if known.is_empty() { "none".to_owned() } else { known.join(", ") },
    })
}

/// The names that commands may use at this station, to check a well-formed command against.
///
/// The station checks again, because commands come over links as well. Its rejections are in the log; those here go to
/// the sender.
pub(crate) struct CommandContext {
    parameters: Vec<ParameterRow>,
    /// The link profiles of the simulated brick, if there is one.
    profiles: Option<Vec<String>>,
}

impl CommandContext {
    pub(crate) fn from_info(info: &StationInfo) -> Self {
        let simulator = info.simulator.as_ref();
        Self {
            parameters: info.parameters.clone(),
            profiles: simulator.map(|simulator| simulator.link_profiles.clone()),
        }
    }

    /// Checks a command; `name` is its name in JSON.
    pub(crate) fn validate(&self, name: &'static str, command: &Command) -> Result<(), CommandError> {
        let fault = match command {
            Command::SetParameter { name, value } => self.parameter_fault(*name, *value),
            Command::SwitchSource { sensor, .. } => sensor_fault(*sensor),
            Command::Simulator(simulated) => {
                let profiles = self.profiles.as_deref();
                let profiles = profiles.ok_or(CommandError::NoSimulator { command: name })?;
                simulator_fault(simulated, profiles)
            }
            Command::SetPose { .. }
            | Command::ResetPose
            | Command::Parameters(_)
            | Command::OnlineCalibration(_)
            | Command::ResetCalibration
            | Command::Drive { .. }
            | Command::StartRecording
            | Command::CompareFilters(_)
            | Command::StopRecording => None,
        };
        fault.map_or(Ok(()), |fault| {
            Err(CommandError::WrongValue {
                command: name,
                field: fault.field,
                found: format_value(&fault.found),
                wanted: fault.expected,
            })
        })
    }

    fn parameter_fault(&self, name: ParameterName, value: f64) -> Option<FieldFault> {
        let row = self.parameters.iter().find(|row| row.name == name.as_str());
        let Some(row) = row else {
            return Some(FieldFault {
                field: "name",
                found: name.as_str().into(),
                expected: "a name of /v1/parameters".to_owned(),
            });
        };
        let is_within = (row.least..=row.most).contains(&value);
        (!is_within).then(|| FieldFault {
            field: "value",
            found: value.into(),
            expected: format!("a number from {} to {} for `{name}`", row.least, row.most),
        })
    }
}

struct FieldFault {
    field: &'static str,
    found: Value,
    expected: String,
}

fn sensor_fault(sensor: SensorId) -> Option<FieldFault> {
    // A sensor that was not seen yet may be switched off in advance.
    (!sensor.is_known()).then(|| FieldFault {
        field: "sensor",
        found: sensor.0.into(),
        expected: "the number of a sensor, as listed by /v1/sources".to_owned(),
    })
}

fn simulator_fault(command: &SimulatorCommand, profiles: &[String]) -> Option<FieldFault> {
    match command {
        SimulatorCommand::LinkProfile(Some(name)) => {
            let is_known = profiles.iter().any(|profile| profile == name.as_str());
            (!is_known).then(|| FieldFault {
                field: "profile",
                found: name.as_str().into(),
                expected: format!("{}, or null", one_of(profiles)),
            })
        }
        // Their ranges were checked by the parser.
        SimulatorCommand::LinkProfile(None)
        | SimulatorCommand::Kidnap { .. }
        | SimulatorCommand::Slip { .. }
        | SimulatorCommand::Camera(_)
        | SimulatorCommand::CameraDelay { .. }
        | SimulatorCommand::GyroBiasStep { .. }
        | SimulatorCommand::PullCable { .. }
        | SimulatorCommand::Steering(_)
        | SimulatorCommand::Drive { .. }
        | SimulatorCommand::Path => None,
    }
}

#[cfg(test)]
mod tests;

//! Checks a well-formed command against this station.
//!
//! The station checks again, because commands come over links as well. Its rejections are in the log; those here go to
//! the sender.

use posebridge_telemetry::{Command, ParameterName, SensorId, SimulatorCommand};
use serde_json::Value;

use super::error::CommandError;
use super::fields::{format_value, one_of};
use crate::api::StationInfo;
use crate::model::ParameterRow;

/// The names that commands may use at this station.
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
    ///
    /// # Errors
    /// It names something that this station does not have, or a value is out of its range.
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
            | Command::StartRecording
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

/// An invalid field.
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

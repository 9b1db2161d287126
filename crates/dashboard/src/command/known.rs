//! What this station has: whether a command that makes sense can be carried out here.
//!
//! The engine looks again, because commands come from links as well. What it refuses stands in the log; what is refused here is told to
//! whoever asked.

use posebridge_telemetry::{Command, ParameterName, SensorId, SimulatorCommand};
use serde_json::Value;

use super::CommandError;
use super::fields::{one_of, shown};
use crate::model::ParameterRow;
use crate::thread::Facts;

/// What commands may name at this station.
pub(crate) struct Known {
    parameters: Vec<ParameterRow>,
    /// The link profiles of the simulated brick, if there is one.
    profiles: Option<Vec<String>>,
}

impl Known {
    /// Of a station with these facts.
    pub(crate) fn of(facts: &Facts) -> Self {
        let simulator = facts.simulator.as_ref();
        Self {
            parameters: facts.parameters.clone(),
            profiles: simulator.map(|simulator| simulator.link_profiles.clone()),
        }
    }

    /// Looks at a command, by the name that it was given.
    ///
    /// # Errors
    /// It names what is not here, or a value out of its range.
    pub(crate) fn check(&self, name: &'static str, command: &Command) -> Result<(), CommandError> {
        let fault = match command {
            Command::SetParameter { name, value } => self.fault_of_parameter(*name, *value),
            Command::SwitchSource { sensor, .. } => fault_of_sensor(*sensor),
            Command::Simulator(simulated) => {
                let profiles = self.profiles.as_deref();
                let profiles = profiles.ok_or(CommandError::NoSimulator { command: name })?;
                fault_of_simulated(simulated, profiles)
            }
            Command::SetPose { .. }
            | Command::ResetPose
            | Command::Parameters(_)
            | Command::Learning(_)
            | Command::ResetCalibration
            | Command::StartRecording
            | Command::StopRecording => None,
        };
        fault.map_or(Ok(()), |fault| {
            Err(CommandError::Wrong {
                command: name,
                field: fault.field,
                found: shown(&fault.found),
                wanted: fault.wanted,
            })
        })
    }

    fn fault_of_parameter(&self, name: ParameterName, value: f64) -> Option<Fault> {
        let row = self.parameters.iter().find(|row| row.name == name.as_str());
        let Some(row) = row else {
            return Some(Fault {
                field: "name",
                found: name.as_str().into(),
                wanted: "a name of /v1/parameters".to_owned(),
            });
        };
        let is_within = (row.least..=row.most).contains(&value);
        (!is_within).then(|| Fault {
            field: "value",
            found: value.into(),
            wanted: format!("a number from {} to {} for `{name}`", row.least, row.most),
        })
    }
}

/// What is wrong with a field.
struct Fault {
    field: &'static str,
    found: Value,
    wanted: String,
}

fn fault_of_sensor(sensor: SensorId) -> Option<Fault> {
    // One that was not heard yet may be left out from its first word.
    (!sensor.is_known()).then(|| Fault {
        field: "sensor",
        found: sensor.0.into(),
        wanted: "the number of a sensor, as /v1/sources tells them".to_owned(),
    })
}

fn fault_of_simulated(command: &SimulatorCommand, profiles: &[String]) -> Option<Fault> {
    match command {
        SimulatorCommand::LinkProfile(Some(name)) => {
            let is_known = profiles.iter().any(|profile| profile == name.as_str());
            (!is_known).then(|| Fault {
                field: "profile",
                found: name.as_str().into(),
                wanted: format!("{}, or null", one_of(profiles)),
            })
        }
        // Their ranges were looked at when they were read.
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

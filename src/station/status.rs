//! What stands in a station at an instant, as the page shows it.

use std::path::Path;

use posebridge_dashboard::model::{CalibrationRow, ParameterValue};
use posebridge_dashboard::{RobotStatus, StationStatus};
use posebridge_estimator::{PARAMS, Params};
use posebridge_station::{Robot, Station};
use posebridge_telemetry::Calibration;

use super::recorder::Recorder;
use crate::config::CALIBRATION_KEYS;

/// What stands in a station, and into which file it is recorded.
pub fn station_status(station: &Station, recorder: Option<&Recorder>) -> StationStatus {
    let recording = recorder.map(Recorder::current);
    let name = recording.as_deref().and_then(Path::file_name);
    StationStatus {
        robots: station.robots().iter().map(robot_status).collect(),
        parameters: parameter_values(station.params()),
        recording: name.map(|name| name.to_string_lossy().into_owned()),
        switched_off: station.switched_off().map(|sensor| sensor.0).collect(),
        simulator: None,
    }
}

fn robot_status(robot: &Robot) -> RobotStatus {
    RobotStatus {
        robot: robot.id(),
        calibration: robot.calibration().map_or_else(Vec::new, |learned| calibration_rows(&learned)),
        switched_off: robot.switched_off().map(|sensor| sensor.0).collect(),
    }
}

/// What was learned about a robot, as the page shows it.
fn calibration_rows(learned: &Calibration) -> Vec<CalibrationRow> {
    let rows = CALIBRATION_KEYS.iter().map(|row| {
        let known = (row.read)(learned);
        CalibrationRow {
            name: row.key.to_owned(),
            value: known.value,
            sigma: known.sigma,
            unit: unit_of(row.key).to_owned(),
            ..CalibrationRow::default()
        }
    });
    rows.collect()
}

fn parameter_values(params: &Params) -> Vec<ParameterValue> {
    let values = PARAMS.iter().map(|row| ParameterValue { name: row.key.to_owned(), value: (row.read)(params) });
    values.collect()
}

/// The unit that stands in a key's name.
fn unit_of(key: &str) -> &'static str {
    let units = [("_rad_per_s", "rad/s"), ("_s", "s"), ("_m", "m")];
    let found = units.iter().find(|(ending, _)| key.ends_with(ending));
    found.map_or("", |(_, unit)| unit)
}

//! Drives of the simulated brick in virtual time, recorded as `posebridge run` would have recorded them.
#![allow(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]
#![allow(dead_code, reason = "not every program with this module uses all of it")]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

use std::fs::File;
use std::path::Path;

use posebridge::config::Config;
use posebridge::virtual_station::{self, RunEvent, RunScript};
use posebridge_recording::container::{FORMAT, RecordingHeader, RecordingWriter, TruthSample};
use posebridge_sim::{Scenario, Simulation};
use posebridge_telemetry::{TimeDelta, Timestamp};

/// Longer than any recorded drive.
const A_DAY: TimeDelta = TimeDelta::from_millis(86_400_000);

/// Drives to the end of the path and then for `rest`; every input of the station is recorded.
pub(crate) fn record_drive(path: &Path, scenario: Scenario, rest: TimeDelta) {
    let (writer, _) = drive(path, &Config::default(), scenario, rest);
    writer.finish().unwrap();
}

/// The same with the true path in the recording.
pub(crate) fn record_drive_and_truth(path: &Path, scenario: Scenario, rest: TimeDelta) {
    record_configured_drive(path, &Config::default(), scenario, rest);
}

/// The same by a station with another configuration.
pub(crate) fn record_configured_drive(path: &Path, config: &Config, scenario: Scenario, rest: TimeDelta) {
    let (mut writer, simulation) = drive(path, config, scenario, rest);
    let samples = simulation.truth().iter().map(|sample| TruthSample {
        robot: None,
        time: sample.brick_time,
        pose: sample.pose,
        odometry: Some(sample.odometry),
    });
    let truth: Vec<TruthSample> = samples.collect();
    writer.record_truth(Timestamp::ZERO + simulation.elapsed(), &truth).unwrap();
    writer.finish().unwrap();
}

fn drive(path: &Path, config: &Config, scenario: Scenario, rest: TimeDelta) -> (RecordingWriter<File>, Simulation) {
    let config = config.clone().with_camera_of(&scenario);
    let header = RecordingHeader {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros: 0,
        config_toml: toml::to_string(&config).unwrap(),
        links: vec!["sim://".to_owned()],
    };
    let mut writer = RecordingWriter::create(File::create(path).unwrap(), &header).unwrap();
    let script = RunScript {
        commands: &[],
        until: A_DAY,
        linger: rest,
        observer: &mut |now, event| {
            if let RunEvent::Input(input) = event {
                writer.record(now, input).unwrap();
            }
        },
    };
    let run = virtual_station::run_with(scenario, config.station_config().unwrap(), script).unwrap();
    (writer, run.simulation)
}

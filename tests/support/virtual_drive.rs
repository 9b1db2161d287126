//! A drive of the simulated brick, recorded as `posebridge run` would have recorded it, in virtual time.
#![allow(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]
#![allow(dead_code, reason = "each test file uses its own part of this")]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

use std::fs::File;
use std::path::Path;

use posebridge::config::Config;
use posebridge_recording::container::{FORMAT, RecordingHeader, RecordingWriter, TruthSample};
use posebridge_sim::{Scenario, Simulation};
use posebridge_station::Station;
use posebridge_telemetry::{Input, LinkId, LinkState, Output, PeerId, TimeDelta, Timestamp};

/// Drives to the end of the path and then for `rest`; every input of the station is written down.
pub(crate) fn record_drive(path: &Path, scenario: Scenario, rest: TimeDelta) {
    let (writer, _) = drive(path, scenario, rest);
    writer.finish().unwrap();
}

/// The same, and where the robot really was.
pub(crate) fn record_drive_and_truth(path: &Path, scenario: Scenario, rest: TimeDelta) {
    let (mut writer, simulation) = drive(path, scenario, rest);
    let samples = simulation.truth().iter();
    let truth: Vec<TruthSample> = samples
        .map(|sample| TruthSample {
            robot: None,
            time: sample.brick_time,
            pose: sample.pose,
            odometry: Some(sample.odometry),
        })
        .collect();
    let now = Timestamp::ZERO + simulation.elapsed();
    writer.record_truth(now, &truth).unwrap();
    writer.finish().unwrap();
}

fn drive(path: &Path, scenario: Scenario, rest: TimeDelta) -> (RecordingWriter<File>, Simulation) {
    let config = Config::default().with_tag_of(&scenario);
    let header = RecordingHeader {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros: 0,
        config_toml: toml::to_string(&config).unwrap(),
        links: vec!["sim://".to_owned()],
    };
    let mut station = Station::new(config.station_config().unwrap(), Timestamp::ZERO).unwrap();
    let mut simulation = Simulation::new(scenario);
    let mut writer = RecordingWriter::create(File::create(path).unwrap(), &header).unwrap();
    let link = LinkId(0);
    let mut inputs = vec![Input::Link { link, state: LinkState::Up }];
    let mut ends_at = None;
    while ends_at.is_none_or(|end| simulation.elapsed() < end) {
        let now = Timestamp::ZERO + simulation.elapsed();
        if station.deadline().is_some_and(|deadline| deadline <= now) {
            inputs.push(Input::Tick);
        }
        for input in inputs.drain(..) {
            writer.record(now, &input).unwrap();
            station.handle(now, &input);
            while let Some(output) = station.poll() {
                if let Output::Transmit { bytes, .. } = output {
                    simulation.receive(&bytes);
                }
            }
        }
        simulation.step();
        while let Some(bytes) = simulation.poll() {
            let peer = PeerId::default();
            inputs.push(Input::Bytes { link, peer, bytes });
        }
        if simulation.is_finished() && ends_at.is_none() {
            ends_at = Some(simulation.elapsed() + rest);
        }
    }
    (writer, simulation)
}

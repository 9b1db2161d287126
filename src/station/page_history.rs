//! State and trails of a station for the dashboard page. Those of a recording come from the same engine and the same views as live.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_dashboard::model::{CalibrationRow, Frame, ParameterValue};
use posebridge_dashboard::{RobotStatus, SessionViews, SimulatedTruth, StationStatus};
use posebridge_estimator::PARAMS;
use posebridge_recording::container::{self, RecordingReader};
use posebridge_station::{RecordedStations, Robot, Station};
use posebridge_telemetry::severity::WARNING;
use posebridge_telemetry::{Address, Calibration, Event, HostClock, Output, RobotId, TimeDelta, Timestamp};

use super::dead_reckoning::dead_reckoning;
use super::input_file::InputFile;
use super::recorded_session::{ClockAlignment, ExcessPolicy, MemoryLimit, RecordingWarnings, own_bytes};
use super::recorder::Recorder;
use super::signing::recorded_stations;
use crate::config::{Config, Overlay, config_with_overlay, learnable_keys};

/// Period of the state, as in a live session.
const SECOND: TimeDelta = TimeDelta::from_millis(1_000);
/// A replay in the page shares memory and cores with a steering station: larger recordings, some hours of the bundled brick, require
/// `posebridge replay`, or start with a later part.
const MEMORY_LIMIT: MemoryLimit = MemoryLimit { max_bytes: 256 << 20, on_excess: ExcessPolicy::Skip };

/// Replays a recording through the engine and collects its trails. Missing, damaged or truncated data comes first in its log.
pub fn build_history(path: &Path) -> Result<Frame> {
    let name = path.display();
    let (bytes, found) = own_bytes(path, InputFile::open(path)?, MEMORY_LIMIT)?;
    let mut reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let config = config_with_overlay(&reader.header().config_toml, Overlay::default())?;
    let truth = container::read_truth(&bytes).with_context(|| format!("the truth in `{name}`"))?;
    let mut builder = PageHistoryBuilder::new(&config, truth)?;
    let mut notes = RecordingWarnings::from_notes(&found);
    notes.add_missing_start(reader.part_header());
    for item in &mut reader {
        match item {
            Ok((now, input)) => {
                builder.stations.handle(now, &input);
                builder.advance_to(now);
            }
            Err(error) => notes.add_damage(&error),
        }
    }
    notes.add_ending(&reader.recording_end());
    // As the station itself, which says what is wrong.
    Ok(builder.history(notes, Address::new(config.station.system, config.station.component)))
}

#[derive(Clone, Copy, Debug, Default)]
struct RobotClock {
    exchanged: Option<ClockAlignment>,
    /// From the last estimate, for a brick that never answers time requests.
    received: Option<ClockAlignment>,
}

struct PageHistoryBuilder {
    stations: RecordedStations,
    views: SessionViews,
    /// Sorted by each robot's own clock; `None` is the only one.
    truth: BTreeMap<Option<RobotId>, VecDeque<container::TruthSample>>,
    clocks: BTreeMap<RobotId, RobotClock>,
    begun: Option<Timestamp<HostClock>>,
    next_second: Timestamp<HostClock>,
}

impl PageHistoryBuilder {
    fn new(config: &Config, samples: Vec<container::TruthSample>) -> Result<Self> {
        let is_simulated = !samples.is_empty();
        let mut truth: BTreeMap<Option<RobotId>, VecDeque<container::TruthSample>> = BTreeMap::new();
        for sample in samples {
            truth.entry(sample.robot).or_default().push_back(sample);
        }
        let links = config.links.iter().map(|link| link.url.clone());
        let odometry = if is_simulated { None } else { dead_reckoning(config.filter_config()?) };
        Ok(Self {
            stations: recorded_stations(config, &[])?,
            views: SessionViews::new(links.collect(), odometry),
            truth,
            clocks: BTreeMap::new(),
            begun: None,
            next_second: Timestamp::ZERO,
        })
    }

    /// Adds the outputs of an input, and the truth until then.
    fn advance_to(&mut self, now: Timestamp<HostClock>) {
        self.begun.get_or_insert(now);
        while let Some(output) = self.stations.poll() {
            if let Output::Event(event) = output {
                self.align(now, &event);
                self.publish_truth(now);
                self.views.push_event(now, &event);
            }
        }
        if now >= self.next_second {
            self.next_second = now + SECOND;
            self.publish_status();
        }
    }

    fn align(&mut self, now: Timestamp<HostClock>, event: &Event) {
        if let Event::BrickClockAligned { robot, .. } = event {
            let clock = self.clocks.entry(*robot).or_default();
            clock.exchanged = ClockAlignment::from_event(event).or(clock.exchanged);
        }
        if let Event::EstimateUpdated { robot, estimate } = event {
            let received = ClockAlignment { host: now, brick: estimate.stamp, skew_ppm: 0.0 };
            self.clocks.entry(*robot).or_default().received = Some(received);
        }
    }

    /// Adds the truth as in a live session: each sample at its own instant, by the clock alignment valid then.
    fn publish_truth(&mut self, until: Timestamp<HostClock>) {
        for (robot, truth) in &mut self.truth {
            let clock = match robot {
                Some(robot) => self.clocks.get(robot),
                None => self.clocks.values().next(),
            };
            let Some(aligned) = clock.and_then(|clock| clock.exchanged.or(clock.received)) else {
                continue;
            };
            while let Some(sample) = truth.front() {
                let now = aligned.host_at(sample.time);
                if now > until {
                    break;
                }
                self.views.push_truth(&SimulatedTruth {
                    robot: *robot,
                    now: now.max(Timestamp::ZERO),
                    time: sample.time,
                    pose: sample.pose,
                    odometry: sample.odometry,
                });
                truth.pop_front();
            }
        }
    }

    fn publish_status(&mut self) {
        let robots = self.stations.robots().map(robot_status).collect();
        self.views.push_status(&StationStatus { robots, ..station_status(self.stations.first(), None) });
    }

    fn history(mut self, notes: RecordingWarnings, source: Address) -> Frame {
        self.publish_status();
        let begun = self.begun.unwrap_or(Timestamp::ZERO);
        let mut history = self.views.history();
        let mut noted = SessionViews::new(Vec::new(), None);
        for text in notes.into_lines() {
            // What is missing makes the replay another one than the live run.
            let event = Event::Text { source, severity: WARNING, text };
            noted.push_event(begun, &event);
        }
        history.log.splice(0..0, noted.history().log);
        history
    }
}

pub fn station_status(station: &Station, recorder: Option<&Recorder>) -> StationStatus {
    let params = station.params();
    let recording = recorder.map(Recorder::current);
    let name = recording.as_deref().and_then(Path::file_name);
    StationStatus {
        robots: station.robots().iter().map(robot_status).collect(),
        parameters: PARAMS
            .iter()
            .map(|row| ParameterValue { name: row.key.into(), value: (row.read)(params) })
            .collect(),
        recording: name.map(|name| name.to_string_lossy().into_owned()),
        switched_off: station.first_robot().switched_off().map(|sensor| sensor.0).collect(),
        is_comparing: station.first_robot().compared_filters().next().is_some(),
        simulator: None,
        setup: Vec::new(),
        loop_stalls: 0,
    }
}

fn robot_status(robot: &Robot) -> RobotStatus {
    RobotStatus {
        robot: robot.id(),
        geometry: Some(robot.geometry()),
        calibration: robot.calibration().map_or_else(Vec::new, |learned| calibration_rows(&learned)),
        switched_off: robot.switched_off().map(|sensor| sensor.0).collect(),
    }
}

fn calibration_rows(learned: &Calibration) -> Vec<CalibrationRow> {
    // What is taken as zero for certain was not learned, and nobody set it.
    let rows = learnable_keys().map(|row| (row, (row.read)(learned)));
    let rows = rows.filter(|(_, known)| known.sigma > 0.0 || known.value != 0.0).map(|(row, known)| CalibrationRow {
        name: row.key.into(),
        value: known.value,
        sigma: known.sigma,
        unit: unit_of(row.key).into(),
        ..CalibrationRow::default()
    });
    rows.collect()
}

/// Unit in the suffix of a key.
fn unit_of(key: &str) -> &'static str {
    let units = [("_rad_per_s", "rad/s"), ("_deg", "deg"), ("_s", "s"), ("_m", "m")];
    let found = units.iter().find(|(ending, _)| key.ends_with(ending));
    found.map_or("", |(_, unit)| unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_recording_is_not_read_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("recording.mcap");
        // A hole: it takes no room on the disk, but would in memory.
        let file = std::fs::File::create(&path).unwrap();
        file.set_len(MEMORY_LIMIT.max_bytes + 1).unwrap();
        let refused = format!("{:#}", build_history(&path).unwrap_err());
        assert!(refused.contains("not begin with the MCAP magic"), "{refused}");
        // One that begins like one is refused for its size.
        std::fs::write(&path, b"\x89MCAP0\r\n").unwrap();
        let file = std::fs::File::options().append(true).open(&path).unwrap();
        file.set_len(MEMORY_LIMIT.max_bytes + 1).unwrap();
        let refused = format!("{:#}", build_history(&path).unwrap_err());
        assert!(refused.contains("holds more than 256 MiB"), "{refused}");
    }
}

//! A posebridge recording for calibrations and experiments: observations of one robot, decoded by its station.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_recording::container::RecordingReader;
use posebridge_station::Robot;
use posebridge_telemetry::{
    BrickClock, ChannelName, Event, HostClock, Observation, ObservationKind, Output, RobotId, SensorId, TimeDelta,
    Timestamp,
};

use super::import::{self, StationOptions};
use super::ros2_bag;
use crate::config::{Overlay, RobotFile, config_with_overlay};
use crate::console::{print_line, print_lines};
use crate::station::recorded_session::{ClockAlignment, for_each_input, missing_start};
use crate::station::signing::recorded_stations;

/// Decrease of a thermometer's clock that means a restart; smaller ones are overtaken messages. Equal to the station's limit for a
/// brick's clock (`clock::unwrap`).
const RESTART_THRESHOLD: TimeDelta = TimeDelta::from_millis(1_000);

/// All observations of one session.
#[derive(Clone, Debug)]
pub struct OwnRecordingRun {
    pub name: String,
    /// With the geometry that its brick described.
    pub robot: RobotFile,
    /// For a filter of this robot.
    pub config: FilterConfig,
    /// In the order of arrival, in brick time.
    pub observations: Vec<Observation>,
    /// Arrival of each observation, in brick time; `None` if the brick never answered a time request.
    pub arrivals: Option<Vec<Timestamp<BrickClock>>>,
    /// In the order of their first readings.
    pub thermometers: Vec<ThermometerReadings>,
}

#[derive(Clone, Debug)]
pub struct ThermometerReadings {
    brick: RobotId,
    pub channel: ChannelName,
    latest: Timestamp<BrickClock>,
    /// In the order of arrival, by the clock of its brick.
    readings: Vec<Observation>,
    is_restarted: bool,
}

impl ThermometerReadings {
    /// In the order of arrival, by the clock of its brick. Fails if the brick was restarted: its clock began again at an unknown time
    /// of the old one.
    pub fn readings(&self) -> Result<&[Observation]> {
        ensure!(
            !self.is_restarted,
            "the clock of the brick with the thermometer `{}` ({}) fell back: it was restarted; record without a restart",
            self.channel,
            self.brick
        );
        Ok(&self.readings)
    }

    /// Unique name among `all`: the channel, with the brick if two bricks have such a channel.
    pub fn name_among(&self, all: &[Self]) -> String {
        let mut namesakes = all.iter().filter(|one| one.channel == self.channel);
        if namesakes.any(|one| one.brick != self.brick) {
            return format!("{}@{}-{}", self.channel, self.brick.link, self.brick.address);
        }
        self.channel.to_string()
    }
}

#[derive(Debug, Default)]
struct SessionObservations {
    observations: Vec<Observation>,
    arrivals: Vec<Timestamp<HostClock>>,
    /// In the order of host time.
    aligned: Vec<ClockAlignment>,
    thermometers: Vec<ThermometerReadings>,
    restarts: u64,
}

impl SessionObservations {
    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    fn on_event(&mut self, event: &Event) {
        match *event {
            Event::ObservationAligned { arrival, observation, .. } => {
                self.observations.push(observation);
                self.arrivals.push(arrival);
            }
            Event::Temperature { brick, channel, stamp, shown, .. } => {
                let reading = Observation {
                    sensor: SensorId::THERMOMETER,
                    stamp,
                    stamp_sigma: TimeDelta::ZERO,
                    measurement: ObservationKind::Temperature(shown),
                };
                self.push_reading(brick, channel, reading);
            }
            Event::BrickClockAligned { .. } => self.aligned.extend(ClockAlignment::from_event(event)),
            Event::BrickRestarted { .. } => self.restarts += 1,
            _ => {}
        }
    }

    fn push_reading(&mut self, brick: RobotId, channel: ChannelName, reading: Observation) {
        let is_it = |one: &&mut ThermometerReadings| one.brick == brick && one.channel == channel;
        match self.thermometers.iter_mut().find(is_it) {
            Some(known) => {
                // The station reports only a restart of its robot.
                if known.latest - reading.stamp > RESTART_THRESHOLD {
                    known.is_restarted = true;
                }
                known.latest = known.latest.max(reading.stamp);
                known.readings.push(reading);
            }
            None => self.thermometers.push(ThermometerReadings {
                brick,
                channel,
                latest: reading.stamp,
                is_restarted: false,
                readings: vec![reading],
            }),
        }
    }

    /// Arrivals in brick time, each by the clock alignment valid then.
    fn arrivals_on_brick_clock(&self) -> Option<Vec<Timestamp<BrickClock>>> {
        let first = self.aligned.first()?;
        let converted = self.arrivals.iter().map(|arrival| {
            let after = self.aligned.partition_point(|one| one.host <= *arrival);
            let by = after.checked_sub(1).and_then(|index| self.aligned.get(index)).unwrap_or(first);
            by.brick_at(*arrival)
        });
        Some(converted.collect())
    }
}

/// Whether a path is a posebridge recording and not foreign data: a descriptor, or a ROS 2 bag.
pub fn is_own(path: &Path) -> bool {
    path.extension().is_none_or(|extension| extension != "toml") && !ros2_bag::is_bag(path)
}

/// Reads a recording as far as possible; truncation or damage is reported on stderr.
pub fn read(path: &Path, overlay: Overlay<'_>) -> Result<OwnRecordingRun> {
    let name = path.display().to_string();
    let station = StationOptions { config: None, robot: overlay.robot, settings: overlay.settings };
    let (bytes, notes) = import::recording_bytes(path, station)?;
    print_lines(&notes);
    let mut reader = RecordingReader::open(&bytes)
        .with_context(|| format!("recording `{name}` ({} bytes): `posebridge run` writes recordings", bytes.len()))?;
    if let Some(lack) = missing_start(reader.part_header()) {
        print_line(&format!("{name}: {lack}"));
    }
    let config = config_with_overlay(&reader.header().config_toml, overlay)?;
    let mut stations = recorded_stations(&config, &[])?;
    let mut session = SessionObservations::default();
    for_each_input(&name, &mut reader, |now, input| {
        stations.handle(now, input);
        while let Some(output) = stations.poll() {
            if let Output::Event(event) = output {
                session.on_event(&event);
            }
        }
        Ok(())
    })?;
    let missing_sensors = stations.missing_sensors();
    if let ([line, ..], []) = (missing_sensors.as_slice(), session.observations.as_slice()) {
        bail!("`{name}` holds no observation: {line}");
    }
    ensure!(
        !(session.observations.is_empty() && session.thermometers.is_empty()),
        "`{name}` holds no observation: no robot was heard while it was recorded; look for the robot with `posebridge doctor` and \
         record again"
    );
    if session.restarts > 0 {
        bail!(
            "`{name}`: the brick restarted {} time(s), its clock began anew; record a drive without a restart",
            session.restarts
        );
    }
    let first = stations.robots().next();
    let robot = config.robot_file(first);
    let mut filter_config = config.filter_config_of(robot)?;
    filter_config.geometry = first.map_or(filter_config.geometry, Robot::geometry);
    Ok(OwnRecordingRun {
        name,
        robot: robot.with_geometry(&filter_config.geometry),
        config: filter_config,
        arrivals: session.arrivals_on_brick_clock(),
        observations: session.observations,
        thermometers: session.thermometers,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Address, Celsius, LinkId};

    fn reading(at_millis: i64) -> Observation {
        Observation {
            sensor: SensorId::THERMOMETER,
            stamp: Timestamp::from_millis(at_millis),
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Temperature(Celsius(20.0)),
        }
    }

    fn brick(system: u8) -> RobotId {
        RobotId { link: LinkId(0), address: Address::new(system, 1) }
    }

    #[test]
    fn a_thermometers_clock_that_falls_is_a_restart_and_a_reading_that_was_overtaken_is_none() {
        let channel = ChannelName::from_bytes(b"temp1");
        let fallen = |stamps: &[i64]| {
            let mut session = SessionObservations::default();
            for at_millis in stamps {
                session.push_reading(brick(3), channel, reading(*at_millis));
            }
            let readings = session.thermometers[0].readings().map(<[_]>::len);
            readings.map_err(|error| error.to_string())
        };
        assert_eq!(fallen(&[60_000, 61_000, 60_100, 62_000]), Ok(4));
        let error = fallen(&[60_000, 61_000, 500, 1_500]).unwrap_err();
        assert!(error.contains("`temp1` (link 0 3/1) fell back"), "{error}");
    }

    #[test]
    fn a_thermometer_is_called_by_its_brick_where_two_bricks_have_a_channel_of_that_name() {
        let mut session = SessionObservations::default();
        for (system, channel) in [(3, "temp1"), (4, "temp1"), (4, "temp2")] {
            let channel = ChannelName::from_bytes(channel.as_bytes());
            session.push_reading(brick(system), channel, reading(0));
        }
        let all = &session.thermometers;
        let names: Vec<String> = all.iter().map(|one| one.name_among(all)).collect();
        assert_eq!(names, ["temp1@0-3/1", "temp1@0-4/1", "temp2"]);
    }
}

//! The trails of a recording, as the dashboard shows them: the same engine and the same views as live.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_dashboard::model::Frame;
use posebridge_dashboard::{SessionViews, SimulatedTruth};
use posebridge_recording::container::{self, RecordingReader};
use posebridge_station::Station;
use posebridge_telemetry::severity::WARNING;
use posebridge_telemetry::{Address, Event, HostClock, Output, RobotId, TimeDelta, Timestamp};

use super::clock_alignment::ClockAlignment;
use super::joined_recording::{ExcessPolicy, MemoryLimit, own_recording_bytes};
use super::recording_warnings::RecordingWarnings;
use super::signing;
use super::status::station_status;
use crate::config::{Config, Overlay, config_with_overlay};

/// How often the state is sent, as in a live session.
const SECOND: TimeDelta = TimeDelta::from_millis(1_000);
/// A replay of the page shares memory and cores with a station that steers: more than 256 MiB, some hours of the bundled brick,
/// are replayed by `posebridge replay`, or from a later part on.
const MEMORY_LIMIT: MemoryLimit = MemoryLimit { max_bytes: 256 << 20, on_excess: ExcessPolicy::Skip };

/// Runs a recording through the engine and gathers what it shows. What is missing, damaged or cut off stands first in its log.
///
/// # Errors
/// The file cannot be read or is no recording of ours.
pub fn build_history(path: &Path) -> Result<Frame> {
    let name = path.display();
    let (bytes, found) = own_recording_bytes(path, MEMORY_LIMIT)?;
    let mut reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
    let config = config_with_overlay(&reader.header().config_toml, Overlay::default())?;
    let truth = container::read_truth(&bytes).with_context(|| format!("the truth in `{name}`"))?;
    let mut showing = PageHistoryBuilder::new(&config, truth)?;
    let mut notes = RecordingWarnings::from_notes(&found);
    notes.add_missing_start(reader.part_header());
    for item in &mut reader {
        match item {
            Ok((now, input)) => {
                showing.pipeline.handle(now, &input);
                showing.advance_to(now);
            }
            Err(error) => notes.add_damage(&error),
        }
    }
    notes.add_ending(&reader.recording_end());
    Ok(showing.history(notes, station_of(&config)))
}

/// As who the station says something.
const fn station_of(config: &Config) -> Address {
    Address::new(config.station.system, config.station.component)
}

/// What is known of a robot's clock.
#[derive(Clone, Copy, Debug, Default)]
struct RobotClock {
    /// As the last exchange of times with the brick had it.
    exchanged: Option<ClockAlignment>,
    /// As the last estimate came, for a brick that never answers a question for its time.
    heard: Option<ClockAlignment>,
}

/// A recording on its way through the engine.
struct PageHistoryBuilder {
    pipeline: Station,
    gatherer: SessionViews,
    /// Of each robot in the order of its own clock; `None` is the only one.
    truth: BTreeMap<Option<RobotId>, VecDeque<container::TruthSample>>,
    clocks: BTreeMap<RobotId, RobotClock>,
    /// When the first input was given.
    begun: Option<Timestamp<HostClock>>,
    next_second: Timestamp<HostClock>,
}

impl PageHistoryBuilder {
    fn new(config: &Config, samples: Vec<container::TruthSample>) -> Result<Self> {
        let mut truth: BTreeMap<Option<RobotId>, VecDeque<container::TruthSample>> = BTreeMap::new();
        for sample in samples {
            truth.entry(sample.robot).or_default().push_back(sample);
        }
        let mut pipeline_config = config.station_config()?;
        signing::restore_states(config, &[], &mut pipeline_config)?;
        let links = config.links.iter().map(|link| link.url.clone());
        Ok(Self {
            pipeline: Station::new(pipeline_config, Timestamp::ZERO)?,
            gatherer: SessionViews::new(links.collect()),
            truth,
            clocks: BTreeMap::new(),
            begun: None,
            next_second: Timestamp::ZERO,
        })
    }

    /// Shows what an input has led to, and the truth up to it.
    fn advance_to(&mut self, now: Timestamp<HostClock>) {
        self.begun.get_or_insert(now);
        while let Some(output) = self.pipeline.poll() {
            if let Output::Event(event) = output {
                self.align(now, &event);
                self.publish_truth(now);
                self.gatherer.push_event(now, &event);
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
            let heard = ClockAlignment { host: now, brick: estimate.stamp, skew_ppm: 0.0 };
            self.clocks.entry(*robot).or_default().heard = Some(heard);
        }
    }

    /// Shows the truth as live: each sample at its own instant, by the alignment that was in force.
    fn publish_truth(&mut self, until: Timestamp<HostClock>) {
        for (robot, truth) in &mut self.truth {
            let clock = match robot {
                Some(robot) => self.clocks.get(robot),
                None => self.clocks.values().next(),
            };
            let Some(aligned) = clock.and_then(|clock| clock.exchanged.or(clock.heard)) else {
                continue;
            };
            while let Some(sample) = truth.front() {
                let now = aligned.host_at(sample.time);
                if now > until {
                    break;
                }
                self.gatherer.push_truth(&SimulatedTruth {
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
        self.gatherer.push_status(&station_status(&self.pipeline, None));
    }

    fn history(mut self, notes: RecordingWarnings, source: Address) -> Frame {
        self.publish_status();
        let begun = self.begun.unwrap_or(Timestamp::ZERO);
        let mut history = self.gatherer.history();
        let mut noted = SessionViews::new(Vec::new());
        for text in notes.into_lines() {
            // What is missing makes the replay another one than the live run.
            let said = Event::Text { source, severity: WARNING, text };
            noted.push_event(begun, &said);
        }
        history.log.splice(0..0, noted.history().log);
        history
    }
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

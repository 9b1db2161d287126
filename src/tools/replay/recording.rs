//! A recording of ours, read into memory: its configuration, its truth, and the way of its inputs into the engine.

use std::path::Path;

use anyhow::{Result, ensure};
use posebridge_recording::container::{RecordingHeader, RecordingReader};
use posebridge_station::Station;
use posebridge_telemetry::{HostClock, Input, RobotId, TimeDelta, Timestamp};

use super::robot;
use super::watch::{ReplayLane, ReplayPacer, Window, WindowPosition};
use crate::config::{self, Config};
use crate::console::progress_bar;
use crate::flags::SessionFlags;
use crate::station::recording_warnings::RecordingWarnings;
use crate::station::signing;
use crate::tools::ground_truth::GroundTruth;
use crate::tools::import::{self, ImportedSession, InputSource, StationOptions};

/// Number of bytes between two moves of the bar.
const PROGRESS_STEP_BYTES: u64 = 256 * 1024;

/// A recording of ours, in memory, or a telemetry log in its place.
pub struct OwnRecording {
    /// Its path, as it was given.
    pub name: String,
    /// Its own description.
    pub header: RecordingHeader,
    inputs: InputSource,
    /// What is missing of the file's parts.
    notes: Vec<String>,
}

/// What came of giving a recording to the engine.
#[derive(Debug, Default)]
pub struct ReplaySummary {
    /// From the first input to the last that was given.
    pub duration: TimeDelta,
    /// What is missing or damaged, in words.
    pub notes: Vec<String>,
}

impl OwnRecording {
    /// Reads it; of a telemetry log only the beginning.
    ///
    /// # Errors
    /// The file cannot be read or is no recording of ours, or a flag is for other recordings.
    pub fn open(flags: &SessionFlags) -> Result<Self> {
        ensure!(
            flags.data.run.is_none() && flags.data.use_every.is_none(),
            "--run and --use-every choose from a descriptor's data, not from a recording of ours"
        );
        let name = flags.recording.display().to_string();
        let settings = robot::settings(flags, &["robot"])?;
        let station = StationOptions { settings: &settings, ..StationOptions::default() };
        let ImportedSession { header, notes, inputs } = import::session(&flags.recording, station)?;
        Ok(Self { name, header, inputs, notes })
    }

    /// The configuration that it was made with, and what the flags and the filter change of it.
    ///
    /// # Errors
    /// It makes no sense.
    pub fn config(&self, flags: &SessionFlags, filter: Option<&str>) -> Result<Config> {
        let origin = "the recording's own configuration";
        let settings = robot::settings(flags, &["robot"])?;
        let mut config = config::load_text(origin, &self.header.config_toml, &settings)?.config;
        if let Some(filter) = filter {
            filter.clone_into(&mut config.filter.name);
        }
        Ok(config)
    }

    /// What is changed of the configuration that it was made with, in words; empty if nothing is.
    ///
    /// # Errors
    /// The recorded configuration or a flag makes no sense.
    pub fn changes(&self, flags: &SessionFlags, filters: &[String]) -> Result<Vec<String>> {
        let recorded = config::load_text("the recording's own configuration", &self.header.config_toml, &[])?;
        let others = filters.iter().filter(|name| **name != recorded.config.filter.name);
        let mut changes: Vec<String> = others.map(|name| format!("filter.name={name}")).collect();
        changes.extend(changed_settings(flags));
        Ok(changes)
    }

    /// The station of a configuration.
    ///
    /// # Errors
    /// The configuration or a key makes no sense.
    pub fn station(flags: &SessionFlags, config: &Config) -> Result<Station> {
        let mut station_config = config.station_config()?;
        signing::restore_states(config, &flags.keys, &mut station_config)?;
        Ok(Station::new(station_config, Timestamp::ZERO)?)
    }

    /// The truth of a robot: that of a file, else that of the recording.
    ///
    /// # Errors
    /// The file cannot be read, or the recorded truth is damaged.
    pub fn ground_truth(&self, truth: Option<&Path>, robot: Option<RobotId>) -> Result<GroundTruth> {
        match &self.inputs {
            InputSource::Recorded(bytes) => GroundTruth::load(&self.name, bytes, truth, robot),
            InputSource::Logged(_) => GroundTruth::from_file(truth),
        }
    }

    /// When its first input was given.
    pub fn origin(&self) -> Timestamp<HostClock> {
        let InputSource::Recorded(bytes) = &self.inputs else {
            return Timestamp::ZERO;
        };
        let reader = RecordingReader::open(bytes).ok();
        let first = reader.and_then(|mut reader| reader.find_map(Result::ok));
        first.map_or(Timestamp::ZERO, |(now, _)| now)
    }

    /// Gives every lane what the station was given live, at the same instants.
    ///
    /// # Errors
    /// As the watchers say; or a telemetry log cannot be read any further, or nothing lies within the window.
    pub fn run(
        &self,
        lanes: &mut [ReplayLane<'_>],
        window: Window,
        pace: Option<&ReplayPacer>,
    ) -> Result<ReplaySummary> {
        let mut notes = RecordingWarnings::from_notes(&self.notes);
        let mut course = ReplayCursor {
            lanes,
            window,
            pace,
            first: None,
            duration: TimeDelta::ZERO,
            has_started: false,
            is_finished: false,
        };
        match &self.inputs {
            InputSource::Recorded(bytes) => run_recorded(bytes, &mut course, &mut notes)?,
            InputSource::Logged(log) => {
                let left_out = log.send_to(&mut |now, input| course.push(now, input))?;
                for note in left_out {
                    notes.add(note);
                }
            }
        }
        let recorded = course.duration;
        ensure!(
            course.has_started || window.is_unbounded(),
            "`{}`: nothing lies between --from and --to: its inputs lie between 0 and {:.3} s",
            self.name,
            recorded.as_secs_f64()
        );
        let notes = notes.into_lines();
        Ok(ReplaySummary { duration: recorded, notes })
    }
}

/// The lanes on their way through a session.
struct ReplayCursor<'c, 'l> {
    lanes: &'c mut [ReplayLane<'l>],
    window: Window,
    pace: Option<&'c ReplayPacer>,
    /// When the first input was given.
    first: Option<Timestamp<HostClock>>,
    duration: TimeDelta,
    /// Something lay within the window.
    has_started: bool,
    /// All that is wanted was given.
    is_finished: bool,
}

impl ReplayCursor<'_, '_> {
    fn push(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<()> {
        let elapsed = now - *self.first.get_or_insert(now);
        let place = self.window.position(elapsed);
        self.is_finished |= place == WindowPosition::After;
        if self.is_finished {
            return Ok(());
        }
        self.has_started |= place == WindowPosition::Within;
        if let Some(pace) = self.pace {
            pace.wait(elapsed);
        }
        for lane in &mut *self.lanes {
            lane.push(now, input, place)?;
        }
        self.duration = self.duration.max(elapsed);
        Ok(())
    }
}

fn run_recorded(bytes: &[u8], course: &mut ReplayCursor<'_, '_>, notes: &mut RecordingWarnings) -> Result<()> {
    let mut reader = RecordingReader::open(bytes)?;
    let bar = progress_bar(bytes.len() as u64, "bytes")?;
    notes.add_missing_start(reader.part_header());
    while let Some(item) = reader.next() {
        match item {
            Ok((now, input)) => course.push(now, &input)?,
            Err(error) => notes.add_damage(&error),
        }
        if course.is_finished {
            break;
        }
        if reader.offset() >= bar.position() + PROGRESS_STEP_BYTES {
            bar.set_position(reader.offset());
        }
    }
    bar.finish_and_clear();
    if !course.is_finished {
        notes.add_ending(&reader.recording_end());
    }
    Ok(())
}

/// What flags lay over a configuration, in words.
pub fn changed_settings(flags: &SessionFlags) -> Vec<String> {
    let robot = flags.robot.iter();
    let mut changes: Vec<String> = robot.map(|path| format!("robot of {}", path.display())).collect();
    let settings = flags.data.settings.iter().chain(&flags.params);
    changes.extend(settings.map(ToString::to_string));
    changes
}

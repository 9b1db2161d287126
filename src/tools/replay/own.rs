//! Replays a posebridge recording: the station gets the same inputs as live, so its events are those of the live run, bit for bit.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_recording::container::{RecordingHeader, RecordingReader};
use posebridge_report::metrics::{errors_of_estimates, errors_of_track, summarise};
use posebridge_report::{ErrorSummary, PoseTrack};
use posebridge_station::{RecordedStations, Robot};
use posebridge_telemetry::{Estimate, HostClock, Input, RobotId, TimeDelta, Timestamp};

use super::result::{FilterResult, ReplayArgs, ReplayResult, SmoothError, SmoothedRun, SmoothingSpan};
use super::watch::{
    ReferenceTracks, ReplayLane, ReplayPacer, ReplayWatcher, Window, WindowPosition, finish_events, write_charts,
};
use crate::config::{self, Config, RobotFile, Setting};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::SessionFlags;
use crate::station::event_collector::EventCollector;
use crate::station::event_file::create;
use crate::station::input_file::{InputFile, InputKind};
use crate::station::learned_calibration::LearnedCalibration;
use crate::station::per_robot::{PerRobot, RobotEntry};
use crate::station::recorded_session::{ReadProgress, RecordingWarnings, nothing_read};
use crate::station::signing::recorded_stations;
use crate::station::wiring_fix::WiringReport;
use crate::tools::dataset;
use crate::tools::ground_truth::GroundTruth;
use crate::tools::import::{self, StationOptions, TlogSource};

pub const WHOLE_RUN: &str = "recording";

pub(super) fn replay(args: &ReplayArgs) -> Result<ReplayResult, Failure> {
    if let (Some(_), [_, _, ..]) = (&args.events, args.filters.as_slice()) {
        return Err(anyhow!("--events writes the events of one estimator: give --filter once")).before_start();
    }
    let flags = &args.session;
    let window = Window::from_flags(flags).before_start()?;
    let recording = OwnRecording::open(flags).before_start()?;
    let configs = configs(args, &recording).before_start()?;
    let changed = recording.changes(flags, &args.filters).before_start()?;
    if !changed.is_empty() {
        print_line(&format!("{}: replayed with {}: this is not what ran", recording.name, changed.join(", ")));
    }
    let mut events = args.events.as_deref().map(create).transpose().before_start()?;
    let pace = args.speed.map(ReplayPacer::new).transpose().before_start()?;
    let mut watchers = create_watchers(args, configs.len(), events.as_mut());
    let mut lanes = Vec::new();
    for (config, watcher) in configs.iter().zip(&mut watchers) {
        let stations = OwnRecording::stations(flags, config).before_start()?;
        lanes.push(ReplayLane { stations, watcher });
    }
    let summary = recording.run(&mut lanes, window, pace.as_ref()).while_running()?;
    for note in &summary.notes {
        print_line(&format!("{}: {note}", recording.name));
    }
    let stations: Vec<RecordedStations> = lanes.into_iter().map(|lane| lane.stations).collect();
    for line in stations.last().map(RecordedStations::missing_sensors).unwrap_or_default() {
        print_line(&format!("{}: {line}", recording.name));
    }
    let collectors: Vec<_> = watchers.into_iter().map(ReplayWatcher::finish).collect();
    if let Some(events) = events {
        finish_events(events).while_running()?;
    }
    summarize(args, &recording, &configs, stations.iter().zip(collectors)).map(|replayed| ReplayResult {
        duration: summary.duration,
        changed_settings: changed,
        ..replayed
    })
}

fn configs(args: &ReplayArgs, recording: &OwnRecording) -> Result<Vec<Config>> {
    if args.filters.is_empty() {
        return Ok(vec![recording.config(&args.session, None)?]);
    }
    let filters = args.filters.iter();
    filters.map(|name| recording.config(&args.session, Some(name.as_str()))).collect()
}

/// The last watcher has the event file and the status block; each collects data for tables.
fn create_watchers<'e>(
    args: &ReplayArgs,
    count: usize,
    mut events: Option<&'e mut BufWriter<File>>,
) -> Vec<ReplayWatcher<'e>> {
    let mut all = Vec::new();
    for index in 0..count {
        let is_last = index + 1 == count;
        let make = if (args.smooth || args.fixed_lag.is_some()) && is_last {
            EventCollector::with_observations
        } else {
            EventCollector::default
        };
        let mut replay_watcher = ReplayWatcher::new(PerRobot::new(make));
        if is_last {
            replay_watcher.events = events.take();
            replay_watcher.show_at(args.speed);
        }
        all.push(replay_watcher);
    }
    all
}

/// Results of every estimator for every robot. Figures and the smoothed path are those of the last estimator.
fn summarize<'m>(
    args: &ReplayArgs,
    recording: &OwnRecording,
    configs: &[Config],
    replays: impl Iterator<Item = (&'m RecordedStations, PerRobot<EventCollector>)>,
) -> Result<ReplayResult, Failure> {
    let mut result =
        ReplayResult { recording: recording.name.clone(), runs: vec![WHOLE_RUN.to_owned()], ..ReplayResult::default() };
    for (index, (config, (stations, collectors))) in configs.iter().zip(replays).enumerate() {
        result.wiring = WiringReport::of_session(stations.robots(), config);
        let entries = collectors.into_entries();
        let has_several = entries.len() > 1;
        for (position, RobotEntry { robot: id, label, value: collector }) in entries.into_iter().enumerate() {
            let known = recording.ground_truth(args.session.truth.as_deref(), id).before_start()?;
            let truth = known.truth.as_ref();
            // `None` if the station received nothing from a robot.
            let robot = stations.robots().find(|robot| Some(robot.id()) == id);
            let file = config.robot_file(robot);
            let mut filter_config = config.filter_config_of(file).before_start()?;
            let label = has_several.then_some(label);
            let run = label.as_ref().map_or_else(|| WHOLE_RUN.to_owned(), |label| format!("{WHOLE_RUN} {label}"));
            let prior = filter_config.calibration;
            let learned = robot.and_then(|robot| LearnedCalibration::of_robot(robot, &run, file, &prior));
            if index == 0 {
                result.observations += collector.observations;
            }
            if index == 0 && position == 0 {
                let tracks = known.odometry.as_ref().zip(truth);
                result.odometry = tracks.map(|(odometry, truth)| summarise(&errors_of_track(odometry, truth)));
            }
            if index + 1 == configs.len() {
                filter_config.geometry = robot.map_or(filter_config.geometry, Robot::geometry);
                let run = label.as_deref().unwrap_or(WHOLE_RUN);
                let smooth = |hindsight| smoothed((run, file), &filter_config, &collector, truth, hindsight);
                let smoothed = args.smooth.then(|| smooth(SmoothingSpan::WholeRun));
                result.lagged.extend(args.lag().map(|lag| smooth(SmoothingSpan::Lag(lag))));
                if position == 0 {
                    let path = smoothed.as_ref().and_then(SmoothedRun::track);
                    let tracks = ReferenceTracks { truth, odometry: known.odometry.as_ref(), smoothed: path.as_ref() };
                    write_charts(args, &recording.name, &collector, tracks).while_running()?;
                }
                result.smoothed.extend(smoothed);
            }
            result.outcomes.push(FilterResult {
                name: config.filter.name.clone(),
                robot: label.clone(),
                errors: errors_of(collector.estimates.items(), truth),
                position_rms_uncorrected_m: None,
                learned: learned.into_iter().collect(),
                last: collector.estimates.items().last().copied(),
                quantity: collector.quantity_steps_text(),
                sources: collector.sources,
            });
            result.outcomes.extend(collector.compared.into_iter().map(|compared| FilterResult {
                name: compared.name.to_owned(),
                robot: label.clone(),
                errors: errors_of(compared.estimates.items(), truth),
                position_rms_uncorrected_m: None,
                learned: Vec::new(),
                last: compared.estimates.items().last().copied(),
                quantity: None,
                sources: compared.sources,
            }));
        }
    }
    Ok(result)
}

/// Errors of every published estimate at its own timestamp.
pub fn errors_of(estimates: &[Estimate], truth: Option<&PoseTrack>) -> ErrorSummary {
    truth.map_or_else(ErrorSummary::default, |truth| summarise(&errors_of_estimates(estimates, truth)))
}

/// Smooths the whole recording; scores the path at the truth's timestamps like the filter's estimates.
pub fn smoothed(
    (run, robot): (&str, &RobotFile),
    config: &FilterConfig,
    collector: &EventCollector,
    truth: Option<&PoseTrack>,
    hindsight: SmoothingSpan,
) -> SmoothedRun {
    if collector.restarts > 0 {
        return SmoothedRun::failed(run, SmoothError::Restarted(collector.restarts));
    }
    let mut smoothed = SmoothedRun::new(run, robot, config, &collector.retained_observations, hindsight);
    if let Some(truth) = truth {
        smoothed.errors = summarise(&errors_of_estimates(&smoothed.estimates(), truth));
    }
    smoothed
}

/// A posebridge recording in memory, or a telemetry log instead.
pub struct OwnRecording {
    pub name: String,
    inputs: InputSource,
    /// About omitted data.
    notes: Vec<String>,
}

enum InputSource {
    Recorded {
        header: RecordingHeader,
        bytes: Vec<u8>,
    },
    /// A telemetry log, converted to inputs one by one.
    Logged(Box<TlogSource>),
}

#[derive(Debug, Default)]
pub struct ReplaySummary {
    /// From the first to the last replayed input.
    pub duration: TimeDelta,
    /// Messages about missing or damaged data.
    pub notes: Vec<String>,
}

impl OwnRecording {
    /// Reads the file; of a telemetry log only the beginning.
    pub fn open(flags: &SessionFlags) -> Result<Self> {
        ensure!(
            flags.data.run.is_none() && flags.data.use_every.is_none(),
            "--run and --use-every choose from a descriptor's data, not from a recording of ours"
        );
        let name = flags.recording.display().to_string();
        let settings = profile_settings(flags, &["robot"])?;
        let station = StationOptions { settings: &settings, ..StationOptions::default() };
        if InputFile::open(&flags.recording)?.kind == InputKind::Tlog {
            let log = TlogSource::open(&flags.recording, station.config()?)?;
            let inputs = InputSource::Logged(Box::new(log));
            return Ok(Self { name, inputs, notes: Vec::new() });
        }
        let (bytes, notes) = import::recording_bytes(&flags.recording, station)?;
        let reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        let header = reader.header().clone();
        Ok(Self { name, inputs: InputSource::Recorded { header, bytes }, notes })
    }

    pub fn header(&self) -> &RecordingHeader {
        match &self.inputs {
            InputSource::Recorded { header, .. } => header,
            InputSource::Logged(log) => &log.header,
        }
    }

    /// The recorded configuration with the changes by flags and filter.
    pub fn config(&self, flags: &SessionFlags, filter: Option<&str>) -> Result<Config> {
        let origin = "the recording's own configuration";
        let settings = profile_settings(flags, &["robot"])?;
        let mut config = config::load_text(origin, &self.header().config_toml, &settings)?.config;
        if let Some(filter) = filter {
            filter.clone_into(&mut config.filter.name);
            // Each named filter has a run of its own.
            config.filter.compare.clear();
        }
        Ok(config)
    }

    /// Messages about changes of the recorded configuration; empty without changes.
    pub fn changes(&self, flags: &SessionFlags, filters: &[String]) -> Result<Vec<String>> {
        let recorded = config::load_text("the recording's own configuration", &self.header().config_toml, &[])?;
        let others = filters.iter().filter(|name| **name != recorded.config.filter.name);
        let mut changes: Vec<String> = others.map(|name| format!("filter.name={name}")).collect();
        changes.extend(changed_settings(flags));
        Ok(changes)
    }

    pub fn stations(flags: &SessionFlags, config: &Config) -> Result<RecordedStations> {
        recorded_stations(config, &flags.keys)
    }

    /// The truth of a robot: from a file, else from the recording.
    pub fn ground_truth(&self, truth: Option<&Path>, robot: Option<RobotId>) -> Result<GroundTruth> {
        match &self.inputs {
            InputSource::Recorded { bytes, .. } => GroundTruth::load(&self.name, bytes, truth, robot),
            InputSource::Logged(_) => GroundTruth::from_file(truth),
        }
    }

    pub fn origin(&self) -> Timestamp<HostClock> {
        let InputSource::Recorded { bytes, .. } = &self.inputs else {
            return Timestamp::ZERO;
        };
        let reader = RecordingReader::open(bytes).ok();
        let first = reader.and_then(|mut reader| reader.find_map(Result::ok));
        first.map_or(Timestamp::ZERO, |(now, _)| now)
    }

    /// Passes the recorded inputs at their instants to every lane.
    pub fn run(
        &self,
        lanes: &mut [ReplayLane<'_>],
        window: Window,
        pace: Option<&ReplayPacer>,
    ) -> Result<ReplaySummary> {
        let mut notes = RecordingWarnings::from_notes(&self.notes);
        let mut cursor = ReplayCursor {
            lanes,
            window,
            pace,
            first: None,
            duration: TimeDelta::ZERO,
            has_started: false,
            is_finished: false,
        };
        match &self.inputs {
            InputSource::Recorded { bytes, .. } => run_recorded(bytes, &mut cursor, &mut notes)?,
            InputSource::Logged(log) => {
                let left_out = log.inputs(&mut |now, input| cursor.push(now, input))?;
                for note in left_out {
                    notes.add(note);
                }
            }
        }
        let recorded = cursor.duration;
        if cursor.first.is_none() {
            notes.into_lines().iter().for_each(|note| print_line(&format!("{}: {note}", self.name)));
            return Err(nothing_read(&self.name));
        }
        ensure!(
            cursor.has_started || window.is_unbounded(),
            "`{}`: nothing lies between --from and --to: its inputs lie between 0 and {:.3} s",
            self.name,
            recorded.as_secs_f64()
        );
        let notes = notes.into_lines();
        Ok(ReplaySummary { duration: recorded, notes })
    }
}

/// The progress of the lanes through a session.
struct ReplayCursor<'c, 'l> {
    lanes: &'c mut [ReplayLane<'l>],
    window: Window,
    pace: Option<&'c ReplayPacer>,
    first: Option<Timestamp<HostClock>>,
    duration: TimeDelta,
    has_started: bool,
    is_finished: bool,
}

impl ReplayCursor<'_, '_> {
    fn push(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<()> {
        let elapsed = now - *self.first.get_or_insert(now);
        let position = self.window.position(elapsed);
        self.is_finished |= position == WindowPosition::After;
        if self.is_finished {
            return Ok(());
        }
        self.has_started |= position == WindowPosition::Within;
        if let Some(pace) = self.pace {
            pace.wait(elapsed);
        }
        for lane in &mut *self.lanes {
            lane.push(now, input, position)?;
        }
        self.duration = self.duration.max(elapsed);
        Ok(())
    }
}

fn run_recorded(bytes: &[u8], cursor: &mut ReplayCursor<'_, '_>, notes: &mut RecordingWarnings) -> Result<()> {
    let mut reader = RecordingReader::open(bytes)?;
    let progress = ReadProgress::new(&reader)?;
    notes.add_missing_start(reader.part_header());
    while let Some(item) = reader.next() {
        match item {
            Ok((now, input)) => cursor.push(now, &input)?,
            Err(error) => notes.add_damage(&error),
        }
        if cursor.is_finished {
            break;
        }
        progress.update(&reader);
    }
    drop(progress);
    if !cursor.is_finished {
        notes.add_ending(&reader.recording_end());
    }
    Ok(())
}

pub fn changed_settings(flags: &SessionFlags) -> Vec<String> {
    let robot = flags.robot.iter();
    let mut changes: Vec<String> = robot.map(|path| format!("robot of {}", path.display())).collect();
    changes.extend(flags.sensor.iter().map(|path| format!("sensor of {}", path.display())));
    let settings = flags.data.settings.iter().chain(&flags.params);
    changes.extend(settings.map(ToString::to_string));
    changes
}

/// The profile's keys, then those of `--set`, then those of `--param`; `robot_path` is the path of the robot's table in the changed
/// configuration.
pub(super) fn profile_settings(flags: &SessionFlags, robot_path: &[&str]) -> Result<Vec<Setting>> {
    let mut settings = Vec::new();
    if let Some(path) = &flags.robot {
        settings.extend(dataset::profile_settings(path, robot_path)?);
    }
    if let Some(path) = &flags.sensor {
        let setting = config::sensor_setting(path)?;
        let path = robot_path.iter().map(|part| (*part).to_owned()).chain(setting.path.last().cloned());
        settings.push(Setting { path: path.collect(), value: setting.value });
    }
    settings.extend_from_slice(&flags.data.settings);
    settings.extend_from_slice(&flags.params);
    Ok(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_laid_over_key_by_key_without_start_and_filter_name() {
        let text = "[robot]\ntrack_width_m = 0.2\n[robot.noise]\nfix_position_m = 0.02\n[robot.start]\nx_m = 1.0\n\
                    [filter]\nname = \"pose\"\naccel_m_s2 = 2.0\n";
        let page: toml::Table = toml::from_str(text).unwrap();
        let paths =
            |settings: Vec<Setting>| -> Vec<String> { settings.iter().map(|setting| setting.path.join(".")).collect() };
        assert_eq!(
            paths(dataset::settings_of_table(&page, "robot", &["robot"])),
            ["robot.noise.fix_position_m", "robot.track_width_m"]
        );
        assert_eq!(paths(dataset::settings_of_table(&page, "filter", &["filter"])), ["filter.accel_m_s2"]);
    }
}

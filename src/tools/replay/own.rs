//! A recording of ours: the station is given what it was given live, so its events are those of the live run, bit for bit.

use std::fs::File;
use std::io::BufWriter;

use anyhow::{Result, anyhow};
use posebridge_estimator::FilterConfig;
use posebridge_report::metrics::{errors_of_estimates, summarise};
use posebridge_report::{ErrorSummary, PoseTrack};
use posebridge_station::{Robot, Station};

use super::args::ReplayArgs;
use super::output_files::{ReferenceTracks, finish_events, write_charts};
use super::recording::OwnRecording;
use super::replay_watcher::ReplayWatcher;
use super::result::{FilterResult, ReplayResult};
use super::smooth::{SmoothError, SmoothedRun};
use super::watch::{ReplayLane, ReplayPacer, Window};
use crate::config::{Config, RobotFile};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::station::event_collector::EventCollector;
use crate::station::learned_calibration::LearnedCalibration;
use crate::station::observer::create;
use crate::station::per_robot::{PerRobot, RobotEntry};
use crate::tools::ground_truth::GroundTruth;

/// What a recording of ours is called among runs.
pub const WHOLE_RUN: &str = "recording";

/// Replays it with the filter of its configuration, or others.
///
/// # Errors
/// The recording, its configuration or a flag makes no sense, or an output cannot be written.
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
        let station = OwnRecording::station(flags, config).before_start()?;
        lanes.push(ReplayLane { station, watcher });
    }
    let summary = recording.run(&mut lanes, window, pace.as_ref()).while_running()?;
    for note in &summary.notes {
        print_line(&format!("{}: {note}", recording.name));
    }
    let stations: Vec<Station> = lanes.into_iter().map(|lane| lane.station).collect();
    let collectors: Vec<_> = watchers.into_iter().map(ReplayWatcher::finish).collect();
    if let Some(events) = events {
        finish_events(events).while_running()?;
    }
    let replays = configs.iter().zip(stations.iter().zip(collectors));
    let replays: Vec<FilterReplay<'_>> =
        replays.map(|(config, (station, collectors))| FilterReplay { config, station, collectors }).collect();
    summarize(args, &recording, replays).map(|replayed| ReplayResult {
        duration: summary.duration,
        changed_settings: changed,
        ..replayed
    })
}

/// One estimator when all is over.
struct FilterReplay<'m> {
    config: &'m Config,
    station: &'m Station,
    collectors: PerRobot<EventCollector>,
}

/// One configuration for each estimator.
fn configs(args: &ReplayArgs, recording: &OwnRecording) -> Result<Vec<Config>> {
    if args.filters.is_empty() {
        return Ok(vec![recording.config(&args.session, None)?]);
    }
    let filters = args.filters.iter();
    filters.map(|name| recording.config(&args.session, Some(name.as_str()))).collect()
}

/// The last one has the event file and the status block; each keeps what tables need.
fn create_watchers<'e>(
    args: &ReplayArgs,
    count: usize,
    mut events: Option<&'e mut BufWriter<File>>,
) -> Vec<ReplayWatcher<'e>> {
    let mut all = Vec::new();
    for index in 0..count {
        let is_last = index + 1 == count;
        let make = if args.smooth && is_last { EventCollector::with_observations } else { EventCollector::default };
        let mut replay_watcher = ReplayWatcher::new(PerRobot::new(make));
        if is_last {
            replay_watcher.events = events.take();
            replay_watcher.show_at(args.speed);
        }
        all.push(replay_watcher);
    }
    all
}

/// Results of every estimator for every robot. Pictures and the smoothed path are those of the last estimator.
fn summarize(
    args: &ReplayArgs,
    recording: &OwnRecording,
    replays: Vec<FilterReplay<'_>>,
) -> Result<ReplayResult, Failure> {
    let mut result =
        ReplayResult { recording: recording.name.clone(), runs: vec![WHOLE_RUN.to_owned()], ..ReplayResult::default() };
    let count = replays.len();
    for (index, replay) in replays.into_iter().enumerate() {
        let is_first_estimator = index == 0;
        let is_last_estimator = index + 1 == count;
        let entries = replay.collectors.into_entries();
        let has_several = entries.len() > 1;
        for (position, entry) in entries.into_iter().enumerate() {
            let label = has_several.then(|| entry.label.clone());
            let known = recording.ground_truth(args.session.truth.as_deref(), entry.robot).before_start()?;
            let robot = RobotReplay::new(replay.config, replay.station, label, entry).before_start()?;
            if is_first_estimator {
                result.observations += robot.collector.observations;
            }
            if is_last_estimator {
                let smoothed = args.smooth.then(|| robot.smooth(known.truth.as_ref()));
                if position == 0 {
                    robot.write_charts(args, &recording.name, &known, smoothed.as_ref()).while_running()?;
                }
                result.smoothed.extend(smoothed);
            }
            result.outcomes.push(robot.into_result(known.truth.as_ref()));
        }
    }
    Ok(result)
}

/// One robot as one estimator followed it.
struct RobotReplay<'m> {
    config: &'m Config,
    /// The robot's part of the configuration.
    file: &'m RobotFile,
    filter_config: FilterConfig,
    /// `None` if the station received nothing from a robot.
    robot: Option<&'m Robot>,
    /// What results call it, where there are several robots.
    label: Option<String>,
    collector: EventCollector,
}

impl<'m> RobotReplay<'m> {
    fn new(
        config: &'m Config,
        station: &'m Station,
        label: Option<String>,
        entry: RobotEntry<EventCollector>,
    ) -> Result<Self> {
        let robot = station.robots().iter().find(|robot| Some(robot.id()) == entry.robot);
        let file = config.robot_file(robot);
        Ok(Self { config, file, filter_config: config.filter_config_of(file)?, robot, label, collector: entry.value })
    }

    /// The path in hindsight, with the geometry that the robot described, where it did.
    fn smooth(&self, truth: Option<&PoseTrack>) -> SmoothedRun {
        let mut filter_config = self.filter_config.clone();
        filter_config.geometry = self.robot.map_or(filter_config.geometry, Robot::geometry);
        smoothed(self.label.as_deref().unwrap_or(WHOLE_RUN), &filter_config, &self.collector, truth)
    }

    /// Draws the estimates beside truth, odometry and the smoothed path.
    fn write_charts(
        &self,
        args: &ReplayArgs,
        title: &str,
        known: &GroundTruth,
        smoothed: Option<&SmoothedRun>,
    ) -> Result<()> {
        let path = smoothed.and_then(SmoothedRun::track);
        let tracks =
            ReferenceTracks { truth: known.truth.as_ref(), odometry: known.odometry.as_ref(), smoothed: path.as_ref() };
        write_charts(args, title, &self.collector, tracks)
    }

    fn into_result(self, truth: Option<&PoseTrack>) -> FilterResult {
        let run = self.label.as_ref().map_or_else(|| WHOLE_RUN.to_owned(), |label| format!("{WHOLE_RUN} {label}"));
        let prior = &self.filter_config.calibration;
        let learned = self.robot.and_then(|robot| LearnedCalibration::of_robot(robot, &run, self.file, prior));
        FilterResult {
            name: self.config.filter.name.clone(),
            robot: self.label,
            errors: errors(&self.collector, truth),
            position_rms_uncorrected_m: None,
            learned: learned.into_iter().collect(),
            sources: self.collector.sources,
        }
    }
}

/// Every published estimate against the truth at its own stamp.
pub fn errors(collector: &EventCollector, truth: Option<&PoseTrack>) -> ErrorSummary {
    truth
        .map_or_else(ErrorSummary::default, |truth| summarise(&errors_of_estimates(collector.estimates.items(), truth)))
}

/// The whole recording in hindsight, held against the truth at its own stamps as the filter's estimates are at theirs.
fn smoothed(run: &str, config: &FilterConfig, collector: &EventCollector, truth: Option<&PoseTrack>) -> SmoothedRun {
    if collector.restarts > 0 {
        return SmoothedRun::failed(run, SmoothError::Restarted(collector.restarts));
    }
    let mut smoothed = SmoothedRun::new(run, config, &collector.retained_observations);
    if let Some(truth) = truth {
        smoothed.errors = summarise(&errors_of_estimates(&smoothed.estimates(), truth));
    }
    smoothed
}

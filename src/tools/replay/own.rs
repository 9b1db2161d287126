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
use crate::config::Config;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::station::event_collector::EventCollector;
use crate::station::learned_calibration::LearnedCalibration;
use crate::station::observer::create;
use crate::station::per_robot::PerRobot;

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
    let mut replay_watcher = watchers(args, configs.len(), events.as_mut());
    let mut lanes = Vec::new();
    for (config, replay_watcher) in configs.iter().zip(&mut replay_watcher) {
        let station = OwnRecording::station(flags, config).before_start()?;
        lanes.push(ReplayLane { station, watcher: replay_watcher });
    }
    let passage = recording.run(&mut lanes, window, pace.as_ref()).while_running()?;
    for note in &passage.notes {
        print_line(&format!("{}: {note}", recording.name));
    }
    let stations: Vec<Station> = lanes.into_iter().map(|lane| lane.station).collect();
    let collectors: Vec<_> = replay_watcher.into_iter().map(ReplayWatcher::finish).collect();
    if let Some(events) = events {
        finish_events(events).while_running()?;
    }
    let replays = configs.iter().zip(stations.iter().zip(collectors));
    let replays: Vec<FilterReplay<'_>> =
        replays.map(|(config, (station, collectors))| FilterReplay { config, station, collectors }).collect();
    summarize(args, &recording, replays).map(|replayed| ReplayResult {
        duration: passage.duration,
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
fn watchers<'e>(
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

fn summarize(
    args: &ReplayArgs,
    recording: &OwnRecording,
    replays: Vec<FilterReplay<'_>>,
) -> Result<ReplayResult, Failure> {
    let mut result =
        ReplayResult { recording: recording.name.clone(), runs: vec![WHOLE_RUN.to_owned()], ..ReplayResult::default() };
    let count = replays.len();
    for (index, replay) in replays.into_iter().enumerate() {
        let robots = replay.collectors.into_entries();
        let has_several = robots.len() > 1;
        for (position, robot) in robots.into_iter().enumerate() {
            let label = has_several.then_some(robot.label);
            let known = recording.ground_truth(args.session.truth.as_deref(), robot.robot).before_start()?;
            let engine = replay.station.robots().iter().find(|engine| Some(engine.id()) == robot.robot);
            let file = replay.config.robot_file(engine);
            let mut filter_config = replay.config.filter_config_of(file).before_start()?;
            let prior = filter_config.calibration;
            let collector = robot.value;
            if index + 1 == count {
                // The robot may have described another geometry than the configuration.
                filter_config.geometry = engine.map_or(filter_config.geometry, Robot::geometry);
                let run = label.as_deref().unwrap_or(WHOLE_RUN);
                let smoothed = args.smooth.then(|| smoothed(run, &filter_config, &collector, known.truth.as_ref()));
                if position == 0 {
                    let path = smoothed.as_ref().and_then(SmoothedRun::track);
                    let tracks = ReferenceTracks {
                        truth: known.truth.as_ref(),
                        odometry: known.odometry.as_ref(),
                        smoothed: path.as_ref(),
                    };
                    write_charts(args, &recording.name, &collector, tracks).while_running()?;
                }
                result.smoothed.extend(smoothed);
            }
            if index == 0 {
                result.observations += collector.observations;
            }
            let run = label.as_ref().map_or_else(|| WHOLE_RUN.to_owned(), |label| format!("{WHOLE_RUN} {label}"));
            let learned = engine.and_then(|engine| LearnedCalibration::of_robot(engine, &run, file, &prior));
            result.outcomes.push(FilterResult {
                name: replay.config.filter.name.clone(),
                robot: label,
                errors: errors(&collector, known.truth.as_ref()),
                position_rms_uncorrected_m: None,
                learned: learned.into_iter().collect(),
                sources: collector.sources,
            });
        }
    }
    Ok(result)
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

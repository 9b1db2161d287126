//! A recording of ours: the pipeline is given what it was given live, so its events are those of the live run, bit for bit.

use std::fs::File;
use std::io::BufWriter;

use anyhow::{Result, anyhow};
use posebridge_analysis::metrics::{errors_of_estimates, summarise};
use posebridge_analysis::{ErrorSummary, Track};
use posebridge_estimator::FilterConfig;
use posebridge_pipeline::Pipeline;

use super::recording::OwnRecording;
use super::watch::{Lane, Pace, Window};
use super::{NoPath, Outcome, Replayed, Seen, SmoothedRun, draw, finish_events};
use crate::cli::ReplayArgs;
use crate::collect::Collector;
use crate::commands::{Failure, Stage};
use crate::config::Config;
use crate::known::Known;
use crate::learned::Learned;
use crate::stderr::say;
use crate::tasks::observer::create;

/// What a recording of ours is called among runs.
pub const WHOLE: &str = "recording";

/// Replays it with the filter of its configuration, or others.
///
/// # Errors
/// The recording, its configuration or a flag makes no sense, or an output cannot be written.
pub(super) fn replay(args: &ReplayArgs) -> Result<Replayed, Failure> {
    if let (Some(_), [_, _, ..]) = (&args.events, args.filters.as_slice()) {
        return Err(anyhow!("--events writes the events of one estimator: give --filter once")).at_start();
    }
    let flags = &args.session;
    let window = Window::of(flags).at_start()?;
    let recording = OwnRecording::open(flags).at_start()?;
    let configs = configs(args, &recording).at_start()?;
    let changed = recording.changes(flags, &args.filters).at_start()?;
    if !changed.is_empty() {
        say(&format!("{}: replayed with {}: this is not what ran", recording.name, changed.join(", ")));
    }
    let known = recording.known(flags.truth.as_deref()).at_start()?;
    let mut events = args.events.as_deref().map(create).transpose().at_start()?;
    let pace = args.speed.map(Pace::new).transpose().at_start()?;
    let mut seen = watchers(args, configs.len(), events.as_mut());
    let mut lanes = Vec::new();
    for (config, seen) in configs.iter().zip(&mut seen) {
        let pipeline = OwnRecording::pipeline(flags, config).at_start()?;
        lanes.push(Lane { pipeline, watch: seen });
    }
    let passage = recording.run(&mut lanes, window, pace.as_ref()).while_running()?;
    for note in &passage.notes {
        say(&format!("{}: {note}", recording.name));
    }
    let pipelines: Vec<Pipeline> = lanes.into_iter().map(|lane| lane.pipeline).collect();
    let collectors: Vec<Collector> = seen.into_iter().map(Seen::finish).collect();
    if let Some(events) = events {
        finish_events(events).while_running()?;
    }
    let made = configs.iter().zip(pipelines.iter().zip(collectors));
    let made: Vec<Made<'_>> =
        made.map(|(config, (pipeline, collector))| Made { config, pipeline, collector }).collect();
    summed_up(args, &recording, &known, made).map(|replayed| Replayed {
        recorded: passage.recorded,
        changed,
        ..replayed
    })
}

/// One estimator when all is over.
struct Made<'m> {
    config: &'m Config,
    pipeline: &'m Pipeline,
    collector: Collector,
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
fn watchers<'e>(args: &ReplayArgs, count: usize, mut events: Option<&'e mut BufWriter<File>>) -> Vec<Seen<'e>> {
    let mut all = Vec::new();
    for index in 0..count {
        let is_last = index + 1 == count;
        let collector = if args.smooth && is_last { Collector::keeping_observations() } else { Collector::default() };
        let mut seen = Seen::new(collector);
        if is_last {
            seen.events = events.take();
            seen.show_at(args.speed);
        }
        all.push(seen);
    }
    all
}

fn summed_up(
    args: &ReplayArgs,
    recording: &OwnRecording,
    known: &Known,
    mut made: Vec<Made<'_>>,
) -> Result<Replayed, Failure> {
    let truth = known.truth.as_ref();
    let mut smoothed_run = None;
    if let Some(last) = made.last() {
        let mut filter_config = last.config.filter_config().at_start()?;
        // The robot may have described another geometry than the configuration.
        filter_config.geometry = last.pipeline.geometry();
        smoothed_run = args.smooth.then(|| smoothed(&filter_config, &last.collector, truth));
        let path = smoothed_run.as_ref().and_then(SmoothedRun::track);
        let tracks = (truth, known.odometry.as_ref(), path.as_ref());
        draw(args, &recording.name, &last.collector, tracks).while_running()?;
    }
    let observations = made.first().map_or(0, |one| one.collector.observations);
    let outcomes: Result<Vec<Outcome>> = made.drain(..).map(|one| outcome(one, truth)).collect();
    Ok(Replayed {
        recording: recording.name.clone(),
        runs: vec![WHOLE.to_owned()],
        observations,
        outcomes: outcomes.at_start()?,
        smoothed: smoothed_run.into_iter().collect(),
        ..Replayed::default()
    })
}

fn outcome(made: Made<'_>, truth: Option<&Track>) -> Result<Outcome> {
    let prior = made.config.filter_config()?.calibration;
    let learned = Learned::of(made.pipeline, WHOLE, &made.config.robot, &prior);
    Ok(Outcome {
        name: made.config.filter.name.clone(),
        errors: errors(&made.collector, truth),
        position_rms_uncorrected_m: None,
        learned: learned.into_iter().collect(),
        sources: made.collector.sources,
    })
}

/// Every published estimate against the truth at its own stamp.
pub fn errors(collector: &Collector, truth: Option<&Track>) -> ErrorSummary {
    truth
        .map_or_else(ErrorSummary::default, |truth| summarise(&errors_of_estimates(collector.estimates.items(), truth)))
}

/// The whole recording in hindsight, held against the truth at its own stamps as the filter's estimates are at theirs.
fn smoothed(config: &FilterConfig, collector: &Collector, truth: Option<&Track>) -> SmoothedRun {
    if collector.restarts > 0 {
        return SmoothedRun::without_path(WHOLE, NoPath::Restarted(collector.restarts));
    }
    let mut smoothed = SmoothedRun::new(WHOLE, config, &collector.kept);
    if let Some(truth) = truth {
        smoothed.errors = summarise(&errors_of_estimates(&smoothed.estimates(), truth));
    }
    smoothed
}

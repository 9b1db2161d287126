//! A foreign recording: each estimator over each run, scored against the truth or against the fixes that were withheld.

use std::io::BufWriter;

use anyhow::{Result, anyhow, bail, ensure};
use posebridge_analysis::metrics::summarise;
use posebridge_analysis::{ErrorSummary, SourceTally, TimedPose, Track, mean_over_runs};
use posebridge_pipeline::{DescriptionPolicy, Pipeline, PipelineConfig};
use posebridge_telemetry::{Address, Input, Observation, Point2, Span};

use super::{Outcome, Replayed, SmoothedRun, draw, finish_events, robot, take_outputs};
use crate::cli::{DataFlags, ReplayArgs};
use crate::collect::{Collector, LONGEST_GAP};
use crate::commands::{Failure, Stage};
use crate::data::{DataSet, RobotRun, tell_bad_rows};
use crate::learned::Learned;
use crate::score::{Scorer, pose_at};
use crate::tasks::observer::create;

/// The estimators of a foreign recording unless others are asked for.
const USUAL_FILTERS: [&str; 2] = ["odometry", "pose"];

/// Replays the runs of a descriptor with each filter.
///
/// # Errors
/// The descriptor, a file or a flag makes no sense, or an output cannot be written.
pub(super) fn replay(args: &ReplayArgs) -> Result<Replayed, Failure> {
    if args.truth.is_some() {
        return Err(anyhow!(
            "--truth is for recordings of ours: a descriptor names its own truth"
        ))
        .at_start();
    }
    let flags = DataFlags {
        settings: robot::settings(args, &[]).at_start()?,
        ..args.data.clone()
    };
    let data = DataSet::open(&args.recording, &flags).at_start()?;
    if let (Some(_), runs @ 2..) = (&args.save_calibration, data.runs.len()) {
        return Err(anyhow!(
            "--save-calibration takes what one run has taught, but {runs} are selected: choose one with --run"
        ))
        .at_start();
    }
    let filters = filters_of(args).at_start()?;
    let mut events = args.events.as_deref().map(create).transpose().at_start()?;
    let mut observations = 0;
    let mut bad_rows = 0;
    let mut smoothed = Vec::new();
    let mut per_filter: Vec<Gathered> = filters.iter().map(|_| Gathered::default()).collect();
    for name in &data.runs {
        let robot_run = data.load(name, &flags).at_start()?;
        observations += robot_run.run.observations.len() as u64;
        bad_rows += tell_bad_rows(&robot_run);
        if args.smooth {
            smoothed.push(smoothed_run(&robot_run));
        }
        for (filter, gathered) in filters.iter().zip(&mut per_filter) {
            let mut one = Collector::default();
            let scored =
                replay_run(&robot_run, filter, &mut one, events.as_mut()).while_running()?;
            if Some(filter) == filters.last() {
                draw_run(args, &robot_run, &one, smoothed.last()).while_running()?;
            }
            gathered.take(scored, one);
        }
    }
    if let Some(events) = events {
        finish_events(events).while_running()?;
    }
    let outcomes = filters
        .into_iter()
        .zip(per_filter)
        .map(|(name, gathered)| gathered.outcome(name));
    Ok(Replayed {
        recording: data.descriptor.name.clone(),
        outcomes: outcomes.collect(),
        runs: data.runs,
        observations,
        bad_rows,
        smoothed,
    })
}

/// The filters that were asked for, else the usual ones.
fn filters_of(args: &ReplayArgs) -> Result<Vec<String>> {
    if args.filters.is_empty() {
        return Ok(USUAL_FILTERS.map(str::to_owned).to_vec());
    }
    for filter in &args.filters {
        ensure!(
            posebridge_estimator::filter_named(filter).is_some(),
            "unknown filter `{filter}`; `posebridge config schema` lists them"
        );
    }
    Ok(args.filters.clone())
}

/// One run under one filter.
struct Scored {
    errors: ErrorSummary,
    uncorrected: ErrorSummary,
    learned: Option<Learned>,
}

/// All runs under one filter.
#[derive(Default)]
struct Gathered {
    errors: Vec<ErrorSummary>,
    uncorrected: Vec<ErrorSummary>,
    learned: Vec<Learned>,
    sources: Vec<SourceTally>,
}

impl Gathered {
    fn take(&mut self, scored: Scored, collector: Collector) {
        self.errors.push(scored.errors);
        self.uncorrected.push(scored.uncorrected);
        self.learned.extend(scored.learned);
        for tally in collector.sources {
            let mut known = self.sources.iter_mut();
            match known.find(|known| known.sensor == tally.sensor) {
                Some(known) => known.absorb(&tally),
                None => self.sources.push(tally),
            }
        }
    }

    fn outcome(self, name: String) -> Outcome {
        Outcome {
            name,
            errors: mean_over_runs(&self.errors),
            position_rms_uncorrected_m: mean_over_runs(&self.uncorrected).position_rms_m,
            learned: self.learned,
            sources: self.sources,
        }
    }
}

fn replay_run(
    robot_run: &RobotRun,
    filter: &str,
    collector: &mut Collector,
    mut events: Option<&mut BufWriter<std::fs::File>>,
) -> Result<Scored> {
    let config = PipelineConfig {
        own: Address::default(),
        filter: filter.to_owned(),
        filter_config: robot_run.filter_config.clone(),
        description: DescriptionPolicy::Ignore,
        robot_system: None,
        tag_in_body: Point2::ORIGIN,
        timesync_period: Span::from_millis(1_000),
        wanted: vec![],
        duplicate_window: Span::ZERO,
        thermometers: vec![],
        links: vec![],
    };
    let Some(first) = robot_run.run.observations.first() else {
        bail!("the run is empty")
    };
    let mut pipeline = Pipeline::new(config, first.arrival)?;
    let prior = robot_run.filter_config.calibration;
    let mut scorer = Scorer::new(&robot_run.run, &prior);
    for timed in &robot_run.run.observations {
        pipeline.handle(timed.arrival, &Input::Observation(timed.observation));
        take_outputs(&mut pipeline, collector, events.as_deref_mut())?;
        scorer.observed(
            &timed.observation.observed,
            timed.observation.stamp,
            &pipeline,
        );
    }
    scorer.finish(&pipeline);
    Ok(Scored {
        errors: summarise(&scorer.errors),
        uncorrected: summarise(&scorer.uncorrected),
        learned: Learned::of(&pipeline, &robot_run.run.name, &robot_run.robot, &prior),
    })
}

/// What the filters are given, in hindsight.
fn smoothed_run(robot_run: &RobotRun) -> SmoothedRun {
    let (run, config) = (&robot_run.run, &robot_run.filter_config);
    let observations: Vec<Observation> = run
        .observations
        .iter()
        .map(|timed| timed.observation)
        .collect();
    SmoothedRun::new(&run.name, config, &observations).scored_on(run, &config.calibration)
}

fn draw_run(
    args: &ReplayArgs,
    robot_run: &RobotRun,
    collector: &Collector,
    smoothed: Option<&SmoothedRun>,
) -> Result<()> {
    let run = &robot_run.run;
    let truth = run.truth.iter().map(|truth| TimedPose {
        stamp: truth.stamp,
        pose: pose_at(truth.position, truth.heading),
    });
    let truth = Track::new(truth, LONGEST_GAP);
    let truth = (!run.truth.is_empty()).then_some(&truth);
    let smoothed = smoothed.and_then(SmoothedRun::track);
    draw(args, &run.name, collector, (truth, smoothed.as_ref()))
}

//! A foreign recording: each estimator over each run, scored against the truth or against the fixes that were withheld.

use anyhow::{Result, anyhow, bail, ensure};
use posebridge_analysis::metrics::summarise;
use posebridge_analysis::{ErrorSummary, SourceTally, TimedPose, Track, mean_over_runs};
use posebridge_pipeline::{DescriptionPolicy, FixRequestConfig, Pipeline, PipelineConfig};
use posebridge_telemetry::{Address, Input, Observation, Point2, Span};

use super::recording::changed_settings;
use super::watch::{Lane, Pace, Place, Watch, Window};
use super::{Outcome, Replayed, Seen, SmoothedRun, draw, finish_events, robot};
use crate::cli::{DataFlags, ReplayArgs, SessionFlags};
use crate::collect::{Collector, LONGEST_GAP};
use crate::commands::{Failure, Stage};
use crate::config::names_of_filters;
use crate::data::{DataSet, RobotRun, tell_bad_rows};
use crate::learned::Learned;
use crate::progress;
use crate::score::{Scorer, pose_at};
use crate::tasks::observer::create;

/// The bar moves when so many observations have been given.
const BAR_STEP: u64 = 1_024;
/// The estimators of a foreign recording unless others are asked for.
const USUAL_FILTERS: [&str; 2] = ["odometry", "pose"];

/// A descriptor with the runs and the robot that the flags choose.
pub struct Foreign {
    /// The runs.
    pub data: DataSet,
    flags: DataFlags,
}

impl Foreign {
    /// Reads the descriptor.
    ///
    /// # Errors
    /// It cannot be read or makes no sense, or a flag is for recordings of ours.
    pub fn open(flags: &SessionFlags) -> Result<Self> {
        ensure!(flags.truth.is_none(), "--truth is for recordings of ours: a descriptor names its own truth");
        let data_flags = DataFlags { settings: robot::settings(flags, &[])?, ..flags.data.clone() };
        Ok(Self { data: DataSet::open(&flags.recording, &data_flags)?, flags: data_flags })
    }

    /// Reads a run.
    ///
    /// # Errors
    /// A file or a column is missing, or the robot makes no sense.
    pub fn load(&self, name: &str) -> Result<RobotRun> {
        self.data.load(name, &self.flags)
    }
}

/// Replays the runs of a descriptor with each filter.
///
/// # Errors
/// The descriptor, a file or a flag makes no sense, or an output cannot be written.
pub(super) fn replay(args: &ReplayArgs) -> Result<Replayed, Failure> {
    let window = Window::of(&args.session).at_start()?;
    let foreign = Foreign::open(&args.session).at_start()?;
    if let (Some(_), runs @ 2..) = (&args.save_calibration, foreign.data.runs.len()) {
        return Err(anyhow!(
            "--save-calibration takes what one run has taught, but {runs} are selected: choose one with --run"
        ))
        .at_start();
    }
    let filters = filters_of(args).at_start()?;
    let mut events = args.events.as_deref().map(create).transpose().at_start()?;
    let mut pace = args.speed.map(Pace::new).transpose().at_start()?;
    let mut replayed = Replayed {
        recording: foreign.data.descriptor.name.clone(),
        changed: changed_settings(&args.session),
        ..Replayed::default()
    };
    let mut per_filter: Vec<Gathered> = filters.iter().map(|_| Gathered::default()).collect();
    for name in &foreign.data.runs {
        let robot_run = foreign.load(name).at_start()?;
        replayed.bad_rows += tell_bad_rows(&robot_run);
        if args.smooth {
            replayed.smoothed.push(smoothed_run(&robot_run));
        }
        let mut scored = None;
        for (filter, gathered) in filters.iter().zip(&mut per_filter) {
            let mut seen = Seen::new(Collector::default());
            seen.events = events.as_mut();
            seen.show_at(args.speed);
            let one = replay_run(&robot_run, filter, &mut seen, (window, pace.as_mut())).while_running()?;
            let collector = seen.finish();
            if Some(filter) == filters.last() {
                draw_run(args, &robot_run, &collector, replayed.smoothed.last()).while_running()?;
            }
            scored = Some((one.recorded, one.observations));
            gathered.take(one, collector);
        }
        let (recorded, observations) = scored.unwrap_or_default();
        replayed.recorded += recorded;
        replayed.observations += observations;
    }
    if let Some(events) = events {
        finish_events(events).while_running()?;
    }
    let outcomes = filters.into_iter().zip(per_filter).map(|(name, gathered)| gathered.outcome(name));
    replayed.outcomes = outcomes.collect();
    replayed.runs = foreign.data.runs;
    Ok(replayed)
}

/// The filters that were asked for, else the usual ones.
fn filters_of(args: &ReplayArgs) -> Result<Vec<String>> {
    if args.filters.is_empty() {
        return Ok(USUAL_FILTERS.map(str::to_owned).to_vec());
    }
    args.filters.iter().try_for_each(|filter| check_filter(filter))?;
    Ok(args.filters.clone())
}

/// Whether there is such a filter.
///
/// # Errors
/// There is none.
pub fn check_filter(filter: &str) -> Result<()> {
    ensure!(
        posebridge_estimator::filter_named(filter).is_some(),
        "unknown filter `{filter}`; there are: {}",
        names_of_filters()
    );
    Ok(())
}

/// One run under one filter.
pub struct Scored {
    /// Against the truth or the withheld fixes.
    pub errors: ErrorSummary,
    /// Without the delay that the estimator has learned.
    pub uncorrected: ErrorSummary,
    /// What it has learned.
    pub learned: Option<Learned>,
    /// From the first observation to the last that was given.
    pub recorded: Span,
    /// How many were given.
    pub observations: u64,
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

/// Gives one run to one filter.
///
/// # Errors
/// The run is empty, or as the watcher says.
pub fn replay_run(
    robot_run: &RobotRun,
    filter: &str,
    watch: &mut dyn Watch,
    (window, mut pace): (Window, Option<&mut Pace>),
) -> Result<Scored> {
    let config = PipelineConfig {
        own: Address::default(),
        filter: filter.to_owned(),
        filter_config: robot_run.filter_config.clone(),
        description: DescriptionPolicy::Ignore,
        robot_system: None,
        tag_in_body: Point2::ORIGIN,
        fix_requests: FixRequestConfig::default(),
        timesync_period: Span::from_millis(1_000),
        wanted: vec![],
        duplicate_window: Span::ZERO,
        thermometers: vec![],
        links: vec![],
    };
    let Some(first) = robot_run.run.observations.first() else { bail!("the run is empty") };
    let pipeline = Pipeline::new(config, first.arrival)?;
    let prior = robot_run.filter_config.calibration;
    let mut scorer = Scorer::new(&robot_run.run, &prior);
    let mut lane = Lane { pipeline, watch };
    let bar = progress::bar(robot_run.run.observations.len() as u64, "observations")?;
    if let Some(pace) = &mut pace {
        pace.restart();
    }
    let mut recorded = Span::ZERO;
    let mut observations = 0;
    for timed in &robot_run.run.observations {
        let elapsed = timed.arrival - first.arrival;
        let place = window.place(elapsed);
        if place == Place::Behind {
            break;
        }
        if let Some(pace) = &pace {
            pace.wait(elapsed);
        }
        lane.give(timed.arrival, &Input::Observation(timed.observation), place)?;
        let observation = &timed.observation;
        scorer.observed(&observation.observed, observation.stamp, &lane.pipeline);
        if place == Place::Before {
            scorer.forget();
        }
        recorded = recorded.max(elapsed);
        observations += 1;
        if u64::is_multiple_of(observations, BAR_STEP) {
            bar.set_position(observations);
        }
    }
    bar.finish_and_clear();
    scorer.finish(&lane.pipeline);
    let (name, robot) = (&robot_run.run.name, &robot_run.robot);
    Ok(Scored {
        errors: summarise(&scorer.errors),
        uncorrected: summarise(&scorer.uncorrected),
        learned: Learned::of(&lane.pipeline, name, robot, &prior),
        recorded,
        observations,
    })
}

/// What the filters are given, in hindsight.
fn smoothed_run(robot_run: &RobotRun) -> SmoothedRun {
    let (run, config) = (&robot_run.run, &robot_run.filter_config);
    let observations: Vec<Observation> = run.observations.iter().map(|timed| timed.observation).collect();
    SmoothedRun::new(&run.name, config, &observations).scored_on(run, &config.calibration)
}

fn draw_run(
    args: &ReplayArgs,
    robot_run: &RobotRun,
    collector: &Collector,
    smoothed: Option<&SmoothedRun>,
) -> Result<()> {
    let truth = truth_of(robot_run);
    let smoothed = smoothed.and_then(SmoothedRun::track);
    let tracks = (truth.as_ref(), None, smoothed.as_ref());
    draw(args, &robot_run.run.name, collector, tracks)
}

/// The truth of a run, where it has some.
pub fn truth_of(robot_run: &RobotRun) -> Option<Track> {
    let truth = &robot_run.run.truth;
    let poses =
        truth.iter().map(|truth| TimedPose { stamp: truth.stamp, pose: pose_at(truth.position, truth.heading) });
    (!truth.is_empty()).then(|| Track::new(poses, LONGEST_GAP))
}

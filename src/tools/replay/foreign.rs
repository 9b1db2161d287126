//! Replays a foreign recording: each estimator over each run, scored against the truth or against the withheld fixes.

use anyhow::{Result, anyhow, bail, ensure};
use posebridge_report::metrics::summarise;
use posebridge_report::{ErrorSummary, PoseTrack, SourceTally, TimedPose, mean_over_runs};
use posebridge_station::{
    DescriptionPolicy, FixRequestConfig, GoalPolicy, OwnershipPolicy, RobotConfig, RpmMeaning, Station, StationConfig,
};
use posebridge_telemetry::{Address, Estimate, Input, Observation, Point2, TimeDelta};

use super::own::{changed_settings, profile_settings};
use super::result::{FilterResult, ReplayArgs, ReplayResult, SmoothedRun, SmoothingSpan};
use super::watch::{
    EventWatcher, ReferenceTracks, ReplayLane, ReplayPacer, ReplayWatcher, Window, WindowPosition, finish_events,
    write_charts,
};
use crate::config::names_of_filters;
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::flags::{DataFlags, SessionFlags};
use crate::station::event_collector::{EventCollector, MAX_INTERPOLATION_GAP};
use crate::station::event_file::create;
use crate::station::learned_calibration::LearnedCalibration;
use crate::station::per_robot::PerRobot;
use crate::station::wiring_fix::WiringReport;
use crate::tools::dataset::{DataSet, RobotRun, report_bad_rows};
use crate::tools::score::{Scorer, pose_at};

/// Observations between two updates of the progress bar.
const PROGRESS_STEP: u64 = 1_024;
const DEFAULT_FILTERS: [&str; 2] = ["odometry", "pose"];

/// A descriptor with the selected runs and robot.
pub struct ForeignRecording {
    pub data: DataSet,
    flags: DataFlags,
}

impl ForeignRecording {
    pub fn open(flags: &SessionFlags) -> Result<Self> {
        ensure!(flags.truth.is_none(), "--truth is for recordings of ours: a descriptor names its own truth");
        let data_flags = DataFlags { settings: profile_settings(flags, &[])?, ..flags.data.clone() };
        Ok(Self { data: DataSet::open(&flags.recording, &data_flags)?, flags: data_flags })
    }

    pub fn load(&self, name: &str) -> Result<RobotRun> {
        self.data.load(name, &self.flags)
    }
}

/// Replays the runs of a descriptor with each filter.
pub(super) fn replay(args: &ReplayArgs) -> Result<ReplayResult, Failure> {
    let window = Window::from_flags(&args.session).before_start()?;
    let foreign = ForeignRecording::open(&args.session).before_start()?;
    if let (Some(_), runs @ 2..) = (&args.save_calibration, foreign.data.runs.len()) {
        return Err(anyhow!(
            "--save-calibration takes what one run has taught, but {runs} are selected: choose one with --run"
        ))
        .before_start();
    }
    let filters = filters_of(args).before_start()?;
    let mut events = args.events.as_deref().map(create).transpose().before_start()?;
    let mut pace = args.speed.map(ReplayPacer::new).transpose().before_start()?;
    let mut replayed = ReplayResult {
        recording: foreign.data.descriptor.name.clone(),
        changed_settings: changed_settings(&args.session),
        ..ReplayResult::default()
    };
    let mut per_filter: Vec<ScoreTotals> = filters.iter().map(|_| ScoreTotals::default()).collect();
    for name in &foreign.data.runs {
        let robot_run = foreign.load(name).before_start()?;
        replayed.bad_rows += report_bad_rows(&robot_run);
        replayed.smoothed.extend(args.smooth.then(|| smoothed(&robot_run, SmoothingSpan::WholeRun)));
        replayed.lagged.extend(args.lag().map(|lag| smoothed(&robot_run, SmoothingSpan::Lag(lag))));
        let mut scored = None;
        for (filter, gathered) in filters.iter().zip(&mut per_filter) {
            let mut replay_watcher = ReplayWatcher::new(PerRobot::new(EventCollector::default));
            replay_watcher.events = events.as_mut();
            replay_watcher.show_at(args.speed);
            let one = replay_run(&robot_run, filter, &mut replay_watcher, window, pace.as_mut()).while_running()?;
            // A foreign run is one robot's.
            let robots = replay_watcher.finish().into_entries();
            let collector = robots.into_iter().next().map_or_else(EventCollector::default, |robot| robot.value);
            if Some(filter) == filters.last() {
                write_run_charts(args, &robot_run, &collector, replayed.smoothed.last()).while_running()?;
            }
            if Some(filter) == filters.last() {
                replayed.wiring.extend(one.wiring.clone());
            }
            scored = Some((one.duration, one.observations));
            gathered.add(one, collector);
        }
        let (recorded, observations) = scored.unwrap_or_default();
        replayed.duration += recorded;
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

/// Smooths a run and scores the path like the filter's estimates.
pub fn smoothed(robot_run: &RobotRun, hindsight: SmoothingSpan) -> SmoothedRun {
    let (run, config) = (&robot_run.run, &robot_run.filter_config);
    let observations: Vec<Observation> = run.observations.iter().map(|timed| timed.observation).collect();
    let smoothed = SmoothedRun::new(&run.name, &robot_run.robot, config, &observations, hindsight);
    smoothed.with_scores(run, &config.calibration)
}

fn filters_of(args: &ReplayArgs) -> Result<Vec<String>> {
    if args.filters.is_empty() {
        return Ok(DEFAULT_FILTERS.map(str::to_owned).to_vec());
    }
    args.filters.iter().try_for_each(|filter| check_filter(filter))?;
    Ok(args.filters.clone())
}

pub fn check_filter(filter: &str) -> Result<()> {
    ensure!(
        posebridge_estimator::find_filter(filter).is_some(),
        "unknown filter `{filter}`; there are: {}",
        names_of_filters()
    );
    Ok(())
}

pub struct ReplayScores {
    /// Against the truth or the withheld fixes.
    pub errors: ErrorSummary,
    /// Without the correction of the estimated delay.
    pub uncorrected: ErrorSummary,
    pub learned: Option<LearnedCalibration>,
    pub wiring: Option<WiringReport>,
    /// From the first to the last replayed observation.
    pub duration: TimeDelta,
    pub observations: u64,
}

#[derive(Default)]
struct ScoreTotals {
    errors: Vec<ErrorSummary>,
    uncorrected: Vec<ErrorSummary>,
    learned: Vec<LearnedCalibration>,
    sources: Vec<SourceTally>,
    last: Option<Estimate>,
    quantity: Option<String>,
}

impl ScoreTotals {
    fn add(&mut self, scored: ReplayScores, collector: EventCollector) {
        self.errors.push(scored.errors);
        self.uncorrected.push(scored.uncorrected);
        self.learned.extend(scored.learned);
        self.last = collector.estimates.items().last().copied();
        self.quantity = collector.quantity_steps_text();
        for tally in collector.sources {
            let mut known = self.sources.iter_mut();
            match known.find(|known| known.sensor == tally.sensor) {
                Some(known) => known.merge(&tally),
                None => self.sources.push(tally),
            }
        }
    }

    fn outcome(self, name: String) -> FilterResult {
        FilterResult {
            name,
            robot: None,
            errors: mean_over_runs(&self.errors),
            position_rms_uncorrected_m: mean_over_runs(&self.uncorrected).position_rms_m,
            learned: self.learned,
            sources: self.sources,
            last: self.last,
            quantity: self.quantity,
        }
    }
}

pub fn replay_run(
    robot_run: &RobotRun,
    filter: &str,
    watch: &mut dyn EventWatcher,
    window: Window,
    mut pace: Option<&mut ReplayPacer>,
) -> Result<ReplayScores> {
    let config = StationConfig {
        own_address: Address::default(),
        robot: RobotConfig {
            name: None,
            filter: filter.to_owned(),
            filter_config: robot_run.filter_config.clone(),
            // The observations are corrected already.
            wiring: robot_run.robot.wiring(),
            rpm: RpmMeaning::default(),
            description: DescriptionPolicy::Ignore,
            tag_in_body: Point2::ORIGIN,
            tag: None,
            compared_filters: vec![],
            thermometers: vec![],
            goals: GoalPolicy::Refuse,
        },
        robots: vec![],
        max_robots: 1,
        robot_system: None,
        origin: None,
        fix_requests: FixRequestConfig::default(),
        timesync_period: TimeDelta::from_millis(1_000),
        brick_message_intervals: vec![],
        autopilot_message_intervals: vec![],
        ownership: OwnershipPolicy::Unmanaged,
        duplicate_window: TimeDelta::ZERO,
        links: vec![],
    };
    let Some(first) = robot_run.run.observations.first() else { bail!("the run is empty") };
    let station = Station::new(config, first.arrival)?;
    let prior = robot_run.filter_config.calibration;
    let mut scorer = Scorer::new(&robot_run.run, &prior);
    let mut lane = ReplayLane { stations: station.into(), watcher: watch };
    let bar = progress_bar(robot_run.run.observations.len() as u64, "observations")?;
    if let Some(pace) = &mut pace {
        pace.restart();
    }
    let mut recorded = TimeDelta::ZERO;
    let mut observations = 0;
    for timed in robot_run.run.observations.iter() {
        let elapsed = timed.arrival - first.arrival;
        let position = window.position(elapsed);
        if position == WindowPosition::After {
            break;
        }
        if let Some(pace) = &pace {
            pace.wait(elapsed);
        }
        lane.push(timed.arrival, &Input::Observation(timed.observation), position)?;
        let observation = &timed.observation;
        scorer.on_observation(&observation.measurement, observation.stamp, lane.stations.first());
        if position == WindowPosition::Before {
            scorer.reset();
        }
        recorded = recorded.max(elapsed);
        observations += 1;
        if u64::is_multiple_of(observations, PROGRESS_STEP) {
            bar.set_position(observations);
        }
    }
    bar.finish_and_clear();
    scorer.finish(lane.stations.first());
    let (name, robot) = (&robot_run.run.name, &robot_run.robot);
    let replayed = lane.stations.robots().next();
    Ok(ReplayScores {
        errors: summarise(&scorer.errors),
        uncorrected: summarise(&scorer.uncorrected),
        learned: replayed.and_then(|entry| LearnedCalibration::of_robot(entry, name, robot, &prior)),
        wiring: replayed.map(|entry| WiringReport::of_robot(entry, name.clone(), robot)),
        duration: recorded,
        observations,
    })
}

fn write_run_charts(
    args: &ReplayArgs,
    robot_run: &RobotRun,
    collector: &EventCollector,
    smoothed: Option<&SmoothedRun>,
) -> Result<()> {
    let truth = truth_of(robot_run);
    let smoothed = smoothed.and_then(SmoothedRun::track);
    let tracks = ReferenceTracks { truth: truth.as_ref(), odometry: None, smoothed: smoothed.as_ref() };
    write_charts(args, &robot_run.run.name, collector, tracks)
}

pub fn truth_of(robot_run: &RobotRun) -> Option<PoseTrack> {
    let truth = &robot_run.run.truth;
    let poses = truth.iter().map(|truth| TimedPose { time: truth.time, pose: pose_at(truth.position, truth.heading) });
    (!truth.is_empty()).then(|| PoseTrack::new(poses, MAX_INTERPOLATION_GAP))
}

//! Flags and results of a replay. The smoothers of `--smooth` and `--fixed-lag` get the observations and the configuration of the
//! filters, and are scored against the same reference.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use posebridge_estimator::FilterConfig;
use posebridge_estimator::smoother::{Convergence, OfflineError, smooth, smooth_fixed_lag};
use posebridge_link::HostTimer;
use posebridge_recording::dataset::DatasetRun;
use posebridge_report::metrics::summarise;
use posebridge_report::tables::SmoothRow;
use posebridge_report::{ErrorSummary, FilterVerdict, PoseTrack, SmoothedPath, SourceTally, source_verdicts};
use posebridge_telemetry::{BrickClock, Calibration, Estimate, Observation, ObservationKind, TimeDelta, Timestamp};

use crate::config::RobotFile;
use crate::flags::{DetailFlags, SessionFlags, not_negative, positive};
use crate::station::event_collector::MAX_INTERPOLATION_GAP;
use crate::station::learned_calibration::{LearnedCalibration, with_geometry};
use crate::station::wiring_fix::WiringReport;
use crate::tools::score::{EstimateSource, Scorer};

/// Flags of `replay`.
#[derive(Args, Clone, Debug)]
pub struct ReplayArgs {
    /// What to replay.
    #[command(flatten)]
    pub session: SessionFlags,
    /// Filter to run. Can be repeated to compare several.
    #[arg(long = "filter", visible_alias = "estimator", value_name = "NAME")]
    pub filters: Vec<String>,
    /// Speed relative to real time. Default: as fast as possible.
    #[arg(long, value_name = "FACTOR", value_parser = positive)]
    pub speed: Option<f64>,
    /// Write every event to this file, as one JSON object per line.
    #[arg(long, value_name = "FILE")]
    pub events: Option<PathBuf>,
    /// Write a robot profile with the calibration that the last learning filter found, for `run --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save_calibration: Option<PathBuf>,
    /// At the end, print what was found to be connected, counted or configured wrongly, with the lines of the configuration
    /// that undo it (docs/getting-started.md).
    #[arg(long, conflicts_with = "json")]
    pub fix_wiring: bool,
    /// Also compute the path of each run from all of it: the pose at each instant given what came later as well.
    #[arg(long, conflicts_with_all = ["from", "to"])]
    pub smooth: bool,
    /// Also compute the path with a lag: the pose at each instant given the observations up to so many seconds later.
    #[arg(long, value_name = "SECONDS", value_parser = not_negative, conflicts_with_all = ["from", "to"])]
    pub fixed_lag: Option<f64>,
    /// Write the picture of the last run and the last filter to this file.
    #[arg(long, value_name = "FILE.svg")]
    pub figure: Option<PathBuf>,
    /// Print one JSON object instead of tables (docs/reports.md).
    #[arg(long)]
    pub json: bool,
    /// How much is printed.
    #[command(flatten)]
    pub detail: DetailFlags,
}

impl ReplayArgs {
    pub fn lag(&self) -> Option<TimeDelta> {
        self.fixed_lag.map(TimeDelta::from_secs_f64)
    }
}

pub struct FilterResult {
    pub name: String,
    /// `None` for a single robot.
    pub robot: Option<String>,
    /// The mean over the runs.
    pub errors: ErrorSummary,
    /// Root mean square position error at the withheld fixes' own timestamps, if `errors` is corrected for an estimated delay; the mean
    /// over the runs.
    pub position_rms_uncorrected_m: Option<f64>,
    /// One per run; empty for a filter that is not adaptive.
    pub learned: Vec<LearnedCalibration>,
    /// Over all runs.
    pub sources: Vec<SourceTally>,
    /// The last of the last run.
    pub last: Option<Estimate>,
    /// The steps of a filter of one quantity in the last run, in words.
    pub quantity: Option<String>,
}

impl FilterResult {
    /// `runs` independent ones.
    pub fn verdict(&self, runs: usize) -> FilterVerdict {
        FilterVerdict::new(&self.errors, runs as u64, source_verdicts(&self.sources))
    }

    /// With its robot if there are several.
    pub fn label(&self) -> String {
        self.robot.as_ref().map_or_else(|| self.name.clone(), |robot| format!("{} {robot}", self.name))
    }
}

#[derive(Default)]
pub struct ReplayResult {
    pub recording: String,
    pub runs: Vec<String>,
    pub observations: u64,
    pub bad_rows: u64,
    pub outcomes: Vec<FilterResult>,
    /// Errors of the brick's own odometry, if it is known beside the truth; of the first robot.
    pub odometry: Option<ErrorSummary>,
    /// One per run; empty unless requested.
    pub smoothed: Vec<SmoothedRun>,
    /// With a fixed lag; likewise.
    pub lagged: Vec<SmoothedRun>,
    /// Replayed time over all runs, counted once and not for each estimator.
    pub duration: TimeDelta,
    pub changed_settings: Vec<String>,
    /// Of the last estimator, for each run and robot.
    pub wiring: Vec<WiringReport>,
}

pub struct SmoothedRun {
    pub run: String,
    /// Against the reference of the filters.
    pub errors: ErrorSummary,
    /// At the withheld fixes' own timestamps, if `errors` is corrected for an estimated delay.
    pub uncorrected: ErrorSummary,
    pub result: Result<SmoothedResult, SmoothError>,
    pub elapsed: TimeDelta,
    /// Observations that say nothing of a pose, by sensor.
    pub ignored: BTreeMap<&'static str, u64>,
    /// `None` without a path.
    pub learned: Option<LearnedCalibration>,
}

pub struct SmoothedResult {
    path: SmoothedPath,
    calibration: Calibration,
    /// Absolute observations.
    pub fixes_used: usize,
    /// Those that contradict the rest.
    pub fixes_skipped: usize,
    pub iterations: u32,
    pub cost: f64,
    /// `None` with a fixed lag, which takes one pass.
    pub convergence: Option<Convergence>,
}

/// How much of what came later a pose of a path knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SmoothingSpan {
    WholeRun,
    Lag(TimeDelta),
}

impl SmoothedResult {
    pub fn new(
        config: &FilterConfig,
        observations: &[Observation],
        hindsight: SmoothingSpan,
    ) -> Result<Self, OfflineError> {
        let smoothed = match hindsight {
            SmoothingSpan::WholeRun => smooth(config, observations),
            SmoothingSpan::Lag(lag) => smooth_fixed_lag(config, observations, lag),
        }?;
        Ok(Self {
            path: SmoothedPath::new(smoothed.poses),
            calibration: smoothed.calibration,
            fixes_used: smoothed.fixes_used,
            fixes_skipped: smoothed.fixes_rejected,
            iterations: smoothed.iterations,
            cost: smoothed.cost,
            convergence: (hindsight == SmoothingSpan::WholeRun).then_some(smoothed.convergence),
        })
    }

    /// At its own timestamps.
    pub fn estimates(&self) -> impl Iterator<Item = Estimate> {
        self.path.estimates()
    }

    /// Why the path is not final; `None` where it is.
    pub fn shortfall(&self) -> Option<String> {
        self.convergence.and_then(|convergence| convergence.shortfall())
    }
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SmoothError {
    #[error(transparent)]
    Offline(#[from] OfflineError),
    /// A path needs one continuous clock.
    #[error("the brick restarted {0} time(s): its clock began anew, and what came before and after is not one run")]
    Restarted(u64),
}

impl EstimateSource for SmoothedResult {
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.path.at(stamp)
    }
    fn calibration(&self) -> Option<Calibration> {
        Some(self.calibration)
    }
    fn latest(&self) -> Option<Timestamp<BrickClock>> {
        self.path.latest()
    }
}

impl SmoothedRun {
    pub fn new(
        run: &str,
        robot: &RobotFile,
        config: &FilterConfig,
        observations: &[Observation],
        hindsight: SmoothingSpan,
    ) -> Self {
        let timer = HostTimer::start();
        let before = timer.now();
        let found = SmoothedResult::new(config, observations, hindsight);
        let learned = found.as_ref().ok().map(|found| LearnedCalibration {
            run: run.to_owned(),
            robot: with_geometry(robot, config.geometry),
            prior: config.calibration,
            calibration: found.calibration,
        });
        Self {
            learned,
            run: run.to_owned(),
            errors: ErrorSummary::default(),
            uncorrected: ErrorSummary::default(),
            result: found.map_err(SmoothError::from),
            elapsed: timer.now() - before,
            ignored: count_ignored(observations),
        }
    }

    pub fn failed(run: &str, reason: SmoothError) -> Self {
        Self {
            run: run.to_owned(),
            errors: ErrorSummary::default(),
            uncorrected: ErrorSummary::default(),
            result: Err(reason),
            elapsed: TimeDelta::ZERO,
            ignored: BTreeMap::new(),
            learned: None,
        }
    }

    /// Scores it against the truth or the withheld fixes of a foreign recording.
    pub fn with_scores(mut self, run: &DatasetRun, prior: &Calibration) -> Self {
        if let Ok(found) = &self.result {
            let mut scorer = Scorer::new(run, prior);
            scorer.finish(found);
            self.errors = summarise(&scorer.errors);
            self.uncorrected = summarise(&scorer.uncorrected);
        }
        self
    }

    /// At its own timestamps; empty without a path.
    pub fn estimates(&self) -> Vec<Estimate> {
        let found = self.result.as_ref().ok();
        found.map_or_else(Vec::new, |found| found.estimates().collect())
    }

    pub fn track(&self) -> Option<PoseTrack> {
        let found = self.result.as_ref().ok()?;
        Some(PoseTrack::new(found.path.poses(), MAX_INTERPOLATION_GAP))
    }

    /// Why there is no path, or not a final one.
    pub fn reason(&self) -> Option<String> {
        match &self.result {
            Ok(found) => found.shortfall(),
            Err(error) => Some(error.to_string()),
        }
    }

    pub fn row(&self) -> SmoothRow<'_> {
        let found = self.result.as_ref().ok();
        SmoothRow {
            run: &self.run,
            errors: &self.errors,
            fixes_used: found.map(|found| found.fixes_used),
            fixes_left_out: found.map(|found| found.fixes_skipped),
            iterations: found.map(|found| found.iterations),
            duration: self.elapsed,
            unused_observations: &self.ignored,
            reason: self.result.as_ref().err().map(ToString::to_string),
            shortfall: found.and_then(SmoothedResult::shortfall),
        }
    }
}

fn count_ignored(observations: &[Observation]) -> BTreeMap<&'static str, u64> {
    let mut counts = BTreeMap::new();
    for observation in observations {
        if matches!(observation.measurement, ObservationKind::Temperature(_)) {
            *counts.entry(observation.sensor.name()).or_default() += 1;
        }
    }
    counts
}

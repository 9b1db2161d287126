//! `replay --smooth`: the most likely path of each run, found when it is over, beside what the filters knew in time.
//!
//! It gets the observations that the filters were given and their configuration, and is compared with the same reference. It reads
//! wheels, gyro and fixes; what else a recording has is counted and named.

use std::collections::BTreeMap;

use posebridge_estimator::FilterConfig;
use posebridge_estimator::smoother::{OfflineError, batch};
use posebridge_link::HostTimer;
use posebridge_recording::dataset::DatasetRun;
use posebridge_report::metrics::summarise;
use posebridge_report::tables::SmoothRow;
use posebridge_report::{ErrorSummary, PoseTrack, SmoothedPath};
use posebridge_telemetry::{BrickClock, Calibration, Estimate, Observation, ObservationKind, TimeDelta, Timestamp};

use crate::station::event_collector::MAX_INTERPOLATION_GAP;
use crate::tools::score::{EstimateSource, Scorer};

/// One run, smoothed.
pub struct SmoothedRun {
    /// The run's name.
    pub run: String,
    /// Its errors against the reference of the filters.
    pub errors: ErrorSummary,
    /// Those at the withheld fixes' own stamps, where `errors` is corrected for a delay that was found.
    pub uncorrected: ErrorSummary,
    /// What was found, or why nothing was.
    pub result: Result<SmoothedResult, SmoothError>,
    /// How long it took.
    pub elapsed: TimeDelta,
    /// Observations of kinds that it does not read, by the name of their sensor.
    pub ignored: BTreeMap<&'static str, u64>,
}

/// A path and how it was found.
pub struct SmoothedResult {
    path: SmoothedPath,
    calibration: Calibration,
    /// Fixes that it stands on.
    pub fixes_used: usize,
    /// Fixes that contradict the rest, or lie outside the motion.
    pub fixes_skipped: usize,
    /// Steps of the descent.
    pub iterations: u32,
}

/// Why there is no path.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SmoothError {
    /// The smoother says why.
    #[error(transparent)]
    Offline(#[from] OfflineError),
    /// One path needs one clock.
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
    /// Smooths a run.
    pub fn new(run: &str, config: &FilterConfig, observations: &[Observation]) -> Self {
        let timer = HostTimer::start();
        let before = timer.now();
        let found = batch(config, observations).map(|smoothed| SmoothedResult {
            path: SmoothedPath::new(smoothed.poses),
            calibration: smoothed.calibration,
            fixes_used: smoothed.fixes_used,
            fixes_skipped: smoothed.fixes_rejected,
            iterations: smoothed.iterations,
        });
        Self {
            run: run.to_owned(),
            errors: ErrorSummary::default(),
            uncorrected: ErrorSummary::default(),
            result: found.map_err(SmoothError::from),
            elapsed: timer.now() - before,
            ignored: count_ignored(observations),
        }
    }

    /// A run that cannot be smoothed.
    pub fn failed(run: &str, reason: SmoothError) -> Self {
        Self {
            run: run.to_owned(),
            errors: ErrorSummary::default(),
            uncorrected: ErrorSummary::default(),
            result: Err(reason),
            elapsed: TimeDelta::ZERO,
            ignored: BTreeMap::new(),
        }
    }

    /// Holds it against the truth or the withheld fixes of a foreign recording.
    pub fn with_scores(mut self, run: &DatasetRun, prior: &Calibration) -> Self {
        if let Ok(found) = &self.result {
            let mut scorer = Scorer::new(run, prior);
            scorer.finish(found);
            self.errors = summarise(&scorer.errors);
            self.uncorrected = summarise(&scorer.uncorrected);
        }
        self
    }

    /// Its estimates at its own stamps; none without a path.
    pub fn estimates(&self) -> Vec<Estimate> {
        let found = self.result.as_ref().ok();
        found.map_or_else(Vec::new, |found| found.path.estimates().collect())
    }

    /// Its path, for the figures.
    pub fn track(&self) -> Option<PoseTrack> {
        let found = self.result.as_ref().ok()?;
        Some(PoseTrack::new(found.path.poses(), MAX_INTERPOLATION_GAP))
    }

    /// Its row of the table.
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
        }
    }
}

fn count_ignored(observations: &[Observation]) -> BTreeMap<&'static str, u64> {
    let mut counts = BTreeMap::new();
    for observation in observations {
        match observation.measurement {
            ObservationKind::WheelAngles { .. }
            | ObservationKind::OdometerPose(_)
            | ObservationKind::BodyVelocity { .. }
            | ObservationKind::TurnRate(_)
            | ObservationKind::Fix(_) => {}
            ObservationKind::WheelAccelerations { .. }
            | ObservationKind::Landmark { .. }
            | ObservationKind::BeaconRange { .. }
            | ObservationKind::WallRange(_)
            | ObservationKind::CompassHeading(_)
            | ObservationKind::Temperature(_) => {
                *counts.entry(observation.sensor.name()).or_default() += 1;
            }
        }
    }
    counts
}

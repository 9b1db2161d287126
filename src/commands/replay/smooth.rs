//! `replay --smooth`: the most likely path of each run, found when it is over, beside what the filters knew in time.
//!
//! It gets the observations that the filters were given and their configuration, and is held against the same yardstick. It reads
//! wheels, gyro and fixes; what else a recording has is counted and named.

use std::collections::BTreeMap;

use posebridge_analysis::metrics::summarise;
use posebridge_analysis::report::SmoothRow;
use posebridge_analysis::{ErrorSummary, SmoothedPath, Track};
use posebridge_estimator::FilterConfig;
use posebridge_estimator::offline::{OfflineError, batch};
use posebridge_link::HostTimer;
use posebridge_recording::dataset::Run;
use posebridge_telemetry::{BrickClock, Calibration, Estimate, Observation, Observed, Span, Stamp};

use crate::collect::LONGEST_GAP;
use crate::score::{Belief, Scorer};

/// One run, smoothed.
pub struct SmoothedRun {
    /// The run's name.
    pub run: String,
    /// Its errors against the yardstick of the filters.
    pub errors: ErrorSummary,
    /// Those at the withheld fixes' own stamps, where `errors` is corrected for a delay that was found.
    pub uncorrected: ErrorSummary,
    /// What was found, or why nothing was.
    pub found: Result<Found, NoPath>,
    /// How long it took.
    pub took: Span,
    /// Observations of kinds that it does not read, by the name of their sensor.
    pub not_read: BTreeMap<&'static str, u64>,
}

/// A path and how it was found.
pub struct Found {
    path: SmoothedPath,
    calibration: Calibration,
    /// Fixes that it stands on.
    pub fixes_used: usize,
    /// Fixes that contradict the rest, or lie outside the motion.
    pub fixes_left_out: usize,
    /// Steps of the descent.
    pub iterations: u32,
}

/// Why there is no path.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoPath {
    /// The smoother says why.
    #[error(transparent)]
    Offline(#[from] OfflineError),
    /// One path needs one clock.
    #[error("the brick restarted {0} time(s): its clock began anew, and what came before and after is not one run")]
    Restarted(u64),
}

impl Belief for Found {
    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        self.path.at(stamp)
    }
    fn calibration(&self) -> Option<Calibration> {
        Some(self.calibration)
    }
    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.path.latest()
    }
}

impl SmoothedRun {
    /// Smooths a run.
    #[must_use]
    pub fn new(run: &str, config: &FilterConfig, observations: &[Observation]) -> Self {
        let timer = HostTimer::start();
        let before = timer.now();
        let found = batch(config, observations).map(|smoothed| Found {
            path: SmoothedPath::new(smoothed.poses),
            calibration: smoothed.calibration,
            fixes_used: smoothed.fixes_used,
            fixes_left_out: smoothed.fixes_left_out,
            iterations: smoothed.iterations,
        });
        Self {
            run: run.to_owned(),
            errors: ErrorSummary::default(),
            uncorrected: ErrorSummary::default(),
            found: found.map_err(NoPath::from),
            took: timer.now() - before,
            not_read: not_read(observations),
        }
    }

    /// A run that cannot be smoothed.
    #[must_use]
    pub fn without_path(run: &str, reason: NoPath) -> Self {
        Self {
            run: run.to_owned(),
            errors: ErrorSummary::default(),
            uncorrected: ErrorSummary::default(),
            found: Err(reason),
            took: Span::ZERO,
            not_read: BTreeMap::new(),
        }
    }

    /// Holds it against the truth or the withheld fixes of a foreign recording.
    #[must_use]
    pub fn scored_on(mut self, run: &Run, prior: &Calibration) -> Self {
        if let Ok(found) = &self.found {
            let mut scorer = Scorer::new(run, prior);
            scorer.finish(found);
            self.errors = summarise(&scorer.errors);
            self.uncorrected = summarise(&scorer.uncorrected);
        }
        self
    }

    /// Its estimates at its own stamps; none without a path.
    #[must_use]
    pub fn estimates(&self) -> Vec<Estimate> {
        let found = self.found.as_ref().ok();
        found.map_or_else(Vec::new, |found| found.path.estimates().collect())
    }

    /// Its path, for the figures.
    #[must_use]
    pub fn track(&self) -> Option<Track> {
        let found = self.found.as_ref().ok()?;
        Some(Track::new(found.path.poses(), LONGEST_GAP))
    }

    /// Its row of the table.
    #[must_use]
    pub fn row(&self) -> SmoothRow<'_> {
        let found = self.found.as_ref().ok();
        SmoothRow {
            run: &self.run,
            errors: &self.errors,
            fixes_used: found.map(|found| found.fixes_used),
            fixes_left_out: found.map(|found| found.fixes_left_out),
            iterations: found.map(|found| found.iterations),
            took: self.took,
            not_read: &self.not_read,
            reason: self.found.as_ref().err().map(ToString::to_string),
        }
    }
}

fn not_read(observations: &[Observation]) -> BTreeMap<&'static str, u64> {
    let mut counts = BTreeMap::new();
    for observation in observations {
        match observation.observed {
            Observed::WheelAngles { .. }
            | Observed::OdometerPose(_)
            | Observed::BodyVelocity { .. }
            | Observed::TurnRate(_)
            | Observed::Fix(_) => {}
            Observed::WheelAccelerations { .. }
            | Observed::Landmark { .. }
            | Observed::BeaconRange { .. }
            | Observed::WallRange(_)
            | Observed::CompassHeading(_)
            | Observed::Temperature(_) => {
                *counts.entry(observation.sensor.name()).or_default() += 1;
            }
        }
    }
    counts
}

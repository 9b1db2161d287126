//! What a replay found.

use posebridge_report::{ErrorSummary, SourceTally};
use posebridge_telemetry::TimeDelta;

use super::smooth::SmoothedRun;
use crate::station::learned_calibration::LearnedCalibration;

/// What one estimator did over everything that was replayed.
pub struct FilterResult {
    /// Its name.
    pub name: String,
    /// Which robot it followed, where the recording has several.
    pub robot: Option<String>,
    /// Its errors, the mean over the runs.
    pub errors: ErrorSummary,
    /// Its root mean square position error at the withheld fixes' own stamps, where `errors` is corrected for a delay that it
    /// has learned; the mean over the runs.
    pub position_rms_uncorrected_m: Option<f64>,
    /// What it has learned about the robot, one per run; empty for a filter that learns nothing.
    pub learned: Vec<LearnedCalibration>,
    /// How each sensor's observations fared, over all runs.
    pub sources: Vec<SourceTally>,
}

impl FilterResult {
    /// Its name, and its robot where there are several.
    pub fn label(&self) -> String {
        self.robot.as_ref().map_or_else(|| self.name.clone(), |robot| format!("{} {robot}", self.name))
    }
}

/// Everything that was replayed.
#[derive(Default)]
pub struct ReplayResult {
    /// The recording's name.
    pub recording: String,
    /// Names of the runs.
    pub runs: Vec<String>,
    /// How many observations one estimator was given.
    pub observations: u64,
    /// Rows that could not be used.
    pub bad_rows: u64,
    /// One per estimator.
    pub outcomes: Vec<FilterResult>,
    /// One per run; empty unless it was asked for.
    pub smoothed: Vec<SmoothedRun>,
    /// How much time was replayed, over all runs, once and not for each estimator.
    pub duration: TimeDelta,
    /// What was laid over the recording's own configuration, in words.
    pub changed_settings: Vec<String>,
}

//! Figures of merit of a run: how far off, how honest about it, and what each sensor contributed.
//!
//! One file per family and one line per metric in [`METRICS`]. The functions take plain errors and records; who made
//! the errors, and from which truth, is the caller's business. Nothing here prints, and nothing here judges a single
//! observation: that is the filter's gate.

pub mod anees;
pub mod chi_square;
pub mod consistency;
pub mod error;
pub mod heading;
pub mod innovations;
pub mod nis;
pub mod path;
pub mod position;
pub mod recent;
mod root_mean_square;
pub mod summary;

pub use anees::{Anees, NeesError, anees, nees};
pub use consistency::{Consistency, ConsistencyBand};
pub use error::{PoseError, errors_of_estimates, errors_of_track};
pub use innovations::{Finding, InnovationTest, Judgement, Tone};
pub use nis::{SourceTally, count_in, tally};
pub use path::{PathError, deviations_from_path, path_error};
pub use recent::RecentNis;
pub use summary::{ErrorSummary, mean_over_runs, summarise};

/// What one run left behind for the metrics; any part may be empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct Evidence<'a> {
    /// Estimated minus true pose, in the order of time.
    pub errors: &'a [PoseError],
    /// Distances of the true positions from the ideal path, in metres.
    pub path_deviations_m: &'a [f64],
    /// One tally per sensor.
    pub tallies: &'a [SourceTally],
}

/// A figure of merit that reports, tuning and the command line can name.
#[derive(Clone, Copy, Debug)]
pub struct Metric {
    /// Its name, in lower case with underscores and the unit as suffix where it has one.
    pub name: &'static str,
    /// Its unit; "1" for a ratio.
    pub unit: &'static str,
    /// What it says, in one sentence.
    pub doc: &'static str,
    /// Computes it; `None` where the evidence does not suffice.
    pub of: fn(&Evidence<'_>) -> Option<f64>,
}

/// Every metric. To add one: a file beside this one and a line here.
pub const METRICS: &[Metric] =
    &[position::RMS, position::MAX, position::END, heading::RMS, anees::ANEES, nis::MEAN_NIS, path::RMS, path::MAX];

//! Figures of merit of a run: how far off, how honest about it, and what each sensor contributed.
//!
//! One file per family and one entry per metric in [`METRICS`]. The functions take plain errors and records; who made
//! the errors, and from which truth, is the caller's business. Nothing here prints, and nothing here tests a single observation:
//! that is the filter's gate.

pub mod anees;
pub mod consistency;
pub mod error;
pub mod heading;
pub mod innovations;
pub mod nis;
pub mod path;
pub mod position;
pub mod recent;
pub mod summary;

pub use anees::{Anees, NeesError, anees, nees};
pub use consistency::{Consistency, ConsistencyBand};
pub use error::{PoseError, errors_of_estimates, errors_of_track};
pub use innovations::{InnovationFinding, InnovationTest, InnovationVerdict, VerdictTone};
pub use nis::{SourceTally, add_to_tallies, tally_sources};
pub use path::{PathError, deviations_from_path, path_error};
pub use recent::RecentNis;
pub use summary::{ErrorSummary, mean_over_runs, summarise};

/// What one run left behind for the metrics; any part may be empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct MetricInputs<'a> {
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
    /// Its meaning, in one sentence.
    pub doc: &'static str,
    /// Computes it; `None` where the evidence does not suffice.
    pub compute: fn(&MetricInputs<'_>) -> Option<f64>,
}

/// Every metric. To add one: an entry here, and a function in the file of its family.
pub const METRICS: &[Metric] = &[
    Metric {
        name: "position_rms_m",
        unit: "m",
        doc: "Root mean square distance between estimated and true position.",
        compute: |evidence| position::rms_m(evidence.errors),
    },
    Metric {
        name: "position_max_m",
        unit: "m",
        doc: "Largest distance between estimated and true position.",
        compute: |evidence| position::max_m(evidence.errors),
    },
    Metric {
        name: "position_end_m",
        unit: "m",
        doc: "Distance between estimated and true position at the end of the run.",
        compute: |evidence| position::end_m(evidence.errors),
    },
    Metric {
        name: "heading_rms_rad",
        unit: "rad",
        doc: "Root mean square difference of estimated and true heading, each taken the short way.",
        compute: |evidence| heading::rms_rad(evidence.errors),
    },
    Metric {
        name: "anees",
        unit: "1",
        doc: "Average normalised estimation error squared per degree of freedom; 1 is honest, above 1 over-confident.",
        compute: |evidence| anees(evidence.errors).value,
    },
    Metric {
        name: "mean_nis_per_dof",
        unit: "1",
        doc: "Normalised innovation squared of the used observations of all sensors, per degree of freedom; 1 is honest.",
        compute: |evidence| nis::mean_nis_per_dof(evidence.tallies),
    },
    Metric {
        name: "path_rms_m",
        unit: "m",
        doc: "Root mean square distance of the robot from the ideal path.",
        compute: |evidence| path::summarise_deviations(evidence.path_deviations_m).rms_m,
    },
    Metric {
        name: "path_max_m",
        unit: "m",
        doc: "Largest distance of the robot from the ideal path.",
        compute: |evidence| path::summarise_deviations(evidence.path_deviations_m).max_m,
    },
];

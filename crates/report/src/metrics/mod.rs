//! Metrics of a run: accuracy, consistency, and the contribution of each sensor.
//!
//! The functions take plain errors and records. Nothing here prints, and nothing here tests single observations: the filter's gate
//! does.

pub mod consistency;
pub mod error;
pub mod innovations;

pub use self::consistency::{
    Anees, Consistency, ConsistencyBand, NeesError, RecentNis, SourceTally, add_to_tallies, merge_tally, nees,
    tally_sources,
};
pub use self::error::{
    ErrorSummary, PathError, PoseError, anees, errors_of_estimates, errors_of_track, mean_over_runs, path_error,
    summarise,
};
pub use self::innovations::{InnovationFinding, InnovationTest, InnovationVerdict, VerdictTone};

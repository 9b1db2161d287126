//! Figures of merit of a run: how far off, how honest about it, and what each sensor contributed.
//!
//! The functions take plain errors and records. Nothing here prints, and nothing here tests a single observation: that is the
//! filter's gate.

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

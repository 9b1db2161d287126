//! Metrics of a run: accuracy, consistency, and the contribution of each sensor.
//!
//! The functions take plain errors and records. Nothing here prints, and nothing here tests single observations: the filter's gate
//! does.

pub mod consistency;
pub mod error;
pub mod sources;
pub mod verdict;

pub use self::consistency::{Anees, Consistency, ConsistencyBand, NeesError, nees};
pub use self::error::{
    ErrorSummary, PathError, PoseError, anees, errors_of_estimates, errors_of_track, mean_over_runs, path_error,
    summarise,
};
pub use self::sources::{RecentInnovations, SourceTally, add_to_tallies, merge_tally, source_verdicts, tally_sources};
pub use self::verdict::{FilterVerdict, SourceVerdict, VerdictTone};

//! Plain-text tables for the end of a run and of a replay.
//!
//! People read millimetres and degrees; this is where the numbers become them. The tables are values: printing, colours
//! and JSON belong to the program.

pub(crate) mod accuracy;
mod cells;
pub mod page;
mod replay;
mod run;
mod smooth;
mod table;

pub use accuracy::{ScoreRow, bound_line, score_table};
pub use cells::NO_VALUE;
pub use replay::{EstimatorRow, estimator_table, runs_table, source_table};
pub use run::{RunRow, run_table};
pub use smooth::{SmoothRow, smooth_table};
pub use table::Table;

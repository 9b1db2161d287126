//! Plain-text tables for the end of a run and of a replay, and what other tables are made of.
//!
//! People read millimetres and degrees; this is where the numbers become them. The tables are values: printing, colours
//! and JSON belong to the program.

pub mod cells;
mod replay;
mod run;
mod smooth;
mod text_table;

pub use cells::NO_VALUE;
pub use replay::{EstimatorRow, estimator_table, runs_table, source_table};
pub use run::{RobotErrors, RobotRow, RunRow, robots_table, run_table};
pub use smooth::{SmoothRow, smooth_table};
pub use text_table::TextTable;

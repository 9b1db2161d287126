//! The filters of the papers, faithful to their equations; docs/lab/{square,wall,indirect}.md say where they differ.
//!
//! Paper 2's filter is [`crate::filters::dynamic`]: the thermometers of a running station are made of it.

pub mod ekf5;
pub mod ekf5_corrected;
pub mod indirect;
pub mod paper1;
mod paper_scaffold;
pub mod range_kf;
mod rejected_fixes;
mod rows;
pub mod sigma_points;
pub mod ukf5;
pub mod velocity_kf;
pub mod wheel_kf;

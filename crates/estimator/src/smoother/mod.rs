//! Offline estimation over a complete run, and the bound of any filter's error.
//!
//! Nothing here is for use while a robot drives. [`batch()`] finds the most likely path given all observations, late or
//! not, before or after; reports show it, and filters are compared with it. [`cramer_rao_bound`] gives the least error
//! of any filter. Neither uses a filter's code. [`rts()`] is the pose filter itself, run forwards and back.
//!
//! Source: docs/maths/pose.md.

pub mod batch;
pub mod cramer_rao;
mod factors;
mod forward_pass;
mod gauss_newton;
mod posterior;
mod problem;
pub mod rts;
mod trajectory;

pub use batch::batch;
pub use cramer_rao::{FixArrival, FixContent, GroundTruthRun, cramer_rao_bound};
pub use rts::rts;
pub use trajectory::{OfflineError, SmoothedPose, SmoothedTrajectory};

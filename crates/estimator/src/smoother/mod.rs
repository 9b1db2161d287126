//! What needs the whole run at once: the best estimate in hindsight, and how good any estimate could be.
//!
//! Nothing here is for use while a robot drives. [`batch()`] finds the path that is most likely given everything that was
//! observed, late or not, before or after; reports show it, and filters are held against it. [`cramer_rao_bound`] says how small
//! the error of a filter can be at all. Neither uses a filter's code. [`rts()`] is the flagship itself, run forwards and back.
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

//! Filters that turn observations into a pose with its covariance, in brick time.
//!
//! Letters inside this crate, SI units and radians throughout:
//!
//! ```text
//! x   state, see filters::pose::state for its rows      P   its covariance
//! F   Jacobian of the motion                            Q   process noise
//! z   observation      h(x) its prediction      H = dh/dx      R its noise
//! nu  innovation z - h(x)      S = H P H' + R      K = P H' / S
//! d   distance along the path of the body's origin      dth  change of heading      b  track width
//! ```

mod filter;
pub mod filters;
pub mod fingerprint;
pub mod hand_motions;
pub mod history;
pub mod models;
pub mod motion;
pub mod numerics;
pub mod observations;
pub mod papers;
pub mod params;
mod registry;
pub mod saved;
pub mod smoother;
pub mod tracking;
pub mod update;
mod validation;
pub mod wiring;

pub use filter::{Filter, FilterCommand, FilterConfig};
pub use fingerprint::ConfigFingerprint;
pub use params::{PARAMS, Param, Params};
pub use registry::{EstimatedQuantity, FILTERS, FilterEntry, Initialization, LateDataPolicy, find_filter};
pub use saved::RestoreError;

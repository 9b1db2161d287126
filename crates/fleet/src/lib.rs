//! A fleet: several stations that may hear the same robots.

mod epoch;
mod estimate;
mod keys;
mod names;

pub use epoch::{Epoch, EpochFence, FenceDecision, Token};
pub use estimate::{EstimateError, FleetEstimate};
pub use keys::{FleetKey, FleetKeys, KeyError};
pub use names::{CameraName, FleetName, LinkName, NameError, RobotName, StationId, StationName};

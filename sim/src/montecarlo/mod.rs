//! Drives for Monte-Carlo experiments: truth and sensors on a fixed grid of steps, without brick, link or clock.
//!
//! The [`Simulation`](crate::Simulation) sends bytes to a station as a robot does. An experiment over thousands of
//! drives needs the observations themselves, in the order of arrival, the truth at each step, and exactly the noise of
//! a file. A [`Scenario`] holds every number; [`Scenario::drive`] draws one run of it. The experiment builds a filter
//! from its [`FilterPrior`]; this module has no estimator.
//!
//! # Model
//! ```text
//! dphi_i = s_i / r_i          wheel rotation of the commanded travel s_L, s_R = ds -+ b dth / 2, with the true r_i and b
//! s_i   <- s_i + k_w sqrt|s_i| n                                     travel of wheel i, with slip
//! dth    = (s_R - s_L) / b    dth <- dth + k_t sqrt|dth| n + kick    true turn
//! (x, y) <- the chord of an exact arc of length (s_L + s_R) / 2 and turn dth
//! n   standard normal, drawn anew each time
//! ```
//! Encoders measure `dphi_i`, without slip and kicks; the gyro measures the true turn.
//!
//! Every run draws from its own seed, derived from the scenario's seed and the run's number; each sensor has its own
//! random stream, as everywhere in [`crate`]. So a run can be repeated alone, and scenarios with the same seed, path
//! and robot share their truth, whatever their camera.

mod drive;
mod plan;
mod robot;
mod scenario;

pub use crate::checks::MAX_RUNS;
pub use crate::config_file::ConfigFileError as ScenarioError;
pub use crate::scenario::Blackout;
pub use drive::{Arrival, Drive, FilterPrior};
pub use robot::WheelTurn;
pub use scenario::{
    Accelerometer, Camera, CameraSees, Course, GeometryErrors, Gyro, Kicks, Laps, MotionNoise, NominalRobot, Outliers,
    PriorGeometry, PriorSettings, SCENARIOS, Scenario, Spline, Weave,
};

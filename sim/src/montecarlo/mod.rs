//! Drives for Monte-Carlo experiments: truth and sensors on a fixed grid of steps, without brick, link or clock.
//!
//! The [`Simulation`](crate::Simulation) speaks to a station as a robot does, byte by byte. An experiment over thousands of
//! drives wants less and more: the observations themselves, in the order in which they arrive, the truth at each step, and
//! a noise that is exactly what a file says. A [`Scenario`] holds every number; [`Scenario::drive`] draws one run of it. It
//! knows no estimator: it says what a filter is [`Told`], and somebody else builds one from that.
//!
//! # Model
//! ```text
//! dphi_i = s_i / r_i          wheel rotation of the commanded travel s_L, s_R = ds -+ b dth / 2, with the true r_i and b
//! s_i   <- s_i + k_w sqrt|s_i| n                                     travel of wheel i, with slip
//! dth    = (s_R - s_L) / b    dth <- dth + k_t sqrt|dth| n + kick    true turn
//! (x, y) <- the chord of an exact arc of length (s_L + s_R) / 2 and turn dth
//! n   standard normal, drawn anew each time
//! ```
//! Encoders see `dphi_i`, so they see neither slip nor kick; the gyro sees the true turn.
//!
//! Every run draws from its own seed, made of the scenario's seed and the run's number; each sensor has a stream of its own
//! ([`crate`]'s rule for all its randomness). So a run can be repeated alone, and scenarios with the same seed, path and
//! robot share their truth, whatever their camera.

mod bundled;
mod camera;
mod drive;
mod path;
mod robot;
mod scenario;
mod spline;

pub use bundled::SCENARIOS;
pub use drive::{Arrival, Drive, Told, WheelTurn};
pub use scenario::{
    Accelerometer, Blackout, Camera, CameraSees, Course, Errors, Gyro, Kicks, Laps, MAX_RUNS, Motion, Nominal,
    Outliers, Prior, Scenario, ScenarioError, Spline, ToldGeometry, Weave,
};

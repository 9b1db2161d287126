//! Before a wall: the parameters of a car from a step test, the wall filter's estimates from its readings, and how well it
//! predicts the next.
//!
//! The experiments of paper 3 by computation alone: a [`WallLog`] goes in, from the simulator or from a recording, numbers come out.
//! The filter itself is the estimator's `range-kf` with its corrected twin; nothing here estimates beside it but the yardstick that
//! the paper compares with, the line through the last two readings.
//!
//! # Model
//! ```text
//! dz/dt = -v        dv/dt = (u - d v) / m        u the motor input: 1 at the PWM of the step
//! d = 1 / v_ss      m = d t_90 / ln 10           a = d / m
//! z(t) = z_0 - v_ss phi_a(t)                     phi_a: the way that a unit input has led in the time since the log began
//! ```
//! # Sources
//! Paper 3 (Lab 7: step test, piecewise lines, d and m); docs/lab/wall.md.

mod fit;
mod foresee;
mod log;
mod periods;
mod plant;
mod replay_filter;
mod response;
mod step_by_hand;
mod stops;
mod validate;

pub use fit::{StepFit, fit_steps};
pub use foresee::{ForecastScore, GateStatistics, RangeForecast, forecast, gate_statistics, score_forecasts};
pub use log::{WallEntry, WallLog, WallReading};
pub use periods::{loop_period, reading_period};
pub use plant::{Plant, PlantSearch};
pub use replay_filter::{
    ApproachEstimate, ApproachEstimator, KalmanNoise, LastReading, LinearExtrapolation, WallKalman,
};
pub use step_by_hand::{
    ManualStepFit, SpeedSample, WallStepError, differences, fit_by_hand, mean_manual_fit, overlapping_lines,
};
pub use stops::{NEAR_WALL_M, StopComparison, StopResult, StopSummary, compare_stops, summarise_stops};
pub use validate::{GateTrial, Validation, gate_trial, validate_model};

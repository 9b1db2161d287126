//! Car before a wall: its parameters from a step test, the wall filter's estimates from its readings, and the filter's prediction
//! errors.
//!
//! # Model
//! ```text
//! dz/dt = -v        dv/dt = (u - d v) / m        u the motor input: 1 at the PWM of the step
//! d = 1 / v_ss      m = d t_90 / ln 10           a = d / m
//! z(t) = z_0 - v_ss phi_a(t)                     phi_a: travel of a unit input since the log began
//! ```
//! # Sources
//! Paper 3 (Lab 7: step test, piecewise lines, d and m); docs/lab/wall.md.

mod drive_bank;
mod fit;
mod forecast;
mod log;
mod replay_filter;
mod single_step;
mod step_error;
mod step_evidence;

pub use self::drive_bank::{BankPrediction, BankUpdate, DriveBank};
pub use self::fit::{
    ManualStepFit, PIECE, SpeedSample, StepFit, differences, fit_by_hand, fit_steps, mean_manual_fit, overlapping_lines,
};
pub use self::forecast::{
    ForecastScore, ForecastVerdict, GateStatistics, LINES, RangeForecast, forecast, gate_statistics,
    score_against_best_line, score_forecasts,
};
pub use self::log::{StepCommand, WallEntry, WallLog, WallReading, loop_period, reading_period};
pub use self::replay_filter::{
    ApproachEstimate, ApproachEstimator, GateSample, GateTrial, KalmanNoise, LinearExtrapolation, NEAR_WALL_M,
    StopComparison, StopResult, StopSummary, Validation, WallKalman, compare_stops, gate_trial, summarise_stops,
    validate_model,
};
pub use self::single_step::{SingleStep, find_step};
pub use self::step_error::{Guess, UndeterminedReason, WallStepError};

//! Before a wall: what a step test tells of a car, what the wall filter makes of its readings, and how well it foresees the next.
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
//! Paper 3 (Lab 7: step test, piecewise lines, d and m); docs/maths/paper3.md; docs/lab/wall.md.

mod believe;
mod fit;
mod foresee;
mod lines;
mod log;
mod periods;
mod plant;
mod response;
mod stops;
mod validate;

pub use believe::{Belief, Believer, Kalman, KalmanNoise, LastReading, LineThrough};
pub use fit::{StepFit, fit_steps};
pub use foresee::{Foreseen, GateUse, Score, foresee, gate_use, score};
pub use lines::{HandStep, SpeedAt, StepError, by_hand, differences, mean_by_hand, overlapping_lines};
pub use log::{Said, WallEntry, WallLog};
pub use periods::{loop_period, reading_period};
pub use plant::{Plant, PlantSearch};
pub use stops::{NEAR_M, Paired, StopSummary, Stopped, paired, summarise_stops};
pub use validate::{GateTrial, Validation, gate_trial, validate};

//! A car before a wall: a slow drive, a time-of-flight sensor with its own rate, and a PID controller on board.
//!
//! Two experiments of paper 3 with known truth and without a filter: [`simulate_step`] gives the readings of a step test; [`approach`]
//! drives up to the wall by the distance of a [`DistanceEstimator`], [`approach_over_link`] by one behind an impaired link.
//!
//! # Model
//! ```text
//! dz/dt = -v        dv/dt = (c - v) / tau        c = v_ss PWM / PWM_0        tau = t_90 / ln 10
//! reading = z + (sigma + share z) n, never below zero, every period, now and then none          n standard normal
//! PWM = kp e + ki int(e) + kd de/dt, within +- PWM_max        e = estimated z - target, de/dt = -estimated v
//! ```
//! Between two control cycles the PWM is held and the motion is exact. The wall is perpendicular to the path, the floor level, the battery
//! constant; brick and host share one clock.
//!
//! # Sources
//! Paper 3 (Lab 7); `config/scenarios/lab/wall.toml` has every number of the default scene with its origin.

mod approach;
mod car;
mod population;
mod scene;

pub use crate::config_file::ConfigFileError as SceneError;
pub use approach::{
    Approach, ApproachSample, ApproachTask, DistanceEstimator, HostLink, StopPoint, approach, approach_over_link,
};
pub use car::{RangeEstimate, RangeReading, StepRun, TimedCommand, simulate_step};
pub use population::{ApproachKind, RecordedApproach, draw_approach};
pub use scene::{
    ApproachSettings, CarSettings, ControlSettings, DEFAULT_SCENE, Gains, HostSettings, RangerSettings, StepSettings,
    WallScene,
};

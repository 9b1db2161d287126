//! A car before a wall: a slow drive, a time-of-flight sensor with a rate of its own, and a PID controller on board.
//!
//! Two experiments of paper 3 on truth that is known. [`step`] gives the readings of a step test, to identify the drive from.
//! [`approach`] drives up to the wall by somebody else's idea of the distance, which comes in as a [`DistanceEstimator`]; with
//! [`approach_over_link`] that one sits on the other side of a bad link. This module knows no filter, like the whole crate.
//!
//! # Model
//! ```text
//! dz/dt = -v        dv/dt = (c - v) / tau        c = v_ss PWM / PWM_0        tau = t_90 / ln 10
//! reading = z + (sigma + share z) n, never below zero, every period, now and then none          n standard normal
//! PWM = kp e + ki int(e) + kd de/dt, within +- PWM_max        e = believed z - target, de/dt = -believed v
//! ```
//! Between two turns of the control loop the PWM is held and the motion is exact.
//!
//! # Assumptions
//! The wall is square to the way, the floor level, the battery constant. Brick and host count the same time: aligning clocks is
//! another experiment.
//!
//! # Sources
//! Paper 3 (Lab 7); every number of the default scene stands in `config/scenarios/lab/wall.toml` with its origin.

mod approach;
mod car;
mod host;
mod pid;
mod ranger;
mod scene;
mod step;
mod wire;

pub use approach::{Approach, Believed, DistanceEstimator, Moment, Stop, Task, approach};
pub use host::{HostLink, approach_over_link};
pub use pid::Gains;
pub use ranger::Reading;
pub use scene::{
    ApproachSettings, CarSettings, ControlSettings, DEFAULT_SCENE, HostSettings, RangerSettings, SceneError,
    StepSettings, WallScene,
};
pub use step::{CommandFrom, StepRun, step};

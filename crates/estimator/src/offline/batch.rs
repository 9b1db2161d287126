//! The most likely path given everything that was observed: what reports show, and what filters are held against.
//!
//! Gets all observations of a run in any order and gives back a pose with its covariance for every motion reading, with the
//! calibration that fits best. It uses every motion reading, gyro windows and fixes; other kinds of observation are ignored,
//! and so are fixes before the first motion reading and after the last.
//!
//! # Model
//! ```text
//! minimise  |start|^2 + sum |motion|^2 + sum |gyro window|^2 + sum |fix|^2 + sum |prior|^2      residuals over their sigmas
//! ```
//! in rounds: descend with the fixes in use; then judge each fix by all the others; again, until that changes nothing.
//!
//! # Assumptions
//! The noise is what the configuration says and white; the wheels do not slip beyond it (there is no slip test here); windows of
//! the gyro are independent of each other.
//!
//! # Source
//! docs/maths/batch.md.

use posebridge_telemetry::{Arena, BrickClock, Calibration, Observation, Pose, Stamp};

use super::judged::Judged;
use super::problem::Run;
use super::rounds::{Round, whiteners};
use super::values::constants_of;
use crate::filters::{FilterConfig, intake};
use crate::gate::chi_square_quantile;

/// Rounds after which it is said not to settle; two or three are usual.
const MOST_ROUNDS: u32 = 20;

/// The most likely path of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothed {
    /// One per motion reading, in the order of their stamps; of [`super::rts()`] one per fix as well.
    pub poses: Vec<SmoothedPose>,
    /// What fits best; what is not estimated is as it was configured. The gyro bias is that of the last window.
    pub calibration: Calibration,
    /// Sum of the squared residuals over their sigmas, at the optimum.
    pub cost: f64,
    /// Steps of the descent, over all rounds.
    pub iterations: u32,
    /// How many fixes were used.
    pub fixes_used: usize,
    /// How many fixes were refused by the gate, or lie outside the motion readings.
    pub fixes_left_out: usize,
    /// How many gyro windows were used.
    pub gyro_windows: usize,
}

/// Where the robot was at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedPose {
    /// The instant of a motion reading.
    pub stamp: Stamp<BrickClock>,
    /// The most likely pose.
    pub pose: Pose<Arena>,
    /// Covariance of x, y and heading in the arena: m², m rad, rad².
    pub covariance: [[f64; 3]; 3],
}

/// Why there is no smoothed path.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OfflineError {
    /// There is no motion reading, or neither a start nor a fix.
    #[error("nothing to smooth: {motion_readings} motion readings, {fixes} fixes and no start")]
    NothingObserved {
        /// How many motion readings could be used.
        motion_readings: usize,
        /// How many fixes between the first and the last of them.
        fixes: usize,
    },
    /// The descent does not become still.
    #[error("the descent does not converge: the cost stays at {cost}")]
    Diverged {
        /// Where it ended.
        cost: f64,
    },
    /// The configuration or its noise leads to numbers that are none.
    #[error("the configuration leads to numbers that are not finite")]
    NotFinite,
}

/// Finds the most likely path and calibration.
///
/// Takes the observations in any order. `config` says what is known beforehand, as for a filter: start, noise, calibration (a
/// constant whose sigma is zero is not estimated) and the gate.
///
/// # Errors
/// [`OfflineError`]: nothing observed, no convergence, or a configuration that is not finite.
pub fn batch(config: &FilterConfig, observations: &[Observation]) -> Result<Smoothed, OfflineError> {
    let run = Run::new(config, observations);
    if run.motion_readings() == 0 {
        return Err(OfflineError::NothingObserved { motion_readings: 0, fixes: 0 });
    }
    if !is_sane(config) {
        return Err(OfflineError::NotFinite);
    }
    let gates = [1, 2, 3].map(|n| chi_square_quantile(n, config.params.gate_probability));
    let mut iterations = 0;
    let mut state = Round::first(config, run.fixes());
    let mut cost = f64::NAN;
    for round in 0..MOST_ROUNDS {
        let problem = run.problem(state.delay_s);
        if config.start.is_none() && problem.fixes.is_empty() {
            return Err(OfflineError::NothingObserved { motion_readings: run.motion_readings(), fixes: 0 });
        }
        let whiteners = whiteners(&problem, &state.constants)?;
        let descended = state.descend(&problem, &whiteners, gates)?;
        iterations += descended.steps;
        cost = descended.linearised.cost;
        let judged = Judged::of(&problem, &descended, &state.is_used, gates);
        let values = descended.values;
        if state.adopt(values.clone(), &judged.fits, round) && round > 0 {
            let used = state.is_used.iter().filter(|used| **used).count();
            return Ok(Smoothed {
                poses: judged.poses(&problem, &values),
                calibration: judged.calibration(&problem, &values),
                cost,
                iterations,
                fixes_used: used,
                fixes_left_out: run.fixes() - used,
                gyro_windows: problem.windows.len(),
            });
        }
    }
    Err(OfflineError::Diverged { cost })
}

/// Whether geometry, start and what is known beforehand are numbers that a robot can have.
pub(super) fn is_sane(config: &FilterConfig) -> bool {
    let geometry = &config.geometry;
    let lengths = [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0, geometry.track_width.0];
    let known = constants_of(&config.calibration);
    lengths.iter().all(|length| length.is_finite() && *length > 0.0)
        && config.start.is_none_or(|start| intake::is_usable(&start))
        && known.iter().all(|known| known.value.is_finite() && known.sigma.is_finite() && known.sigma >= 0.0)
}

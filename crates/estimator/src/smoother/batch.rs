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
//! in rounds: descend with the fixes in use; then test each fix against all the others; again, until that changes nothing.
//!
//! # Assumptions
//! The noise is the configured one, and white; the wheels do not slip beyond it (there is no slip test here); windows of
//! the gyro are independent of each other.
//!
//! # Source
//! docs/maths/pose.md.

use posebridge_telemetry::Observation;

use super::outer_iterations::{OuterIteration, whiteners};
use super::posterior::GatedObservation;
use super::problem::RunData;
use super::trajectory::{OfflineError, SmoothedTrajectory};
use super::values::constants_of;
use crate::filter::FilterConfig;
use crate::numerics::chi_square::chi_square_quantile;
use crate::validation;

/// Rounds after which it is said not to settle; two or three are usual.
const MAX_ROUNDS: u32 = 20;

/// Finds the most likely path and calibration.
///
/// Takes the observations in any order. `config` says what is known beforehand, as for a filter: start, noise, calibration (a
/// constant whose sigma is zero is not estimated) and the gate.
///
/// # Errors
/// [`OfflineError`]: nothing observed, no convergence, or a configuration that is not finite.
pub fn batch(config: &FilterConfig, observations: &[Observation]) -> Result<SmoothedTrajectory, OfflineError> {
    let run = RunData::new(config, observations);
    if run.motion_readings() == 0 {
        return Err(OfflineError::NothingObserved { motion_readings: 0, fixes: 0 });
    }
    if !is_valid_config(config) {
        return Err(OfflineError::NotFinite);
    }
    let gates = [1, 2, 3].map(|n| chi_square_quantile(n, config.params.gate_probability));
    let mut iterations = 0;
    let mut state = OuterIteration::initial(config, run.fixes());
    let mut cost = f64::NAN;
    for round in 0..MAX_ROUNDS {
        let problem = run.problem(state.delay_s);
        if config.start.is_none() && problem.fixes.is_empty() {
            return Err(OfflineError::NothingObserved { motion_readings: run.motion_readings(), fixes: 0 });
        }
        let whiteners = whiteners(&problem, &state.constants)?;
        let descended = state.minimize(&problem, &whiteners, gates)?;
        iterations += descended.steps;
        cost = descended.linearised.cost;
        let judged = GatedObservation::evaluate(&problem, &descended, &state.is_used, gates);
        let values = descended.values;
        if state.update(values.clone(), &judged.passes_gate, round) && round > 0 {
            let used = state.is_used.iter().filter(|used| **used).count();
            return Ok(SmoothedTrajectory {
                poses: judged.poses(&problem, &values),
                calibration: judged.calibration(&problem, &values),
                cost,
                iterations,
                fixes_used: used,
                fixes_rejected: run.fixes() - used,
                gyro_windows: problem.windows.len(),
            });
        }
    }
    Err(OfflineError::Diverged { cost })
}

/// Whether geometry, start and what is known beforehand are numbers that a robot can have.
pub(super) fn is_valid_config(config: &FilterConfig) -> bool {
    let geometry = &config.geometry;
    let lengths = [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0, geometry.track_width.0];
    let known = constants_of(&config.calibration);
    lengths.iter().all(|length| length.is_finite() && *length > 0.0)
        && config.start.is_none_or(|start| validation::is_valid_start(&start))
        && known.iter().all(|known| known.value.is_finite() && known.sigma.is_finite() && known.sigma >= 0.0)
}

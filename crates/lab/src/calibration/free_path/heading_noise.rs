//! How far a heading that wanders moves the numbers that are looked for.
//!
//! # Model
//! ```text
//! th <- th + n        n ~ N(0, q_j)           in the j-th piece of a drive, q_j by the robot's described noise over that piece
//! cov += sum_j q_j g_j g_j'                   g_j = -A^-1 J' dr/dn_j: how far the fit moves per radian
//! ```
//! The fit itself takes the heading for exact, which is what finds a track. Its robust covariance sees what of the residuals is left;
//! but a wandering that unequal wheels explain as well leaves nothing behind, and would count as knowledge.

use posebridge_estimator::models::differential_drive::{WheelTravel, step_noise};
use posebridge_telemetry::SensorNoise;

use super::drive::FreePath;
use super::predict::nominal;

/// Pieces of a drive: with this number of jumps, sums over it behave like those of a random walk.
const JUMPS_PER_PATH: usize = 24;

/// One place of a drive at which its heading jumps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HeadingJump {
    /// The step that turns by more.
    step: usize,
    /// Variance of the heading over the piece that it stands for, in rad².
    pub(super) var_rad2: f64,
}

/// The jumps that stand for the wandering of a drive, for a track of this width.
pub(super) fn heading_jumps(path: &FreePath, track_width_m: f64, noise: &SensorNoise) -> Vec<HeadingJump> {
    let geometry = nominal(track_width_m);
    let length = path.steps.len().div_ceil(JUMPS_PER_PATH).max(1);
    let pieces = path.steps.chunks(length).enumerate();
    let jumps = pieces.map(|(piece, steps)| {
        let vars = steps.iter().map(|step| step_noise(step.travel, &geometry, noise).turn_var_rad2);
        HeadingJump { step: piece * length + steps.len() / 2, var_rad2: vars.sum() }
    });
    jumps.filter(|jump| jump.var_rad2 > 0.0).collect()
}

/// The drive with a heading that jumps by `by_rad`.
pub(super) fn apply_jump(path: &FreePath, jump: HeadingJump, by_rad: f64, track_width_m: f64) -> FreePath {
    let mut path = path.clone();
    if let Some(step) = path.steps.get_mut(jump.step) {
        let apart_m = 0.5 * by_rad * track_width_m;
        step.travel = WheelTravel { left_m: step.travel.left_m - apart_m, right_m: step.travel.right_m + apart_m };
    }
    path
}

//! The motion from one pose to the next, as whitened rows.
//!
//! # Model
//! ```text
//! D = T_k^-1 T_k+1 = (u, phi)          e = (cos phi/2, sin phi/2)    n = (-sin phi/2, cos phi/2)    c = sin(phi/2)/(phi/2)
//! r = [ e'u / c - d ]                  the arc through both poses is as long as the wheels say
//!     [ phi - dth   ]                  and turns as far
//!     [ n'u         ]                  and leaves no lateral error
//! d = (s_L + s_R)/2    dth = (s_R - s_L)/b    s_L = s_L0 (1 + e_m - e_d/2)   s_R = s_R0 (1 + e_m + e_d/2)   b = b0 (1 + e_b)
//! ```
//! # Sources
//! models::differential_drive for the noise; docs/maths/pose.md section B2.

use nalgebra::{Matrix3, SMatrix, Vector3};
use posebridge_telemetry::{DriveGeometry, Meters};

use super::factors::{MAX_ROW_ENTRIES, WhitenedRow};
use super::problem::{MotionSegment, SmoothingProblem};
use super::values::{CONSTANTS, ProblemValues, RADIUS_DIFFERENCE, RADIUS_SCALE, TRACK_SCALE, UnwrappedPose};
use crate::filter::FilterConfig;
use crate::models::differential_drive::{WheelTravel, body_step, step_noise};
use crate::models::se2::{BodyStep, StepRule, displace};

/// Lateral error of an arc, and the least of its other errors, m per sqrt(m) of the wheels' path: a thousandth of what a good
/// wheel slips. It stands for "none": without it the motion of three coordinates would have noise in two only.
const LATERAL_M_PER_SQRT_M: f64 = 1e-6;
/// Where the path is next to nothing, m²: ten nanometres.
const MIN_VARIANCE_M2: f64 = 1e-16;
/// What a robot may do while nothing observes its motion, m per sqrt(s): a LEGO robot's walking pace.
const UNOBSERVED_M_PER_SQRT_S: f64 = 0.3;
/// The same for its heading, rad per sqrt(s).
const UNOBSERVED_RAD_PER_SQRT_S: f64 = 1.0;

/// Distance and turn of a step with their derivatives by radius scale, radius difference and track scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CalibratedStep {
    /// d, m.
    pub(super) forward_m: f64,
    /// dth, rad.
    pub(super) turn_rad: f64,
    /// Derivatives of both, by radius scale, radius difference and track scale.
    pub(super) by_constant: [[f64; 3]; 2],
}

/// What the wheels did, seen through the calibration.
pub(super) fn calibrated_step(
    travel: WheelTravel,
    config: &FilterConfig,
    constants: &[f64; CONSTANTS],
) -> CalibratedStep {
    let (true_travel, geometry) = true_travel(travel, config, constants);
    let step = body_step(true_travel, &geometry);
    let track_m = geometry.track_width.0;
    let (sum_m, difference_m) = (travel.right_m + travel.left_m, travel.right_m - travel.left_m);
    CalibratedStep {
        forward_m: step.forward_m,
        turn_rad: step.turn_rad,
        by_constant: [
            [0.5 * sum_m, 0.25 * difference_m, 0.0],
            [difference_m / track_m, 0.5 * sum_m / track_m, -step.turn_rad / (1.0 + constants[TRACK_SCALE])],
        ],
    }
}

/// The wheels' travel with the true radii, and the geometry with the true track, as a calibration has them.
pub(super) fn true_travel(
    travel: WheelTravel,
    config: &FilterConfig,
    constants: &[f64; CONSTANTS],
) -> (WheelTravel, DriveGeometry) {
    let mean = 1.0 + constants[RADIUS_SCALE];
    let half_difference = 0.5 * constants[RADIUS_DIFFERENCE];
    let mut geometry = config.geometry;
    geometry.track_width = Meters(geometry.track_width.0 * (1.0 + constants[TRACK_SCALE]));
    let scaled = WheelTravel {
        left_m: travel.left_m * (mean - half_difference),
        right_m: travel.right_m * (mean + half_difference),
    };
    (scaled, geometry)
}

/// What turns a motion's residual (distance, turn, lateral) into unit variance.
pub(super) type Whitener = Matrix3<f64>;

/// The whitener of a move, with the noise of the travel by this calibration; `None` when the noise is no number.
pub(super) fn whitener(by: &MotionSegment, config: &FilterConfig, constants: &[f64; CONSTANTS]) -> Option<Whitener> {
    let covariance = match *by {
        MotionSegment::Unobserved(secs) => {
            let position_m2 = UNOBSERVED_M_PER_SQRT_S.powi(2) * secs;
            let heading_rad2 = UNOBSERVED_RAD_PER_SQRT_S.powi(2) * secs;
            Matrix3::from_diagonal(&Vector3::new(position_m2, heading_rad2, position_m2))
        }
        MotionSegment::Driven { travel, path_var_m2 } => {
            let (travel, geometry) = true_travel(travel, config, constants);
            let noise = step_noise(travel, &geometry, &config.noise);
            let path_m = 0.5 * (travel.left_m.abs() + travel.right_m.abs());
            let floor_m2 = LATERAL_M_PER_SQRT_M.powi(2) * path_m + MIN_VARIANCE_M2;
            let half_track_m = 0.5 * geometry.track_width.0;
            let cross = noise.forward_turn_m_rad;
            Matrix3::new(
                noise.forward_var_m2 + floor_m2 + path_var_m2,
                cross,
                0.0,
                cross,
                noise.turn_var_rad2 + floor_m2 / half_track_m.powi(2),
                0.0,
                0.0,
                0.0,
                floor_m2 + path_var_m2,
            )
        }
    };
    covariance.cholesky()?.l().try_inverse()
}

/// Three rows for the motion from one pose to the next.
pub(super) fn motion_rows(
    problem: &SmoothingProblem<'_>,
    values: &ProblemValues,
    node: usize,
    whitener: &Whitener,
) -> [WhitenedRow; 3] {
    let (from, to) = (values.poses[node], values.poses[node + 1]);
    let (residual, by_unknown) = match problem.segments[node] {
        MotionSegment::Driven { travel, .. } => {
            let step = calibrated_step(travel, problem.config, &values.constants);
            arc_residual(from, to, &step)
        }
        MotionSegment::Unobserved(_) => offset_residual(from, to),
    };
    let (white, by_unknown) = (whitener * residual, whitener * by_unknown);
    let layout = problem.layout();
    std::array::from_fn(|i| {
        let mut row = WhitenedRow::from_residual(white[i]);
        for column in 0..6 {
            let variable = layout.pose(node + column / 3, column % 3);
            row = row.with_derivative(variable, by_unknown[(i, column)]);
        }
        for (column, constant) in [RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE]
            .into_iter()
            .enumerate()
            .filter(|(_, constant)| problem.is_free[*constant])
        {
            row = row.with_derivative(constant, by_unknown[(i, 6 + column)]);
        }
        row
    })
}

/// The second pose in the space of the first: u = (forward, left) and phi.
fn relative(from: UnwrappedPose, to: UnwrappedPose) -> ([f64; 2], f64) {
    let (sin, cos) = from.heading_rad.sin_cos();
    let (dx_m, dy_m) = (to.x_m - from.x_m, to.y_m - from.y_m);
    let u = [cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m];
    (u, to.heading_rad - from.heading_rad)
}

/// Residual of an arc between two poses (distance, turn, lateral) and its derivatives by xi of both and by the constants.
///
/// ```text
/// T_k Exp(xi)     u moves by -rho - theta J u, phi by -theta
/// T_k+1 Exp(xi)   u moves by R(phi) rho,       phi by theta
/// ```
fn arc_residual(
    from: UnwrappedPose,
    to: UnwrappedPose,
    step: &CalibratedStep,
) -> (Vector3<f64>, SMatrix<f64, 3, MAX_ROW_ENTRIES>) {
    let (u, phi) = relative(from, to);
    let (sin, cos) = (0.5 * phi).sin_cos();
    let along = cos * u[0] + sin * u[1];
    let lateral = cos * u[1] - sin * u[0];
    // Seen along its chord, an arc of length one ends at the ratio of chord to arc.
    let unit = BodyStep { forward_m: 1.0, turn_rad: phi };
    let seen = displace(-0.5 * phi, unit, StepRule::Arc);
    let (chord, chord_by_turn) = (seen.dx_m, seen.by_turn[0]);
    let length = along / chord;
    let residual = Vector3::new(length - step.forward_m, phi - step.turn_rad, lateral);
    let length_by_phi = 0.5 * lateral / chord - length * chord_by_turn / chord;
    let [d, dth] = step.by_constant;
    let by_unknown = SMatrix::from_row_slice(&[
        // Distance.
        -cos / chord,
        -sin / chord,
        lateral / chord - length_by_phi,
        cos / chord,
        -sin / chord,
        length_by_phi,
        -d[0],
        -d[1],
        -d[2],
        // Turn.
        0.0,
        0.0,
        -1.0,
        0.0,
        0.0,
        1.0,
        -dth[0],
        -dth[1],
        -dth[2],
        // Lateral.
        sin,
        -cos,
        -0.5 * along,
        sin,
        cos,
        -0.5 * along,
        0.0,
        0.0,
        0.0,
    ]);
    (residual, by_unknown)
}

/// The same where nothing is known of the motion: (forward, turn, left) against none.
fn offset_residual(from: UnwrappedPose, to: UnwrappedPose) -> (Vector3<f64>, SMatrix<f64, 3, MAX_ROW_ENTRIES>) {
    let (u, phi) = relative(from, to);
    let (sin, cos) = phi.sin_cos();
    let mut by_unknown = SMatrix::zeros();
    for (row, values) in
        [[-1.0, 0.0, u[1], cos, -sin, 0.0], [0.0, 0.0, -1.0, 0.0, 0.0, 1.0], [0.0, -1.0, -u[0], sin, cos, 0.0]]
            .into_iter()
            .enumerate()
    {
        for (column, value) in values.into_iter().enumerate() {
            by_unknown[(row, column)] = value;
        }
    }
    (Vector3::new(u[0], phi, u[1]), by_unknown)
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 1e-6;

    fn check(
        residual: impl Fn(UnwrappedPose, UnwrappedPose) -> (Vector3<f64>, SMatrix<f64, 3, MAX_ROW_ENTRIES>),
        from: UnwrappedPose,
        to: UnwrappedPose,
    ) {
        let (_, by_unknown) = residual(from, to);
        for column in 0..6 {
            let at = |h: f64| {
                let mut xi = [0.0; 3];
                xi[column % 3] = h;
                if column < 3 { residual(from.retract(xi), to).0 } else { residual(from, to.retract(xi)).0 }
            };
            let difference = (at(H) - at(-H)) / (2.0 * H);
            for row in 0..3 {
                let by = by_unknown[(row, column)];
                assert!((by - difference[row]).abs() < 1e-8, "({row}, {column}): {by} against {}", difference[row]);
            }
        }
    }

    #[test]
    fn derivatives_of_the_motion_agree_with_central_differences() {
        let from = UnwrappedPose { x_m: 0.3, y_m: -0.7, heading_rad: 5.1 };
        for xi in [[0.2, 0.01, 0.4], [-0.1, 0.0, 0.0], [0.01, -0.02, -1.3]] {
            let step = CalibratedStep { forward_m: 0.19, turn_rad: 0.38, by_constant: [[0.0; 3]; 2] };
            let to = from.retract(xi);
            check(|from, to| arc_residual(from, to, &step), from, to);
            check(offset_residual, from, to);
        }
    }

    #[test]
    fn an_arc_that_the_wheels_told_leaves_no_residual() {
        let step = CalibratedStep { forward_m: 0.25, turn_rad: -0.45, by_constant: [[0.0; 3]; 2] };
        let from = UnwrappedPose::default();
        let to = from.retract([step.forward_m, 0.0, step.turn_rad]);
        assert!(arc_residual(from, to, &step).0.norm() < 1e-15);
    }

    #[test]
    fn derivatives_by_the_constants_agree_with_central_differences() {
        let travel = WheelTravel { left_m: 0.013, right_m: -0.004 };
        let config = crate::smoother::tests::config();
        let constants = [0.01, -0.02, 0.05, 0.0, 0.0, 0.0];
        let step = calibrated_step(travel, &config, &constants);
        for column in 0..3 {
            let at = |h: f64| {
                let mut moved = constants;
                moved[column] += h;
                let step = calibrated_step(travel, &config, &moved);
                [step.forward_m, step.turn_rad]
            };
            for row in 0..2 {
                let difference = (at(H)[row] - at(-H)[row]) / (2.0 * H);
                assert!((step.by_constant[row][column] - difference).abs() < 1e-8);
            }
        }
    }
}

//! The constraints of a smoothing problem as whitened rows: a residual over its sigma with its derivatives.
//!
//! ```text
//! r = G - (th_to - th_from) - b_g T        a gyro window
//! r = b_g - b_g of the window before       the bias walks from window to window
//! ```
//! Source: docs/maths/pose.md section B2.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{DriveGeometry, Heading, Meters, StartPose, UncertainValue};

use super::problem::{
    AssociatedFix, CONSTANTS, FIX_DELAY, GyroInterval, MotionSegment, ProblemValues, RADIUS_DIFFERENCE, RADIUS_SCALE,
    SmoothingProblem, TAG_FORWARD, TAG_LEFT, TRACK_SCALE, UnwrappedPose, VariableLayout, constants_of,
};
use crate::filter::FilterConfig;
use crate::models::differential_drive::{CalibratedStep, WheelTravel, calibrated_step, step_noise};
use crate::models::se2::{BodyStep, StepRule, displace};
use crate::motion::{UNOBSERVED_M_PER_SQRT_S, UNOBSERVED_RAD_PER_SQRT_S};
use crate::numerics::elimination::Variable;
use crate::observations::fix::{FixNoise, fix_noise, lever_in_arena};
use crate::observations::sensor_frame::Exposure;

/// Most unknowns in one row: two poses and three constants.
pub(super) const MAX_ROW_ENTRIES: usize = 9;
/// Least sigma of a start, a bias or a constant, in its own unit.
const MIN_SIGMA: f64 = 1e-7;
/// Sigma of an unknown start, m: anywhere on a large site. Fixes then decide.
pub(super) const UNKNOWN_POSITION_SIGMA_M: f64 = 1e4;
/// Sigma of an unknown heading, rad: so much more than a turn that it has no weight.
const UNKNOWN_HEADING_SIGMA_RAD: f64 = 1e2;

/// A residual over its sigma and its derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WhitenedRow {
    entries: [(Variable, f64); MAX_ROW_ENTRIES],
    count: usize,
    pub(super) residual: f64,
}

impl WhitenedRow {
    /// Without derivatives.
    pub(super) fn from_residual(residual: f64) -> Self {
        Self { residual, ..Self::default() }
    }

    pub(super) fn with_derivative(mut self, variable: Variable, derivative: f64) -> Self {
        if let Some(entry) = self.entries.get_mut(self.count) {
            *entry = (variable, derivative);
            self.count += 1;
        }
        self
    }

    pub(super) fn entries(&self) -> &[(Variable, f64)] {
        &self.entries[..self.count]
    }
}

/// The configured start, or an uninformative one.
pub(super) fn start_rows(config: &FilterConfig, layout: VariableLayout, first: UnwrappedPose) -> [WhitenedRow; 3] {
    let start = config.start.unwrap_or(StartPose {
        pose: first.to_pose(),
        position_sigma_m: UNKNOWN_POSITION_SIGMA_M,
        heading_sigma_rad: UNKNOWN_HEADING_SIGMA_RAD,
    });
    let position = 1.0 / start.position_sigma_m.max(MIN_SIGMA);
    let heading = 1.0 / start.heading_sigma_rad.max(MIN_SIGMA);
    let (sin, cos) = first.heading_rad.sin_cos();
    let start_pose = UnwrappedPose::from_pose(start.pose);
    let turn_rad = wrap_rad(first.heading_rad - start_pose.heading_rad);
    let (forward, left) = (layout.pose(0, 0), layout.pose(0, 1));
    [
        WhitenedRow::from_residual(position * (first.x_m - start_pose.x_m))
            .with_derivative(forward, position * cos)
            .with_derivative(left, -position * sin),
        WhitenedRow::from_residual(position * (first.y_m - start_pose.y_m))
            .with_derivative(forward, position * sin)
            .with_derivative(left, position * cos),
        WhitenedRow::from_residual(heading * turn_rad).with_derivative(layout.pose(0, 2), heading),
    ]
}

pub(super) fn constant_row(config: &FilterConfig, constant: usize, value: f64) -> WhitenedRow {
    let prior = constants_of(&config.calibration)[constant];
    let weight = 1.0 / prior.sigma.max(f64::MIN_POSITIVE);
    WhitenedRow::from_residual(weight * (value - prior.value)).with_derivative(constant, weight)
}

/// The prior of the gyro bias, rad/s.
pub(super) fn bias_prior(config: &FilterConfig) -> UncertainValue {
    let prior = config.gyro_bias_prior();
    UncertainValue { sigma: prior.sigma.max(MIN_SIGMA), ..prior }
}

/// The prior of the bias over a window, or its random walk since the window before.
pub(super) fn bias_row(problem: &SmoothingProblem<'_>, values: &ProblemValues, window: usize) -> WhitenedRow {
    let bias = values.biases[window];
    let Some(before) = window.checked_sub(1) else {
        let prior = bias_prior(problem.config);
        return WhitenedRow::from_residual((bias - prior.value) / prior.sigma)
            .with_derivative(VariableLayout::bias(window), 1.0 / prior.sigma);
    };
    let walk = problem.config.noise.gyro_bias_walk_rad_per_s_sqrt_s;
    let sigma = walk * problem.windows[window].since_last_s.max(0.0).sqrt();
    let weight = 1.0 / sigma.max(MIN_SIGMA);
    WhitenedRow::from_residual(weight * (bias - values.biases[before]))
        .with_derivative(VariableLayout::bias(window), weight)
        .with_derivative(VariableLayout::bias(before), -weight)
}

/// The gyro's turn over a window minus that of the poses.
pub(super) fn window_row(
    layout: VariableLayout,
    window: &GyroInterval,
    index: usize,
    values: &ProblemValues,
) -> WhitenedRow {
    let weight = 1.0 / window.variance.sqrt();
    let turn_rad = values.poses[window.to].heading_rad - values.poses[window.from].heading_rad;
    let residual = window.turn_rad - turn_rad - values.biases[index] * window.length_s;
    let row = WhitenedRow::from_residual(weight * residual)
        .with_derivative(VariableLayout::bias(index), -weight * window.length_s);
    if window.from == window.to {
        return row;
    }
    row.with_derivative(layout.pose(window.from, 2), weight).with_derivative(layout.pose(window.to, 2), -weight)
}

// The motion from one pose to the next, as whitened rows.
//
//     D = T_k^-1 T_k+1 = (u, phi)          e = (cos phi/2, sin phi/2)    n = (-sin phi/2, cos phi/2)    c = sin(phi/2)/(phi/2)
//     r = [ e'u / c - d ]                  the arc through both poses is as long as the wheels measured
//         [ phi - dth   ]                  and turns as far
//         [ n'u         ]                  and leaves no lateral error
//     d = (s_L + s_R)/2    dth = (s_R - s_L)/b    s_L = s_L0 (1 + e_m - e_d/2)   s_R = s_R0 (1 + e_m + e_d/2)   b = b0 (1 + e_b)
// Source: models::differential_drive for the noise; docs/maths/pose.md section B2.

/// Lateral error of an arc, and the least of its other errors, m per sqrt(m) of the wheels' path: a thousandth of a
/// good wheel's slip. It represents "none": without it the motion of three coordinates would have noise in two only.
const LATERAL_M_PER_SQRT_M: f64 = 1e-6;
/// The same for a path near zero, m²: ten nanometres.
const MIN_VARIANCE_M2: f64 = 1e-16;

/// The body step of wheel travel with these calibration constants.
pub(super) fn calibrated_motion(
    travel: WheelTravel,
    config: &FilterConfig,
    constants: &[f64; CONSTANTS],
) -> CalibratedStep {
    let scales = [RADIUS_SCALE, RADIUS_DIFFERENCE, TRACK_SCALE].map(|constant| constants[constant]);
    calibrated_step(travel, &config.geometry, scales)
}

/// The geometry with the track width of these constants.
pub(super) fn true_geometry(config: &FilterConfig, constants: &[f64; CONSTANTS]) -> DriveGeometry {
    let track_m = config.geometry.track_width.0 * (1.0 + constants[TRACK_SCALE]);
    DriveGeometry { track_width: Meters(track_m), ..config.geometry }
}

/// Scales a motion's residual (distance, turn, lateral) to unit variance.
pub(super) type Whitener = Matrix3<f64>;

/// The whitener of a move, with the noise of the travel by this calibration; `None` when the noise is not finite.
pub(super) fn whitener(by: &MotionSegment, config: &FilterConfig, constants: &[f64; CONSTANTS]) -> Option<Whitener> {
    let covariance = match *by {
        MotionSegment::Unobserved(secs) => {
            let position_m2 = UNOBSERVED_M_PER_SQRT_S.powi(2) * secs;
            let heading_rad2 = UNOBSERVED_RAD_PER_SQRT_S.powi(2) * secs;
            Matrix3::from_diagonal(&Vector3::new(position_m2, heading_rad2, position_m2))
        }
        MotionSegment::Driven { travel, path_var_m2 } => {
            let CalibratedStep { travel, .. } = calibrated_motion(travel, config, constants);
            let geometry = true_geometry(config, constants);
            let noise = step_noise(travel, &geometry, &config.noise);
            let path_m = 0.5 * (travel.left_m.abs() + travel.right_m.abs());
            let floor_m2 = LATERAL_M_PER_SQRT_M.powi(2) * path_m + MIN_VARIANCE_M2;
            let half_track_m = 0.5 * geometry.track_width.0;
            let cross = noise.forward_turn_m_rad;
            let distance_m2 = noise.forward_var_m2 + floor_m2 + path_var_m2;
            let turn_rad2 = noise.turn_var_rad2 + floor_m2 / half_track_m.powi(2);
            let lateral_m2 = floor_m2 + path_var_m2;
            Matrix3::new(distance_m2, cross, 0.0, cross, turn_rad2, 0.0, 0.0, 0.0, lateral_m2)
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
            let step = calibrated_motion(travel, problem.config, &values.constants);
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

/// The second pose in the frame of the first: u = (forward, left) and phi.
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
    let unit_arc = displace(-0.5 * phi, unit, StepRule::Arc);
    let (chord, chord_by_turn) = (unit_arc.dx_m, unit_arc.by_turn[0]);
    let length = along / chord;
    let residual = Vector3::new(length - step.step.forward_m, phi - step.step.turn_rad, lateral);
    let length_by_phi = 0.5 * lateral / chord - length * chord_by_turn / chord;
    let (d, dth) = (step.forward_by_scales, step.turn_by_scales);
    let (c, s) = (cos / chord, sin / chord);
    let by_unknown = [
        [-c, -s, lateral / chord - length_by_phi, c, -s, length_by_phi, -d[0], -d[1], -d[2]],
        [0.0, 0.0, -1.0, 0.0, 0.0, 1.0, -dth[0], -dth[1], -dth[2]],
        [sin, -cos, -0.5 * along, sin, cos, -0.5 * along, 0.0, 0.0, 0.0],
    ];
    (residual, SMatrix::from_fn(|row, column| by_unknown[row][column]))
}

/// The same where the motion is unknown: (forward, turn, left) minus zero.
fn offset_residual(from: UnwrappedPose, to: UnwrappedPose) -> (Vector3<f64>, SMatrix<f64, 3, MAX_ROW_ENTRIES>) {
    let (u, phi) = relative(from, to);
    let (sin, cos) = phi.sin_cos();
    let by_pose =
        [[-1.0, 0.0, u[1], cos, -sin, 0.0], [0.0, 0.0, -1.0, 0.0, 0.0, 1.0], [0.0, -1.0, -u[0], sin, cos, 0.0]];
    let by_unknown = SMatrix::from_fn(|row, column| by_pose[row].get(column).copied().unwrap_or(0.0));
    (Vector3::new(u[0], phi, u[1]), by_unknown)
}

// A fix's observation of the pose in its image, as whitened rows.
//
//     T' = T Exp(-(tau - tau_0) [v, 0, w]')          the pose at which the fix was true, if its delay is tau and not tau_0
//     h  = p' + R' (l + [tag_forward, tag_left]')    and th'
//     nu = z - h                                      angles wrapped
//     R  = [R_f + (v sigma_t)^2 I, sigma_th^2 + (w sigma_t)^2]
// Source: docs/maths/pose.md section B2; R as in docs/maths/pose.md section 4.

/// Least variance of a fix, a micrometre or a microradian squared: without noise its weight would be unbounded.
const MIN_VARIANCE: f64 = 1e-12;

/// Rows for x, y and the heading of a fix, and how many there are; `None` without a positive definite covariance.
pub(super) fn fix_rows(
    problem: &SmoothingProblem<'_>,
    associated: &AssociatedFix,
    values: &ProblemValues,
) -> Option<([WhitenedRow; 3], u8)> {
    let noise = noise_of_fix(problem, associated);
    let white = noise.position.cholesky()?.l().try_inverse()?;
    let at = true_pose(values.poses[associated.node], associated, values);
    let (sin, cos) = at.heading_rad.sin_cos();
    let lever = lever(associated, values, at.heading_rad);
    let measured = Vector2::new(associated.fix.position.x.0, associated.fix.position.y.0);
    let innovation = white * (measured - Vector2::new(at.x_m, at.y_m) - lever);
    // Minus the derivatives of h: of the pose's xi, of the delay, of the lever.
    let (v, w) = (associated.forward_m_per_s, associated.turn_rad_per_s);
    let ahead = -white * Vector2::new(cos, sin);
    let aside = -white * Vector2::new(-sin, cos);
    let turned = -white * Vector2::new(-lever.y, lever.x);
    let delayed = -(ahead * v + turned * w);
    let layout = problem.layout();
    let mut rows = [0, 1, 2].map(|axis| {
        if axis == 2 {
            return WhitenedRow::default();
        }
        let row = WhitenedRow::from_residual(innovation[axis])
            .with_derivative(layout.pose(associated.node, 0), ahead[axis])
            .with_derivative(layout.pose(associated.node, 1), aside[axis])
            .with_derivative(layout.pose(associated.node, 2), turned[axis]);
        let row = with_constant(problem, row, FIX_DELAY, delayed[axis]);
        let row = with_constant(problem, row, TAG_FORWARD, ahead[axis]);
        with_constant(problem, row, TAG_LEFT, aside[axis])
    });
    let Some(heading) = associated.fix.heading else {
        return Some((rows, 2));
    };
    let weight = 1.0 / noise.heading_rad2.max(MIN_VARIANCE).sqrt();
    let row = WhitenedRow::from_residual(weight * wrap_rad(heading.rad() - at.heading_rad))
        .with_derivative(layout.pose(associated.node, 2), -weight);
    rows[2] = with_constant(problem, row, FIX_DELAY, weight * w);
    Some((rows, 3))
}

fn with_constant(problem: &SmoothingProblem<'_>, row: WhitenedRow, constant: usize, derivative: f64) -> WhitenedRow {
    if problem.is_free[constant] { row.with_derivative(constant, derivative) } else { row }
}

fn noise_of_fix(problem: &SmoothingProblem<'_>, associated: &AssociatedFix) -> FixNoise {
    let AssociatedFix { stamp_sigma_s, forward_m_per_s, turn_rad_per_s, .. } = *associated;
    let exposure = Exposure::at_speeds(forward_m_per_s, turn_rad_per_s);
    let mut noise = fix_noise(&associated.fix, &problem.config.noise, [1.0, 1.0], &exposure, stamp_sigma_s);
    noise.position += Matrix2::from_diagonal_element(MIN_VARIANCE);
    noise
}

/// The robot's pose at the exposure of a fix.
fn true_pose(node: UnwrappedPose, associated: &AssociatedFix, values: &ProblemValues) -> UnwrappedPose {
    let earlier_s = values.constants[FIX_DELAY] - associated.delay_s;
    node.retract([-earlier_s * associated.forward_m_per_s, 0.0, -earlier_s * associated.turn_rad_per_s])
}

fn lever(associated: &AssociatedFix, values: &ProblemValues, heading_rad: f64) -> Vector2<f64> {
    let tag = associated.fix.tag_in_body;
    lever_in_arena([tag.x.0 + values.constants[TAG_FORWARD], tag.y.0 + values.constants[TAG_LEFT]], heading_rad)
}

/// The pose by a fix alone, with this heading where it has none.
pub(super) fn pose_from_fix(associated: &AssociatedFix, values: &ProblemValues, heading_rad: f64) -> UnwrappedPose {
    let at = UnwrappedPose {
        x_m: associated.fix.position.x.0,
        y_m: associated.fix.position.y.0,
        heading_rad: associated.fix.heading.map_or(heading_rad, Heading::rad),
    };
    let lever = lever(associated, values, at.heading_rad);
    UnwrappedPose { x_m: at.x_m - lever.x, y_m: at.y_m - lever.y, ..at }
}

#[cfg(test)]
mod tests {
    use super::*;

    const H: f64 = 1e-6;

    fn without_scales(forward_m: f64, turn_rad: f64) -> CalibratedStep {
        CalibratedStep { step: BodyStep { forward_m, turn_rad }, ..CalibratedStep::default() }
    }

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
            let step = without_scales(0.19, 0.38);
            let to = from.retract(xi);
            check(|from, to| arc_residual(from, to, &step), from, to);
            check(offset_residual, from, to);
        }
    }

    #[test]
    fn an_arc_that_the_wheels_measured_leaves_no_residual() {
        let step = without_scales(0.25, -0.45);
        let from = UnwrappedPose::default();
        let to = from.retract([0.25, 0.0, -0.45]);
        assert!(arc_residual(from, to, &step).0.norm() < 1e-15);
    }
}

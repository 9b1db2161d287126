//! What the covariances at the optimum say about fixes, poses and constants.
//!
//! # Model
//! ```text
//! nu = z - h at the optimum, whitened          P the covariance there
//! S  = I + H P H'    for a fix that was not used
//! S  = I - H P H'    for one that was, because the optimum has moved towards it
//! ```
//! In both cases nu' S^-1 nu is the NIS of the fix against all other observations.
//!
//! # Source
//! docs/maths/batch.md section 3.

use nalgebra::{Matrix3, SMatrix, Vector3};
use posebridge_telemetry::{Calibration, Known};

use super::batch::SmoothedPose;
use super::descent::Descended;
use super::factors::{Row, bias_prior};
use super::fixes::fix_rows;
use super::front::Joint;
use super::problem::Problem;
use super::values::{
    CONSTANTS, FIX_DELAY, Meaning, RADIUS_DIFFERENCE, RADIUS_SCALE, TAG_FORWARD, TAG_LEFT,
    TRACK_SCALE, Values,
};
use crate::update::consistency;

/// What the covariances at the optimum say about fixes, poses and constants.
pub(super) struct Judged {
    /// Which fixes of the run agree with all the others.
    pub(super) fits: Vec<bool>,
    /// In the body's space of each pose.
    covariances: Vec<Matrix3<f64>>,
    constants: [f64; CONSTANTS],
    last_bias: f64,
}

impl Judged {
    /// Judges an optimum.
    pub(super) fn of(
        problem: &Problem<'_>,
        descended: &Descended,
        is_used: &[bool],
        gates: [f64; 3],
    ) -> Self {
        let layout = problem.layout();
        let mut judged = Self {
            fits: vec![false; is_used.len()],
            covariances: vec![Matrix3::zeros(); problem.poses],
            constants: [0.0; CONSTANTS],
            last_bias: 0.0,
        };
        descended
            .linearised
            .chain
            .visit_covariances(|variable, joint| match layout.meaning(variable) {
                Meaning::Constant(constant) => {
                    judged.constants[constant] = joint.between(variable, variable);
                }
                Meaning::Bias(window) if window + 1 == problem.windows.len() => {
                    judged.last_bias = joint.between(variable, variable);
                }
                // A pose's first row is eliminated first and so comes last: the others are there.
                Meaning::Pose(node, 0) => {
                    judged.covariances[node] = Matrix3::from_fn(|row, column| {
                        joint.between(layout.pose(node, row), layout.pose(node, column))
                    });
                    for seen in problem.fixes_at(node) {
                        if let Some((rows, degrees)) = fix_rows(problem, seen, &descended.values) {
                            let sign = if is_used[seen.index] { -1.0 } else { 1.0 };
                            let nis = nis_by_the_others(&rows, joint, sign);
                            judged.fits[seen.index] = nis <= gates[usize::from(degrees) - 1];
                        }
                    }
                }
                Meaning::Bias(_) | Meaning::Pose(..) => {}
            });
        judged
    }

    /// The pose at each motion reading.
    pub(super) fn poses(&self, problem: &Problem<'_>, values: &Values) -> Vec<SmoothedPose> {
        problem
            .readings
            .iter()
            .map(|&(stamp, node)| {
                let (sin, cos) = values.poses[node].heading_rad.sin_cos();
                let arena_from_body =
                    SMatrix::<f64, 3, 3>::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
                let own = self.covariances[node];
                let covariance = arena_from_body * own * arena_from_body.transpose();
                SmoothedPose {
                    stamp,
                    pose: values.poses[node].pose(),
                    // Mirrored, so that rounding leaves it symmetric.
                    covariance: std::array::from_fn(|row| {
                        std::array::from_fn(|column| covariance[(row.max(column), row.min(column))])
                    }),
                }
            })
            .collect()
    }

    /// The constants, and the bias of the last window.
    pub(super) fn calibration(&self, problem: &Problem<'_>, values: &Values) -> Calibration {
        let known = |constant: usize| Known {
            value: values.constants[constant],
            sigma: self.constants[constant].max(0.0).sqrt(),
        };
        let (mean, sigma) = bias_prior(problem.config);
        let bias = values
            .biases
            .last()
            .map_or(Known { value: mean, sigma }, |&value| Known {
                value,
                sigma: self.last_bias.max(0.0).sqrt(),
            });
        Calibration {
            radius_scale: known(RADIUS_SCALE),
            radius_difference: known(RADIUS_DIFFERENCE),
            track_scale: known(TRACK_SCALE),
            gyro_bias_rad_per_s: bias,
            fix_delay_s: known(FIX_DELAY),
            tag_forward_m: known(TAG_FORWARD),
            tag_left_m: known(TAG_LEFT),
            ..problem.config.calibration
        }
    }
}

/// NIS of a fix against what all the other observations say, from its whitened rows at the optimum; `sign` is that of H P H'.
fn nis_by_the_others(rows: &[Row; 3], joint: &Joint, sign: f64) -> f64 {
    let s = Matrix3::from_fn(|i, j| {
        let own = rows[i].entries().iter();
        let shared: f64 = own
            .map(|(a, by_a)| {
                let other = rows[j].entries().iter();
                by_a * other
                    .map(|(b, by_b)| by_b * joint.between(*a, *b))
                    .sum::<f64>()
            })
            .sum();
        sign * shared + f64::from(u8::from(i == j))
    });
    let residual = Vector3::from(rows.map(|row| row.residual));
    // Where a fix alone determines the pose there are no others to judge it by.
    consistency(&residual, &s).map_or(0.0, |(nis, _)| nis)
}

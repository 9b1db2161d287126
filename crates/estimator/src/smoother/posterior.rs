//! Leave-one-out tests of the fixes, and covariances of poses and constants, at the optimum.
//!
//! ```text
//! nu = z - h at the optimum, whitened          P the covariance there
//! S  = I + H P H'    for a fix that was not used
//! S  = I - H P H'    for one that was, because the optimum has moved towards it
//! ```
//! Source: docs/maths/pose.md section B3.

use nalgebra::{Matrix3, SMatrix, Vector3};
use posebridge_telemetry::{Calibration, UncertainValue};

use super::factors::{WhitenedRow, bias_prior, fix_rows};
use super::forward_pass::Optimum;
use super::problem::{
    CONSTANTS, FIX_DELAY, ProblemValues, RADIUS_DIFFERENCE, RADIUS_SCALE, ReadingPose, SmoothingProblem, TAG_FORWARD,
    TAG_LEFT, TRACK_SCALE, VariableKind,
};
use super::trajectory::SmoothedPose;
use crate::numerics::elimination::JointCovariance;
use crate::update::nis_and_log_likelihood;

/// Leave-one-out NIS of each fix, and covariances of poses and constants, at the optimum.
pub(super) struct GatedObservation {
    /// Whether each fix of the run agrees with all the others.
    pub(super) passes_gate: Vec<bool>,
    /// NIS of each fix of the run against all the others; infinite for those outside the poses.
    nis: Vec<f64>,
    /// In the body's frame of each pose.
    covariances: Vec<Matrix3<f64>>,
    constants: [f64; CONSTANTS],
    last_bias: f64,
}

impl GatedObservation {
    pub(super) fn evaluate(
        problem: &SmoothingProblem<'_>,
        descended: &Optimum,
        is_used: &[bool],
        gates: [f64; 3],
    ) -> Self {
        let layout = problem.layout();
        let mut gated = Self {
            passes_gate: vec![false; is_used.len()],
            nis: vec![f64::INFINITY; is_used.len()],
            covariances: vec![Matrix3::zeros(); problem.poses],
            constants: [0.0; CONSTANTS],
            last_bias: 0.0,
        };
        descended.linearised.chain.visit_covariances(|variable, joint| match layout.kind_of(variable) {
            VariableKind::Constant(constant) => {
                gated.constants[constant] = joint.between(variable, variable);
            }
            VariableKind::Bias(window) if window + 1 == problem.windows.len() => {
                gated.last_bias = joint.between(variable, variable);
            }
            // A pose's first row is eliminated first and so comes last: the others are there.
            VariableKind::Pose(node, 0) => {
                gated.covariances[node] =
                    Matrix3::from_fn(|row, column| joint.between(layout.pose(node, row), layout.pose(node, column)));
                for fix in problem.fixes_at(node) {
                    if let Some((rows, degrees)) = fix_rows(problem, fix, &descended.values) {
                        let sign = if is_used[fix.index] { -1.0 } else { 1.0 };
                        let nis = leave_one_out_nis(&rows, joint, sign);
                        gated.nis[fix.index] = nis;
                        gated.passes_gate[fix.index] = nis <= gates[usize::from(degrees) - 1];
                    }
                }
            }
            VariableKind::Bias(_) | VariableKind::Pose(..) => {}
        });
        gated
    }

    pub(super) fn poses(&self, problem: &SmoothingProblem<'_>, values: &ProblemValues) -> Vec<SmoothedPose> {
        problem
            .readings
            .iter()
            .map(|&ReadingPose { stamp, pose: node }| {
                let (sin, cos) = values.poses[node].heading_rad.sin_cos();
                let arena_from_body = SMatrix::<f64, 3, 3>::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
                let own = self.covariances[node];
                let covariance = arena_from_body * own * arena_from_body.transpose();
                SmoothedPose {
                    stamp,
                    pose: values.poses[node].to_pose(),
                    // Mirrored, so that rounding leaves it symmetric.
                    covariance: std::array::from_fn(|row| {
                        std::array::from_fn(|column| covariance[(row.max(column), row.min(column))])
                    }),
                }
            })
            .collect()
    }

    /// The constants, and the bias of the last window.
    pub(super) fn calibration(&self, problem: &SmoothingProblem<'_>, values: &ProblemValues) -> Calibration {
        let known = |constant: usize| UncertainValue {
            value: values.constants[constant],
            sigma: self.constants[constant].max(0.0).sqrt(),
        };
        let sigma = self.last_bias.max(0.0).sqrt();
        let last_bias = values.biases.last().map(|&value| UncertainValue { value, sigma });
        Calibration {
            radius_scale: known(RADIUS_SCALE),
            radius_difference: known(RADIUS_DIFFERENCE),
            track_scale: known(TRACK_SCALE),
            gyro_bias_rad_per_s: last_bias.unwrap_or_else(|| bias_prior(problem.config)),
            fix_delay_s: known(FIX_DELAY),
            tag_forward_m: known(TAG_FORWARD),
            tag_left_m: known(TAG_LEFT),
            ..problem.config.calibration
        }
    }
}

/// NIS of a fix against all other observations, from its whitened rows at the optimum; `sign` is that of H P H'.
fn leave_one_out_nis(rows: &[WhitenedRow; 3], joint: &JointCovariance, sign: f64) -> f64 {
    let s = Matrix3::from_fn(|i, j| {
        let own = rows[i].entries().iter();
        let shared: f64 = own
            .map(|(a, by_a)| {
                let other = rows[j].entries().iter();
                by_a * other.map(|(b, by_b)| by_b * joint.between(*a, *b)).sum::<f64>()
            })
            .sum();
        sign * shared + f64::from(u8::from(i == j))
    });
    let residual = Vector3::from(rows.map(|row| row.residual));
    // Where a fix alone determines the pose there are no others to test it against.
    nis_and_log_likelihood(&residual, &s).map_or(0.0, |(nis, _)| nis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::smoother::batch::{OuterIteration, whiteners};
    use crate::smoother::problem::RunData;
    use posebridge_telemetry::{
        Fix, Heading, Meters, Observation, ObservationKind, Point2, Radians, SensorId, TimeDelta, Timestamp,
    };

    /// A robot that goes straight ahead, with four fixes that scatter.
    fn observations() -> Vec<Observation> {
        let one = |at_ms: i64, sensor, observed| Observation {
            sensor,
            stamp: Timestamp::from_millis(at_ms),
            stamp_sigma: TimeDelta::ZERO,
            measurement: observed,
        };
        let mut all: Vec<Observation> = (0..=20)
            .map(|k| {
                let turned = Radians(0.5 * f64::from(k));
                let wheels = ObservationKind::WheelAngles { left: turned, right: turned };
                one(50 * i64::from(k), SensorId::WHEELS, wheels)
            })
            .collect();
        for (k, y_m) in [(5, 0.004), (10, -0.006), (15, 0.003), (20, 0.002)] {
            let fix = ObservationKind::Fix(Fix {
                position: Point2::new(Meters(0.014 * k as f64), Meters(y_m)),
                heading: Some(Heading::from_rad(0.01)),
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            });
            all.push(one(50 * k, SensorId::CAMERA, fix));
        }
        all
    }

    /// NIS of a fix when these are left out.
    fn nis_of(index: usize, left_out: &[usize]) -> f64 {
        let config = crate::filter::tests::config();
        let all = observations();
        let run = RunData::new(&config, &all);
        let problem = run.problem(0.0);
        let mut round = OuterIteration::initial(&config, run.fixes());
        for &other in left_out {
            round.is_used[other] = false;
        }
        let whiteners = whiteners(&problem, &round.constants).unwrap();
        let descended = round.minimize(&problem, &whiteners, [f64::INFINITY; 3]).unwrap();
        GatedObservation::evaluate(&problem, &descended, &round.is_used, [10.0; 3]).nis[index]
    }

    #[test]
    fn a_fix_has_the_same_leave_one_out_nis_whether_it_was_used_or_not() {
        for index in 0..4 {
            let (used, left_out) = (nis_of(index, &[]), nis_of(index, &[index]));
            assert!((used / left_out - 1.0).abs() < 1e-3 && used > 0.1, "fix {index}: {used} against {left_out}");
        }
    }
}

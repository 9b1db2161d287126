//! Operations on the rows of pose and speeds of any of these filters, and their updates by several scalars and by fixes.

use nalgebra::{SMatrix, SVector, Vector2, Vector3};
use posebridge_telemetry::estimate::row::{FORWARD, HEADING, TURN, X, Y};
use posebridge_telemetry::{Fix, FusionOutcome, FusionRecord, StartPose};

use super::sigma_points::PredictedObservation;
use crate::motion::{UNOBSERVED_M_PER_SQRT_S, UNOBSERVED_RAD_PER_SQRT_S};
use crate::numerics::cholesky::{lower_triangle, solve_lower};
use crate::numerics::covariance::symmetrise;
use crate::observations::fix::{lever_in_arena, with_heading_variance};
use crate::update::{LinearizedMeasurement, ScalarMeasurement, UpdateOutcome, apply_measurement, use_scalar};
use crate::validation::write_innovation;

/// Moves the pose to a start, independent of all other rows.
pub(super) fn initialize_pose<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    start: &StartPose,
) {
    let pose = start.pose;
    for (row, value, sigma) in [
        (X, pose.x.0, start.position_sigma_m),
        (Y, pose.y.0, start.position_sigma_m),
        (HEADING, pose.heading.rad(), start.heading_sigma_rad),
    ] {
        mean[row] = value;
        set_independent_variance(covariance, row, sigma * sigma);
    }
}

/// Adds standard deviations, in m and rad, to the pose.
pub(super) fn inflate_pose<const N: usize>(covariance: &mut SMatrix<f64, N, N>, position_m: f64, heading_rad: f64) {
    covariance[(X, X)] += position_m * position_m;
    covariance[(Y, Y)] += position_m * position_m;
    covariance[(HEADING, HEADING)] += heading_rad * heading_rad;
}

/// Adds the random walk of unobserved motion over `dt_s` to the pose.
pub(super) fn add_unobserved_motion<const N: usize>(covariance: &mut SMatrix<f64, N, N>, dt_s: f64) {
    let root_s = dt_s.sqrt();
    inflate_pose(covariance, UNOBSERVED_M_PER_SQRT_S * root_s, UNOBSERVED_RAD_PER_SQRT_S * root_s);
}

/// Inflates the pose by sigmas in m and rad, and makes the speeds zero with these variances.
pub(super) fn reset_speeds<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    position_m: f64,
    heading_rad: f64,
    speed_variances: [f64; 2],
) {
    inflate_pose(covariance, position_m, heading_rad);
    for (row, variance) in [FORWARD, TURN].into_iter().zip(speed_variances) {
        mean[row] = 0.0;
        set_independent_variance(covariance, row, variance);
    }
}

/// Sets the speeds, and adds the variance of an unknown path to the position.
pub(super) fn bridge_gap<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    speeds: [f64; 2],
    path_m2: f64,
) {
    mean[FORWARD] = speeds[0];
    mean[TURN] = speeds[1];
    covariance[(X, X)] += path_m2;
    covariance[(Y, Y)] += path_m2;
}

pub(super) fn set_independent_variance<const N: usize>(covariance: &mut SMatrix<f64, N, N>, row: usize, variance: f64) {
    covariance.row_mut(row).fill(0.0);
    covariance.column_mut(row).fill(0.0);
    covariance[(row, row)] = variance;
}

/// The row of an integral that starts at another row's estimate: its opposite, plus an independent error.
pub(super) fn set_opposite<const N: usize>(covariance: &mut SMatrix<f64, N, N>, row: usize, of: usize, variance: f64) {
    set_independent_variance(covariance, row, 0.0);
    for other in (0..N).filter(|other| *other != row) {
        let opposite = -covariance[(of, other)];
        covariance[(row, other)] = opposite;
        covariance[(other, row)] = opposite;
    }
    covariance[(row, row)] = covariance[(of, of)] + variance;
}

// Innovations of several scalars at once: used one after the other, recorded together.

/// Uses scalars with independent noises, all predicted from the present state, without a gate; `Malformed`, and no
/// change, when their covariance is not positive definite.
pub(super) fn apply_all<const N: usize, const K: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    scalars: &[ScalarMeasurement<K>; M],
    record: &mut FusionRecord,
) -> FusionOutcome {
    let innovation = SVector::from_fn(|i, _| scalars[i].innovation);
    let s = SMatrix::<f64, M, M>::from_fn(|i, j| {
        let noise = if i == j { scalars[i].variance } else { 0.0 };
        noise + cross_variance(&scalars[i], &scalars[j], covariance)
    });
    if !write_innovation(record, &innovation, &s) {
        return FusionOutcome::Malformed;
    }
    let (before, covariance_before) = (*mean, *covariance);
    for scalar in scalars {
        // What the scalars before it have moved is already explained.
        let explained: f64 =
            scalar.rows.iter().zip(&scalar.jacobian).map(|(&row, by)| by * (mean[row] - before[row])).sum();
        let rest = ScalarMeasurement { innovation: scalar.innovation - explained, ..*scalar };
        if use_scalar(mean, covariance, &rest, f64::INFINITY).outcome != UpdateOutcome::Used {
            (*mean, *covariance) = (before, covariance_before);
            return FusionOutcome::Malformed;
        }
    }
    FusionOutcome::Accepted
}

/// h P h' of two scalars.
fn cross_variance<const N: usize, const K: usize>(
    a: &ScalarMeasurement<K>,
    b: &ScalarMeasurement<K>,
    covariance: &SMatrix<f64, N, N>,
) -> f64 {
    let mut sum = 0.0;
    for (&row, &by) in a.rows.iter().zip(&a.jacobian) {
        for (&column, &by_column) in b.rows.iter().zip(&b.jacobian) {
            sum += by * by_column * covariance[(row, column)];
        }
    }
    sum
}

// Innovation and H of a fix for the states of the papers, which hold x, y and heading themselves, in the arena.

/// Uses a measurement unless its NIS exceeds the gate for its number of components; the outcome is in the record.
pub(super) fn gate_and_apply<const N: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    measurement: &LinearizedMeasurement<N, M>,
    gates: &[f64; 3],
    record: &mut FusionRecord,
) -> FusionOutcome {
    let s = measurement.innovation_covariance(covariance);
    if !write_innovation(record, &measurement.innovation, &s) {
        FusionOutcome::Malformed
    } else if record.nis > gates[M - 1] {
        FusionOutcome::Gated
    } else if apply_measurement(mean, covariance, measurement) {
        FusionOutcome::Accepted
    } else {
        FusionOutcome::Malformed
    }
}

/// The same for an observation that sigma points predict: K = C S^-1, P <- P - K S K'.
pub(super) fn gate_and_apply_predicted<const N: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    predicted: &PredictedObservation<N, M>,
    innovation: &SVector<f64, M>,
    noise: &SMatrix<f64, M, M>,
    gates: &[f64; 3],
    record: &mut FusionRecord,
) -> FusionOutcome {
    let s = predicted.spread + noise;
    if !write_innovation(record, innovation, &s) {
        return FusionOutcome::Malformed;
    }
    if record.nis > gates[M - 1] {
        return FusionOutcome::Gated;
    }
    let Some(lower) = lower_triangle(&s) else {
        return FusionOutcome::Malformed;
    };
    // K S K' = (L^-1 C')' (L^-1 C').
    let white = solve_lower(&lower, innovation);
    for row in 0..N {
        let of_row = solve_lower(&lower, &predicted.cross.row(row).transpose());
        mean[row] += of_row.dot(&white);
        for column in 0..N {
            let of_column = solve_lower(&lower, &predicted.cross.row(column).transpose());
            covariance[(row, column)] -= of_row.dot(&of_column);
        }
    }
    symmetrise(covariance);
    FusionOutcome::Accepted
}

/// Uses a fix: its position and, with a heading, the innovation of that in rad and its independent variance in rad².
pub(super) fn gate_and_apply_fix<const N: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    position: &LinearizedMeasurement<N, 2>,
    heading: Option<(f64, f64)>,
    gates: &[f64; 3],
    record: &mut FusionRecord,
) -> FusionOutcome {
    let Some((turn_rad, heading_rad2)) = heading else {
        return gate_and_apply(mean, covariance, position, gates, record);
    };
    let mut jacobian = SMatrix::<f64, 3, N>::zeros();
    jacobian.fixed_rows_mut::<2>(0).copy_from(&position.jacobian);
    jacobian[(2, HEADING)] = 1.0;
    let measurement = LinearizedMeasurement {
        innovation: Vector3::new(position.innovation[0], position.innovation[1], turn_rad),
        jacobian,
        noise: with_heading_variance(&position.noise, heading_rad2),
    };
    gate_and_apply(mean, covariance, &measurement, gates, record)
}

/// Innovation and H of a fix's position for a state that holds x, y and heading themselves, in the arena.
///
/// ```text
/// nu = z - (x, y) - R(th) l          H = [ 1 0 -(R l)_y ]
///                                        [ 0 1  (R l)_x ]          l the tag in the body
/// ```
/// The estimate is x in m, y in m and the heading in rad.
pub(super) fn position_in_arena<const N: usize>(
    [x_m, y_m, heading_rad]: [f64; 3],
    fix: &Fix,
) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
    let lever = lever_in_arena([fix.tag_in_body.x.0, fix.tag_in_body.y.0], heading_rad);
    let mut jacobian = SMatrix::<f64, 2, N>::zeros();
    jacobian[(0, X)] = 1.0;
    jacobian[(1, Y)] = 1.0;
    jacobian[(0, HEADING)] = -lever[1];
    jacobian[(1, HEADING)] = lever[0];
    let measured = Vector2::new(fix.position.x.0, fix.position.y.0);
    (measured - Vector2::new(x_m, y_m) - lever, jacobian)
}

//! Innovations of several scalars at once: used one after the other, recorded together.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{FusionOutcome, FusionRecord};

use crate::fusion_records::write_innovation;
use crate::update::{ScalarMeasurement, UpdateOutcome, use_scalar};

/// Uses scalars whose noises are independent of each other, all predicted from the state as it is, without a gate.
///
/// [`Verdict::Malformed`], and nothing changes, when their covariance is none.
pub(in crate::papers) fn apply_all<const N: usize, const K: usize, const M: usize>(
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

//! Innovations of several scalars at once: used one after the other, recorded together.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{FusionRecord, Verdict};

use crate::filters::records::write_innovation;
use crate::update::{Scalar, Usage, use_scalar};

/// Uses scalars whose noises are independent of each other, all predicted from the state as it is, without a gate.
///
/// [`Verdict::Malformed`], and nothing changes, when their covariance is none.
pub(in crate::filters) fn use_all<const N: usize, const K: usize, const M: usize>(
    mean: &mut SVector<f64, N>,
    covariance: &mut SMatrix<f64, N, N>,
    scalars: &[Scalar<K>; M],
    record: &mut FusionRecord,
) -> Verdict {
    let innovation = SVector::from_fn(|i, _| scalars[i].innovation);
    let s = SMatrix::<f64, M, M>::from_fn(|i, j| {
        let noise = if i == j { scalars[i].variance } else { 0.0 };
        noise + shared(&scalars[i], &scalars[j], covariance)
    });
    if !write_innovation(record, &innovation, &s) {
        return Verdict::Malformed;
    }
    let (before, covariance_before) = (*mean, *covariance);
    for scalar in scalars {
        // What the scalars before it have moved is already explained.
        let explained: f64 =
            scalar.rows.iter().zip(&scalar.by_row).map(|(&row, by)| by * (mean[row] - before[row])).sum();
        let rest = Scalar { innovation: scalar.innovation - explained, ..*scalar };
        if use_scalar(mean, covariance, &rest, f64::INFINITY).usage != Usage::Used {
            (*mean, *covariance) = (before, covariance_before);
            return Verdict::Malformed;
        }
    }
    Verdict::Accepted
}

/// h P h' of two scalars.
fn shared<const N: usize, const K: usize>(a: &Scalar<K>, b: &Scalar<K>, covariance: &SMatrix<f64, N, N>) -> f64 {
    let mut sum = 0.0;
    for (&row, &by) in a.rows.iter().zip(&a.by_row) {
        for (&column, &by_column) in b.rows.iter().zip(&b.by_row) {
            sum += by * by_column * covariance[(row, column)];
        }
    }
    sum
}

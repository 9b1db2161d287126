//! How well the readings of a step tell its drive.
//!
//! ```text
//! P = c s^2 nu / (nu - 2) (J^T J)^-1      J by distance at rest, steady speed, ln of the rate and onset, all four free
//! s^2 = sum of squared residuals / nu     nu the number of readings less four
//! ```
//! The sigmas are marginal: rate and onset are strongly correlated, and a rate at a fixed onset would look several times more certain
//! than it is. s^2 comes from the same few residuals, so that a value has Student's distribution; nu / (nu - 2) is its variance. A drive
//! that is not of first order leaves residuals that are correlated; c = 1 + 2 sum of their correlations is what they count more, because
//! the columns of J change slowly against them.

use std::ops::Range;

use nalgebra::{SMatrix, SVector};

use super::drive_search::{Drive, DriveFit, DriveSearch, UNKNOWNS};
use crate::statistics::ResidualCorrelation;

/// Relative step of central differences, and their step in seconds.
const STEP: f64 = 1e-3;

/// One standard deviation each; infinite where the readings tell nothing.
pub(super) struct DriveUncertainty {
    pub(super) steady: f64,
    /// Of the logarithm of the rate.
    pub(super) log_rate: f64,
    pub(super) log_mass: f64,
    pub(super) onset_s: f64,
    /// Noise of a reading: the residuals'.
    pub(super) range_sigma_m: f64,
}

/// By least squares about the minimum; at least [`LEAST_USED`](super::drive_search::LEAST_USED) readings must be used.
pub(super) fn drive_uncertainty(
    search: &DriveSearch<'_>,
    window: &Range<usize>,
    fit: &DriveFit,
    is_used: &[bool],
) -> DriveUncertainty {
    let travel = |drive| search.travel_m(drive, window.clone());
    let drive = fit.drive;
    // Central differences; their relative error is the square of the step.
    let by = |ahead: Drive, behind: Drive| -> Vec<f64> {
        let (ahead, behind) = (travel(ahead), travel(behind));
        ahead.iter().zip(behind).map(|(ahead, behind)| (ahead - behind) / (2.0 * STEP)).collect()
    };
    let rate = |factor: f64| Drive { rate_per_s: drive.rate_per_s * f64::exp(factor), ..drive };
    let delayed = |shift_s: f64| Drive { onset_s: drive.onset_s + shift_s, ..drive };
    let (here, by_rate) = (travel(drive), by(rate(STEP), rate(-STEP)));
    let by_onset = by(delayed(STEP), delayed(-STEP));
    let v = fit.steady_m_per_s;
    let mut normal = SMatrix::<f64, 4, 4>::zeros();
    let mut residuals = Vec::with_capacity(window.len());
    for (index, (_, range_m)) in search.readings[window.clone()].iter().enumerate() {
        if !is_used[index] {
            continue;
        }
        let row = SVector::<f64, 4>::new(1.0, -here[index], -v * by_rate[index], -v * by_onset[index]);
        normal += row * row.transpose();
        residuals.push(range_m - fit.start_m + v * here[index]);
    }
    let freedom = (residuals.len() - UNKNOWNS) as f64;
    let variance_m2 = residuals.iter().map(|residual| residual * residual).sum::<f64>() / freedom;
    let range_sigma_m = variance_m2.sqrt();
    let correlation = ResidualCorrelation::from_residuals(&residuals).samples_per_residual;
    let factor = correlation * variance_m2 * freedom / (freedom - 2.0);
    // Readings that do not depend on a rate (a jump of the speed) make the matrix singular: the rate is then unknown.
    let scale = SMatrix::<f64, 4, 4>::from_diagonal(&normal.diagonal().map(|entry| 1.0 / entry.max(1e-18).sqrt()));
    let inverse = (scale * normal * scale).try_inverse().map(|inverse| scale * inverse * scale * factor);
    let Some(covariance) = inverse.filter(|found| found.diagonal().iter().all(|entry| *entry >= 0.0)) else {
        return DriveUncertainty {
            steady: f64::INFINITY,
            log_rate: f64::INFINITY,
            log_mass: f64::INFINITY,
            onset_s: f64::INFINITY,
            range_sigma_m,
        };
    };
    let log_mass = covariance[(1, 1)] / (v * v) + covariance[(2, 2)] + 2.0 * covariance[(1, 2)] / v;
    DriveUncertainty {
        steady: covariance[(1, 1)].sqrt(),
        log_rate: covariance[(2, 2)].sqrt(),
        log_mass: log_mass.max(0.0).sqrt(),
        onset_s: covariance[(3, 3)].sqrt(),
        range_sigma_m,
    }
}

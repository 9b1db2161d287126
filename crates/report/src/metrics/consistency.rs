//! Consistency tests of a filter: do its errors match its claimed covariance?
//!
//! A mean of chi-square variables, over its degrees of freedom, lies in a known band around 1 if the claims are consistent. The band
//! assumes independent samples. Runs with different seeds are independent; the errors at successive instants of one run are not, so a
//! run counts once. Innovations of a consistent filter are white and count singly.
//!
//! Source: Bar-Shalom, Li, Kirubarajan (2001), section 5.4.2.

use std::fmt;

use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::numerics::chi_square::chi_square_quantile;
use posebridge_estimator::numerics::cholesky::{factorise, solve_lower};
use thiserror::Error;

/// Below the band, and above it: 95 % lie within.
const TAIL_PROBABILITY: f64 = 0.025;

const POSE_DEGREES_OF_FREEDOM: u64 = 3;

/// The 95 % interval of the mean normalised error of a consistent filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyBand {
    /// Below 1.
    pub low: f64,
    /// Above 1.
    pub high: f64,
}

impl ConsistencyBand {
    /// `degrees_of_freedom` in total; `None` for zero.
    pub fn of_mean(degrees_of_freedom: u64) -> Option<Self> {
        let per_degree = |probability| chi_square_quantile(degrees_of_freedom, probability) / degrees_of_freedom as f64;
        (degrees_of_freedom > 0)
            .then(|| Self { low: per_degree(TAIL_PROBABILITY), high: per_degree(1.0 - TAIL_PROBABILITY) })
    }

    /// For the ANEES of a planar pose over independent runs; `None` for zero runs.
    pub fn of_runs(runs: u64) -> Option<Self> {
        Self::of_mean(runs.checked_mul(POSE_DEGREES_OF_FREEDOM)?)
    }

    /// With thousands of innovations the band is so narrow that no real sensor lies in it: a standard deviation that is right within
    /// a tenth counts as consistent.
    pub fn classify(self, mean: f64) -> Consistency {
        let is_near = (mean.sqrt() - 1.0).abs() <= NEGLIGIBLE_ERROR;
        if mean.is_nan() {
            Consistency::TooLittleData
        } else if is_near || (self.low..=self.high).contains(&mean) {
            Consistency::Consistent
        } else if mean > self.high {
            Consistency::OverConfident
        } else {
            Consistency::UnderConfident
        }
    }
}

/// Relative error of a standard deviation that is good enough for all purposes.
const NEGLIGIBLE_ERROR: f64 = 0.1;

/// Whether errors are as large as claimed. Every page, table and file uses these four terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Consistency {
    TooLittleData,
    Consistent,
    /// Errors are larger than claimed: the gate rejects good observations, and steering trusts the estimate too much.
    OverConfident,
    /// Errors are smaller than claimed: the filter follows noisy observations more than necessary.
    UnderConfident,
}

impl Consistency {
    pub const fn as_text(self) -> &'static str {
        match self {
            Self::TooLittleData => "too little data",
            Self::Consistent => "consistent",
            Self::OverConfident => "over-confident",
            Self::UnderConfident => "under-confident",
        }
    }
}

impl fmt::Display for Consistency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_text())
    }
}

// Whether the claimed covariance fits the errors: the average normalised estimation error squared.
//
// ```text
// e = [dx_m, dy_m, heading_rad]ᵀ   error, 3 x 1      P   claimed covariance, 3 x 3
// P = L Lᵀ                         L lower triangular (Cholesky)
// NEES = eᵀ P⁻¹ e = |L⁻¹ e|²       chi-square with 3 degrees of freedom if the claim is right
// ANEES = mean(NEES) / 3           1 if the claim is right, above 1 if it is too small
// ```
// Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
// section 5.4. The verdict on the value is that of [`super::verdict`]; a partial pose (no heading) is not tested here.

/// Why a normalised error cannot be computed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NeesError {
    #[error("error or covariance is not finite; leave this sample out")]
    NotFinite,
    #[error(
        "covariance is not positive definite: pivot {pivot:e} in row {row}; the filter that claims it has broken down"
    )]
    NotPositiveDefinite {
        /// Row of the pivot: 0 x, 1 y, 2 heading.
        row: usize,
        /// Not positive.
        pivot: f64,
    },
}

/// The normalised error over many samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Anees {
    /// Mean of e' P^-1 e / 3; `None` if no sample could be tested.
    pub value: Option<f64>,
    pub samples: usize,
    /// Samples whose covariance is not positive definite or not finite.
    pub refused: usize,
}

/// e' P^-1 e of one sample; rows are x in m, y in m, heading in rad. Only the lower triangle of P is read.
pub fn nees(error: [f64; 3], covariance: &[[f64; 3]; 3]) -> Result<f64, NeesError> {
    let covariance = Matrix3::from_fn(|row, column| covariance[row][column]);
    if !covariance.iter().chain(&error).all(|value| value.is_finite()) {
        return Err(NeesError::NotFinite);
    }
    let factor = factorise(&covariance, |row, pivot| {
        let root = (pivot > 0.0).then(|| pivot.sqrt());
        root.ok_or(NeesError::NotPositiveDefinite { row, pivot })
    })?;
    let value = solve_lower(&factor, &Vector3::from(error)).norm_squared();
    if value.is_finite() { Ok(value) } else { Err(NeesError::NotFinite) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bands_are_the_published_ones() {
        for (runs, low, high) in [(1, 0.07, 3.12), (20, 0.67, 1.39), (50, 0.79, 1.24), (100, 0.85, 1.17)] {
            let band = ConsistencyBand::of_runs(runs).unwrap();
            assert!((band.low - low).abs() < 0.006 && (band.high - high).abs() < 0.006, "{runs}: {band:?}");
        }
    }

    #[test]
    fn a_mean_above_the_band_is_over_confident() {
        let band = ConsistencyBand::of_runs(20).unwrap();
        assert_eq!(band.classify(1.5), Consistency::OverConfident);
        assert_eq!(band.classify(1.0), Consistency::Consistent);
        assert_eq!(band.classify(0.01), Consistency::UnderConfident);
        assert_eq!(band.classify(f64::NAN), Consistency::TooLittleData);
        assert_eq!(ConsistencyBand::of_mean(0), None);
        let narrow = ConsistencyBand::of_mean(1_000_000).unwrap();
        assert_eq!(narrow.classify(1.2), Consistency::Consistent, "a sigma that is wrong by less than a tenth");
        assert_eq!(narrow.classify(1.25), Consistency::OverConfident);
    }

    #[test]
    fn a_covariance_that_is_not_positive_definite_names_its_row() {
        let flat = [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(nees([0.0; 3], &flat), Err(NeesError::NotPositiveDefinite { row: 1, pivot: 0.0 }));
        assert_eq!(nees([0.0; 3], &[[f64::NAN; 3]; 3]), Err(NeesError::NotFinite));
    }
}

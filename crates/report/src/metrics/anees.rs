//! Whether the claimed covariance fits the errors: the average normalised estimation error squared.
//!
//! ```text
//! e = [dx_m, dy_m, heading_rad]ᵀ   error, 3 x 1      P   claimed covariance, 3 x 3
//! P = L Lᵀ                         L lower triangular (Cholesky)
//! NEES = eᵀ P⁻¹ e = |L⁻¹ e|²       chi-square with 3 degrees of freedom if the claim is honest
//! ANEES = mean(NEES) / 3           1 if the claim is honest, above 1 if it boasts
//! ```
//! Source: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001),
//! section 5.4. The verdict on the value is [`super::consistency`]'s; a partial pose (no heading) is not tested here.

use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::numerics::cholesky::{factorise, solve_lower};
use posebridge_telemetry::Heading;
use thiserror::Error;

use super::error::PoseError;

/// Rows of the pose: x, y, heading.
const POSE_ROWS: usize = 3;

/// Why a normalised error cannot be computed.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum NeesError {
    /// The error or the covariance holds a value that is not finite.
    #[error("error or covariance is not finite; leave this sample out")]
    NotFinite,
    /// The covariance is not positive definite.
    #[error(
        "covariance is not positive definite: pivot {pivot:e} in row {row}; the filter that claims it has broken down"
    )]
    NotPositiveDefinite {
        /// Row of the pivot: 0 x, 1 y, 2 heading.
        row: usize,
        /// The pivot, which should be above zero.
        pivot: f64,
    },
}

/// The outcome over many samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Anees {
    /// Mean of e' P^-1 e / 3; `None` if no sample could be tested.
    pub value: Option<f64>,
    /// Samples in the mean.
    pub samples: usize,
    /// Samples with a claim that could not be tested: not positive definite, or not finite.
    pub refused: usize,
}

/// The mean of the normalised errors over 3, over all samples that have a heading and a covariance.
pub fn anees(errors: &[PoseError]) -> Anees {
    let mut sum = 0.0;
    let mut outcome = Anees::default();
    for error in errors.iter().filter(|error| error.is_finite()) {
        let (Some(heading_rad), Some(covariance)) = (error.heading_rad, error.covariance) else {
            continue;
        };
        let wrapped_rad = Heading::from_rad(heading_rad).rad();
        match nees([error.dx_m, error.dy_m, wrapped_rad], &covariance) {
            Ok(value) => {
                sum += value;
                outcome.samples += 1;
            }
            Err(_) => outcome.refused += 1,
        }
    }
    if outcome.samples > 0 {
        outcome.value = Some(sum / (outcome.samples * POSE_ROWS) as f64);
    }
    outcome
}

/// e' P^-1 e of one sample; rows are x in m, y in m, heading in rad. Only the lower triangle of P is read.
///
/// # Errors
///
/// [`NeesError`] if anything is not finite or P is not positive definite.
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

    const P: [[f64; 3]; 3] = [[4.0, 2.0, 0.0], [2.0, 5.0, 3.0], [0.0, 3.0, 6.0]];

    #[test]
    fn the_normalised_error_of_a_worked_example() {
        // By hand, with the adjugate: det P = 60, P^-1 (2, 1, 0)' = (30, 0, 0)' / 60, so e' P^-1 e = 1.
        assert!((nees([2.0, 1.0, 0.0], &P).unwrap() - 1.0).abs() < 1e-12);
        // And P^-1 (0, 0, 1)' = (6, -12, 16)' / 60, so e = (0, 0, 3) gives 9 * 16 / 60.
        assert!((nees([0.0, 0.0, 3.0], &P).unwrap() - 2.4).abs() < 1e-12);
    }

    #[test]
    fn a_covariance_that_is_not_positive_definite_names_its_row() {
        let flat = [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert_eq!(nees([0.0; 3], &flat), Err(NeesError::NotPositiveDefinite { row: 1, pivot: 0.0 }));
        assert_eq!(nees([0.0; 3], &[[f64::NAN; 3]; 3]), Err(NeesError::NotFinite));
    }

    #[test]
    fn broken_claims_are_counted_beside_the_mean() {
        let sample = |covariance| PoseError { dx_m: 3.0, dy_m: 0.0, heading_rad: Some(0.0), covariance };
        let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let outcome = anees(&[sample(Some(unit)), sample(Some([[0.0; 3]; 3])), sample(None)]);
        assert_eq!(outcome, Anees { value: Some(3.0), samples: 1, refused: 1 });
    }
}

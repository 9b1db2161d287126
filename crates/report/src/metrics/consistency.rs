//! The verdict in words: does a filter know how good it is?
//!
//! A mean of chi-square variables, over its degrees of freedom, lies in a known band around 1 if the claims are honest.
//! The band assumes independent samples. Runs with different seeds are independent; the errors at successive instants
//! of one run are not, so a run counts once. Innovations of an honest filter are white and count singly.
//!
//! Source: Bar-Shalom, Li, Kirubarajan (2001), section 5.4.2.

use std::fmt;

use posebridge_estimator::numerics::chi_square::chi_square_quantile;

use super::anees::Anees;

/// Probability below the band, and above it: 95 % lie within.
const TAIL_PROBABILITY: f64 = 0.025;

/// Degrees of freedom of one pose error: x, y, heading.
const POSE_DEGREES_OF_FREEDOM: u64 = 3;

/// Where the mean normalised error of an honest filter lies with 95 % probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsistencyBand {
    /// Lower end, below 1.
    pub low: f64,
    /// Upper end, above 1.
    pub high: f64,
}

impl ConsistencyBand {
    /// The band of a mean with this number of degrees of freedom in total; `None` without any.
    pub fn of_mean(degrees_of_freedom: u64) -> Option<Self> {
        let per_degree = |probability| chi_square_quantile(degrees_of_freedom, probability) / degrees_of_freedom as f64;
        (degrees_of_freedom > 0)
            .then(|| Self { low: per_degree(TAIL_PROBABILITY), high: per_degree(1.0 - TAIL_PROBABILITY) })
    }

    /// The band of the ANEES of a planar pose over this number of independent runs; `None` without any.
    pub fn of_runs(runs: u64) -> Option<Self> {
        Self::of_mean(runs.checked_mul(POSE_DEGREES_OF_FREEDOM)?)
    }

    /// On which side of the band a mean lies.
    pub fn classify(self, mean: f64) -> Consistency {
        if mean.is_nan() {
            Consistency::Undetermined
        } else if mean > self.high {
            Consistency::OverConfident
        } else if mean < self.low {
            Consistency::UnderConfident
        } else {
            Consistency::Consistent
        }
    }
}

/// The verdict on the claims of a filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Consistency {
    /// Errors are larger than claimed: the gate rejects good observations, and steering trusts too much.
    OverConfident,
    /// Errors are as claimed.
    Consistent,
    /// Errors are smaller than claimed: the filter follows noisy observations more than it needs to.
    UnderConfident,
    /// No samples to test.
    Undetermined,
}

impl Consistency {
    /// The verdict on an ANEES that was averaged over this number of independent runs. A covariance that could not be tested
    /// makes the filter over-confident: it has claimed the impossible.
    pub fn of_anees(anees: &Anees, runs: u64) -> Self {
        if anees.refused > 0 {
            return Self::OverConfident;
        }
        match (anees.value, ConsistencyBand::of_runs(runs)) {
            (Some(value), Some(band)) => band.classify(value),
            (None, _) | (_, None) => Self::Undetermined,
        }
    }

    /// The verdict as reports print it.
    pub const fn as_text(self) -> &'static str {
        match self {
            Self::OverConfident => "over-confident",
            Self::Consistent => "consistent",
            Self::UnderConfident => "under-confident",
            Self::Undetermined => "undetermined",
        }
    }
}

impl fmt::Display for Consistency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bands_for_20_50_and_100_runs_are_the_published_ones() {
        for (runs, low, high) in [(20, 0.67, 1.39), (50, 0.79, 1.24), (100, 0.85, 1.17)] {
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
        assert_eq!(band.classify(f64::NAN), Consistency::Undetermined);
        assert_eq!(ConsistencyBand::of_mean(0), None);
    }

    #[test]
    fn a_broken_covariance_is_never_called_consistent() {
        let anees = Anees { value: Some(1.0), samples: 20, refused: 1 };
        assert_eq!(Consistency::of_anees(&anees, 20), Consistency::OverConfident);
    }
}

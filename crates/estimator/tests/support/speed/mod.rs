//! One and the same five-state filter, written in several ways: what the benchmark measures and a test compares.
//!
//! States, motion and Jacobian are those of `models::planar_speeds` (paper 1, equation 24). Each step predicts with the two
//! accelerations and then uses v from the encoders, the heading from the encoders, the heading from the gyro and w.

mod floor;
mod foreign;
mod inputs;
mod library;

pub(crate) use inputs::{Input, STEPS, recorded};

/// Length of a step, s: that of paper 1.
pub(crate) const INTERVAL_S: f64 = 0.05;
/// The diagonal of Q per step: a small robot on a smooth floor, in SI units. Paper 1 prints centimetres and degrees.
pub(crate) const PROCESS_VARIANCES: [f64; 5] = [1e-6, 1e-6, 1e-6, 4e-4, 1e-3];
/// The variances of v, heading by the encoders, heading by the gyro, w.
pub(crate) const OBSERVED_VARIANCES: [f64; 4] = [4e-4, 1e-4, 3.6e-5, 4e-4];
/// The initial covariance is this times the identity, as in paper 1.
pub(crate) const INITIAL_VARIANCE: f64 = 0.05;

/// What a filter believes after all steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FilterState {
    pub(crate) mean: [f64; 5],
    pub(crate) covariance: [[f64; 5]; 5],
}

impl FilterState {
    /// The largest difference of any two numbers.
    pub(crate) fn distance(&self, other: &Self) -> f64 {
        let numbers = |belief: &Self| {
            let covariance = belief.covariance.into_iter().flatten();
            belief.mean.into_iter().chain(covariance).collect::<Vec<_>>()
        };
        let pairs = numbers(self).into_iter().zip(numbers(other));
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// One way to write the filter.
pub(crate) struct Implementation {
    pub(crate) name: &'static str,
    /// From rest at the origin over all inputs.
    pub(crate) run: fn(&[Input]) -> FilterState,
}

/// Every way, the floor first, the library second.
pub(crate) const IMPLEMENTATIONS: [Implementation; 5] = [
    Implementation { name: "floor: unrolled by hand, 3 scalars", run: floor::run },
    Implementation { name: "library: predict + 4 gated scalars", run: library::run },
    Implementation { name: "library, dense: F P F' + 4 x 4 batch", run: library::run_dense },
    Implementation { name: "kfilter 0.5.1", run: foreign::run_kfilter },
    Implementation { name: "adskalman 0.18.0, Joseph", run: foreign::run_adskalman },
];

/// How far two ways may lie apart after all steps: rounding in another order, nothing else.
pub(crate) const AGREEMENT: f64 = 1e-9;

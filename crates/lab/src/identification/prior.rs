//! The prior of a step response: equation (5) of [`super::fit`].
//!
//! [`super::sensor_kind`] derives it from earlier runs; [`super::step`](mod@super::step) uses a weak one.

use nalgebra::{DMatrix, DVector};

use super::step_response::{Lag, StepResponse};

pub const MAX_ORDER: usize = 3;
/// Indices of the parameters that every response has.
pub mod row {
    /// y_0.
    pub const START: usize = 0;
    /// D.
    pub const STEP: usize = 1;
    /// t_0.
    pub const ONSET: usize = 2;
    /// The first ln tau; the others and the shares follow.
    pub const LAGS: usize = 3;
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GaussianPrior {
    pub mean: f64,
    /// Positive.
    pub sigma: f64,
}

impl GaussianPrior {
    pub(super) fn cost(&self, value: f64) -> f64 {
        0.5 * ((value - self.mean) / self.sigma).powi(2)
    }

    pub(super) fn weight(&self) -> f64 {
        (self.sigma * self.sigma).recip()
    }
}

/// Prior of the lags and the shares, equation (5).
#[derive(Clone, Debug, PartialEq)]
pub struct DynamicsPrior {
    order: usize,
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    inverse: DMatrix<f64>,
    freedom: f64,
}

impl DynamicsPrior {
    /// m in the order ln tau_1 .. ln tau_n (tau in seconds), s_1 .. s_(n-1), with S and nu (positive, or infinite for a Gaussian).
    ///
    /// `None` if the number of rows is not that of an order of 1 to [`MAX_ORDER`], or if S is not positive definite.
    pub fn new(mean: DVector<f64>, covariance: DMatrix<f64>, freedom: f64) -> Option<Self> {
        let order = mean.len().div_ceil(2);
        let is_usable = mean.len() % 2 == 1
            && order <= MAX_ORDER
            && covariance.shape() == (mean.len(), mean.len())
            && freedom > 0.0
            && mean.iter().all(|value| value.is_finite());
        if !is_usable {
            return None;
        }
        Some(Self { order, inverse: covariance.clone().cholesky()?.inverse(), mean, covariance, freedom })
    }

    pub fn independent(ln_lags: &[GaussianPrior], shares: &[GaussianPrior]) -> Option<Self> {
        let all: Vec<GaussianPrior> = ln_lags.iter().chain(shares).copied().collect();
        let mean = all.iter().map(|prior| prior.mean);
        let variances = all.iter().map(|prior| prior.sigma * prior.sigma);
        Self::new(
            DVector::from_iterator(all.len(), mean),
            DMatrix::from_diagonal(&DVector::from_iterator(all.len(), variances)),
            f64::INFINITY,
        )
    }

    /// n, the number of lags.
    pub const fn order(&self) -> usize {
        self.order
    }

    /// S^-1.
    pub(super) const fn inverse(&self) -> &DMatrix<f64> {
        &self.inverse
    }

    /// m and sqrt(S) of the slowest lag's ln tau.
    pub fn slowest(&self) -> GaussianPrior {
        let row = self.order - 1;
        GaussianPrior { mean: self.mean[row], sigma: self.covariance[(row, row)].sqrt() }
    }

    /// Half the log-determinant of S: the prior volume.
    pub fn half_ln_determinant(&self) -> f64 {
        let cholesky = self.inverse.clone().cholesky();
        cholesky.map_or(0.0, |factor| -factor.l().diagonal().map(f64::ln).sum())
    }

    /// The response with the most likely dynamics, for a given start, step and onset.
    pub fn expected(&self, start: f64, step: f64, onset_s: f64) -> StepResponse {
        let rows = self.mean.iter().copied();
        response_of(&[start, step, onset_s], rows.clone().take(self.order), rows.skip(self.order))
    }

    /// rho, its slope, and the weight of S^-1 in a local parabola.
    pub(super) fn cost_at(&self, at: &DVector<f64>) -> (f64, DVector<f64>, f64) {
        let off = at.rows(row::LAGS, self.mean.len()) - &self.mean;
        let pull = &self.inverse * &off;
        let squares = off.dot(&pull);
        if self.freedom.is_infinite() {
            return (0.5 * squares, pull, 1.0);
        }
        let a = self.freedom + self.mean.len() as f64;
        let weight = a / (a + squares);
        (0.5 * a * (squares / a).ln_1p(), pull * weight, weight)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct ResponsePrior {
    /// t_0, in seconds.
    pub onset: GaussianPrior,
    pub dynamics: DynamicsPrior,
    /// Additional prior of the slowest lag's ln tau, for one member of a bank.
    pub slowest: Option<GaussianPrior>,
    /// u = y_0 + D, if the end of the step is known.
    pub end: Option<GaussianPrior>,
}

impl ResponsePrior {
    pub(super) fn parameters(&self) -> usize {
        row::LAGS + self.dynamics.mean.len()
    }

    /// The response with the most likely dynamics and onset.
    pub fn expected(&self, start: f64, step: f64) -> StepResponse {
        let mut response = self.dynamics.expected(start, step, self.onset.mean);
        if let (Some(prior), Some(lag)) = (&self.slowest, response.lags.last_mut()) {
            lag.time_constant_s = prior.mean.exp();
        }
        response
    }
}

/// The response with these parameters: y_0, D and t_0, the logarithms of the lags, and all shares but the last.
pub(super) fn response_of(
    first: &[f64; 3],
    ln_lags: impl Iterator<Item = f64>,
    shares: impl Iterator<Item = f64>,
) -> StepResponse {
    let mut rest = 1.0;
    let mut shares = shares.map(Some).chain(std::iter::repeat(None));
    let lags = ln_lags.map(|ln_lag| {
        let share = shares.next().flatten().unwrap_or(rest);
        rest -= share;
        Lag { time_constant_s: ln_lag.exp(), share }
    });
    StepResponse { lags: lags.collect(), start: first[row::START], step: first[row::STEP], onset_s: first[row::ONSET] }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepDirection {
    Up,
    Down,
}

impl StepDirection {
    pub fn from_step(step: f64) -> Self {
        if step < 0.0 { Self::Down } else { Self::Up }
    }

    pub const fn name(self) -> &'static str {
        match self {
            Self::Up => "up",
            Self::Down => "down",
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedDynamics {
    /// For a run of the same kind.
    pub dynamics: DynamicsPrior,
    /// For a run with dynamics equal to those of the earlier runs.
    pub same: Option<DynamicsPrior>,
    /// delta: relative error of the model in the remaining transient.
    pub model_share: f64,
    /// Correlation time of the model error.
    pub error_duration_s: f64,
    /// Correction of the predictions' sigmas by the earlier runs; at least 1.
    pub sigma_factor: f64,
}

impl ExpectedDynamics {
    /// Exactly known dynamics: time constants in seconds with their shares, which sum to one.
    ///
    /// `None` for time constants that are not positive, or for more lags than [`MAX_ORDER`].
    pub fn known(lags: &[(f64, f64)]) -> Option<Self> {
        let certain = |mean: f64| GaussianPrior { mean, sigma: CERTAIN_SIGMA };
        let ln_lags: Vec<GaussianPrior> = lags.iter().map(|(tau_s, _)| certain(tau_s.ln())).collect();
        let free = lags.len().saturating_sub(1);
        let shares: Vec<GaussianPrior> = lags.iter().take(free).map(|(_, s)| certain(*s)).collect();
        Some(Self {
            dynamics: DynamicsPrior::independent(&ln_lags, &shares)?,
            same: None,
            model_share: 0.0,
            error_duration_s: 0.0,
            sigma_factor: 1.0,
        })
    }
}

/// Negligible beside any noise.
const CERTAIN_SIGMA: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;

    fn dynamics(freedom: f64) -> DynamicsPrior {
        let mean = DVector::from_vec(vec![1.0, 2.0, 0.4]);
        let covariance = DMatrix::from_row_slice(3, 3, &[0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.01]);
        DynamicsPrior::new(mean, covariance, freedom).unwrap()
    }

    fn at(off: [f64; 3]) -> DVector<f64> {
        DVector::from_vec(vec![0.0, 0.0, 0.0, 1.0 + off[0], 2.0 + off[1], 0.4 + off[2]])
    }

    #[test]
    fn the_pull_is_the_slope_of_the_cost() {
        for freedom in [3.0, f64::INFINITY] {
            let dynamics = dynamics(freedom);
            let (_, pull, _) = dynamics.cost_at(&at([0.3, -0.5, 0.2]));
            for i in 0..3 {
                let mut step = [0.3, -0.5, 0.2];
                step[i] += 1e-6;
                let above = dynamics.cost_at(&at(step)).0;
                step[i] -= 2e-6;
                let slope = (above - dynamics.cost_at(&at(step)).0) / 2e-6;
                assert!((slope - pull[i]).abs() < 1e-6, "{freedom}: {slope} {}", pull[i]);
            }
        }
    }

    #[test]
    fn the_peak_is_the_gaussian_s_and_the_tail_is_not() {
        let (gaussian, robust) = (dynamics(f64::INFINITY), dynamics(3.0));
        let cost = |dynamics: &DynamicsPrior, off: f64| dynamics.cost_at(&at([off, 0.0, 0.0])).0;
        assert!((cost(&robust, 1e-3) / cost(&gaussian, 1e-3) - 1.0).abs() < 1e-4);
        assert!(cost(&robust, 2.0) < 0.3 * cost(&gaussian, 2.0));
        // ln of the root of the determinant of S, by hand.
        let half_ln_det = 0.5 * ((0.04_f64 * 0.09 - 0.01 * 0.01) * 0.01).ln();
        assert!((gaussian.half_ln_determinant() - half_ln_det).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_belief_is_refused() {
        let of = |rows: usize, variance: f64, freedom| {
            DynamicsPrior::new(DVector::zeros(rows), DMatrix::identity(rows, rows) * variance, freedom)
        };
        assert!(of(3, 1.0, 1.0).is_some());
        assert!(of(2, 1.0, 1.0).is_none(), "a share without its lag");
        assert!(of(7, 1.0, 1.0).is_none(), "order 4");
        assert!(of(3, 0.0, 1.0).is_none());
        assert!(of(3, f64::NAN, 1.0).is_none());
        assert!(of(3, 1.0, 0.0).is_none());
    }
}

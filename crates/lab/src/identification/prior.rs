//! The prior of a step response: equation (5) of [`super::fit`].
//!
//! [`super::step`](mod@super::step) uses a weak one.

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
    inverse: DMatrix<f64>,
}

impl DynamicsPrior {
    /// m in the order ln tau_1 .. ln tau_n (tau in seconds), s_1 .. s_(n-1), with S.
    ///
    /// `None` if the number of rows is not that of an order of 1 to [`MAX_ORDER`], or if S is not positive definite.
    pub fn new(mean: DVector<f64>, covariance: DMatrix<f64>) -> Option<Self> {
        let order = mean.len().div_ceil(2);
        let is_usable = mean.len() % 2 == 1
            && order <= MAX_ORDER
            && covariance.shape() == (mean.len(), mean.len())
            && mean.iter().all(|value| value.is_finite());
        if !is_usable {
            return None;
        }
        Some(Self { order, inverse: covariance.cholesky()?.inverse(), mean })
    }

    pub fn independent(ln_lags: &[GaussianPrior], shares: &[GaussianPrior]) -> Option<Self> {
        let all: Vec<GaussianPrior> = ln_lags.iter().chain(shares).copied().collect();
        let mean = all.iter().map(|prior| prior.mean);
        let variances = all.iter().map(|prior| prior.sigma * prior.sigma);
        Self::new(
            DVector::from_iterator(all.len(), mean),
            DMatrix::from_diagonal(&DVector::from_iterator(all.len(), variances)),
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

    /// The response with the most likely dynamics, for a given start, step and onset.
    pub fn expected(&self, start: f64, step: f64, onset_s: f64) -> StepResponse {
        let rows = self.mean.iter().copied();
        response_of(&[start, step, onset_s], rows.clone().take(self.order), rows.skip(self.order))
    }

    /// rho and its slope.
    pub(super) fn cost_at(&self, at: &DVector<f64>) -> (f64, DVector<f64>) {
        let off = at.rows(row::LAGS, self.mean.len()) - &self.mean;
        let pull = &self.inverse * &off;
        (0.5 * off.dot(&pull), pull)
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct ResponsePrior {
    /// t_0, in seconds.
    pub onset: GaussianPrior,
    pub dynamics: DynamicsPrior,
    /// u = y_0 + D, if the end of the step is known.
    pub end: Option<GaussianPrior>,
}

impl ResponsePrior {
    pub(super) fn parameters(&self) -> usize {
        row::LAGS + self.dynamics.mean.len()
    }

    /// The response with the most likely dynamics and onset.
    pub fn expected(&self, start: f64, step: f64) -> StepResponse {
        self.dynamics.expected(start, step, self.onset.mean)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pull_is_the_slope_of_the_cost() {
        let mean = DVector::from_vec(vec![1.0, 2.0, 0.4]);
        let covariance = DMatrix::from_row_slice(3, 3, &[0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.01]);
        let dynamics = DynamicsPrior::new(mean, covariance).unwrap();
        let at = |off: [f64; 3]| DVector::from_vec(vec![0.0, 0.0, 0.0, 1.0 + off[0], 2.0 + off[1], 0.4 + off[2]]);
        let (_, pull) = dynamics.cost_at(&at([0.3, -0.5, 0.2]));
        for i in 0..3 {
            let mut step = [0.3, -0.5, 0.2];
            step[i] += 1e-6;
            let above = dynamics.cost_at(&at(step)).0;
            step[i] -= 2e-6;
            let slope = (above - dynamics.cost_at(&at(step)).0) / 2e-6;
            assert!((slope - pull[i]).abs() < 1e-6, "{slope} {}", pull[i]);
        }
    }

    #[test]
    fn what_is_no_prior_is_refused() {
        let of = |rows: usize, variance: f64| {
            DynamicsPrior::new(DVector::zeros(rows), DMatrix::identity(rows, rows) * variance)
        };
        assert!(of(3, 1.0).is_some());
        assert!(of(2, 1.0).is_none(), "a share without its lag");
        assert!(of(7, 1.0).is_none(), "order 4");
        assert!(of(3, 0.0).is_none());
        assert!(of(3, f64::NAN).is_none());
    }
}

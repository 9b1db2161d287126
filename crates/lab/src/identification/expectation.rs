//! What is expected of a run before it is seen: which way its step leads, and its dynamics.

use super::prior::{DynamicsPrior, GaussianPrior};

/// Where a step leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepDirection {
    /// The value rises: heating.
    Up,
    /// The value falls: cooling.
    Down,
}

impl StepDirection {
    /// That of a step.
    pub fn from_step(step: f64) -> Self {
        if step < 0.0 { Self::Down } else { Self::Up }
    }
}

/// What is expected of the dynamics of a run before it is seen.
#[derive(Clone, Debug, PartialEq)]
pub struct ExpectedDynamics {
    /// Of the lags and the shares, if the run is one of the kind.
    pub dynamics: DynamicsPrior,
    /// The same, if its dynamics are those of the runs before, which then count as equal.
    pub same: Option<DynamicsPrior>,
    /// delta: by which share of what is left of the transient the model errs.
    pub model_share: f64,
    /// How long such an error holds, in seconds.
    pub error_duration_s: f64,
    /// By how much the sigmas of predictions are too small, as far as the runs before show; at least 1.
    pub sigma_factor: f64,
}

impl ExpectedDynamics {
    /// Dynamics that are known for certain: time constants in seconds with their shares, which add up to one.
    ///
    /// `None` for time constants that are not positive, or for more lags than a response may have.
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

/// A millionth is nothing beside any noise.
const CERTAIN_SIGMA: f64 = 1e-6;

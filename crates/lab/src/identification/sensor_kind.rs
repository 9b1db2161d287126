//! What identified steps tell of the next sensor of their kind.
//!
//! # Model
//! Run i has ln tau_1, ln (tau_1 / tau_2) and the share of the faster lag, with variances of their own, v_i. The next run is drawn
//! from the same population, whose spread is learned from n runs and a prior spread that weighs as much as three:
//! ```text
//! m = mean of x_i      s^2 = (3 s_0^2 + sum over i of (x_i - m)^2) / (n + 2)                                               (9)
//! next run             N(m, s^2 (1 + 1/n) + mean of v_i / n)                                                              (10)
//! ```
//! A run with a single lag says nothing of a second one: what is known of any sensor stands for it.
//!
//! # Sources
//! Gelman and others, Bayesian Data Analysis, third edition, sections 3.2 and 3.3; docs/lab/thermometer.md section 4.

use posebridge_estimator::models::slow_sensor::{LogNormal, SensorDynamics, SlowLag};
use posebridge_estimator::numerics::statistics;

use super::fit::{share_slopes, sigma_along};
use super::prior::row;
use super::step::IdentifiedStep;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RunSimilarity {
    /// Sensors of one type, or one sensor in different surroundings.
    #[default]
    SameKind,
    /// One sensor in the same surroundings.
    SameSensor,
}

/// s_0 of (9): of ln tau_1, ln (tau_1 / tau_2) and the share.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PriorSpread {
    ln_lag: f64,
    ln_ratio: f64,
    share: f64,
}

impl RunSimilarity {
    const fn prior_spread(self) -> PriorSpread {
        match self {
            // Another sleeve and other water change the slow lag by a quarter, and the fast one by much more: it is the path
            // of the heat that matters, not the mass of the sensor.
            Self::SameKind => PriorSpread { ln_lag: 0.25, ln_ratio: 0.7, share: 0.15 },
            // The depth of immersion and the stirring still differ from dip to dip.
            Self::SameSensor => PriorSpread { ln_lag: 0.02, ln_ratio: 0.05, share: 0.01 },
        }
    }
}

/// (9) counts the prior spread as this number of runs.
const PRIOR_RUNS: f64 = 3.0;

/// A quantity of one run with its variance.
type RunValue = (f64, f64);

/// Describes the next sensor by earlier runs; `None` without any.
pub fn describe_sensor(runs: &[IdentifiedStep], similarity: RunSimilarity) -> Option<SensorDynamics> {
    let prior = similarity.prior_spread();
    let lags: Vec<RunLags> = runs.iter().filter_map(RunLags::of_run).collect();
    let slow = lags.iter().map(|lags| lags.ln_slow);
    let (ln_slow, ln_slow_sigma) = next_run(&slow.collect::<Vec<_>>(), prior.ln_lag)?;
    let fast: Vec<FastPart> = lags.iter().filter_map(|lags| lags.fast).collect();
    let ratios: Vec<RunValue> = fast.iter().map(|fast| fast.ln_ratio).collect();
    let shares: Vec<RunValue> = fast.iter().map(|fast| fast.share).collect();
    let unknown = SensorDynamics::UNKNOWN;
    let ratio = next_run(&ratios, prior.ln_ratio);
    let share = next_run(&shares, prior.share);
    Some(SensorDynamics {
        slow_lag: SlowLag::Known(LogNormal { median: ln_slow.exp(), ln_sigma: ln_slow_sigma }),
        lag_ratio: ratio.map_or(unknown.lag_ratio, |(ln, ln_sigma)| LogNormal { median: ln.exp(), ln_sigma }),
        fast_share: share.map_or(unknown.fast_share, |(share, _)| share),
        fast_share_sigma: share.map_or(unknown.fast_share_sigma, |(_, sigma)| sigma),
        single_lag_probability: (lags.len() - fast.len()) as f64 / lags.len() as f64 * SINGLE_LAG_TRUST,
    })
}

/// That runs show a single lag says this much for the next one.
const SINGLE_LAG_TRUST: f64 = 0.5;

/// Mean and sigma of the next run by (9) and (10); `None` without runs.
fn next_run(values: &[RunValue], prior_spread: f64) -> Option<(f64, f64)> {
    let count = values.len() as f64;
    let mean = statistics::mean(values.iter().map(|(value, _)| *value))?;
    let scatter: f64 = values.iter().map(|(value, _)| (value - mean).powi(2)).sum();
    let spread = (PRIOR_RUNS * prior_spread * prior_spread + scatter) / (count + PRIOR_RUNS - 1.0);
    let own = statistics::mean(values.iter().map(|(_, variance)| *variance))? / count;
    Some((mean, (spread * (1.0 + 1.0 / count) + own).sqrt()))
}

/// The two lags by which a run is described.
struct RunLags {
    ln_slow: RunValue,
    fast: Option<FastPart>,
}

#[derive(Clone, Copy)]
struct FastPart {
    ln_ratio: RunValue,
    share: RunValue,
}

impl RunLags {
    /// Of two lags, if the run shows two or more, else of one.
    fn of_run(run: &IdentifiedStep) -> Option<Self> {
        let chosen = if run.order() >= 2 { run.of_order(2) } else { None };
        let fit = &chosen.unwrap_or_else(|| run.chosen()).fit;
        let slow = fit.response.lags.len().checked_sub(1)?;
        let ln_lag = |j: usize| fit.response.lags.get(j).map(|lag| lag.time_constant_s.ln());
        let fast = (slow > 0).then(|| {
            let ratio_sigma = sigma_along(&fit.covariance, &[(row::LAGS + slow, 1.0), (row::LAGS, -1.0)]);
            let share_sigma = sigma_along(&fit.covariance, &share_slopes(0, slow + 1));
            Some(FastPart {
                ln_ratio: (ln_lag(slow)? - ln_lag(0)?, ratio_sigma * ratio_sigma),
                share: (fit.response.lags.first()?.share, share_sigma * share_sigma),
            })
        });
        Some(Self { ln_slow: (ln_lag(slow)?, fit.ln_lag_sigma(slow).powi(2)), fast: fast.flatten() })
    }
}

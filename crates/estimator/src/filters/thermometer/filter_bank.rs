//! The approach of a slow sensor to a new value: a bank of extended Kalman filters, one for each hypothesis on its lags.
//!
//! ```text
//! y      = u + x_1 + x_2 + noise                            u the final value, x_j what is left of each lag
//! dx_j/dt = -(e^(e_j) / tau_j) x_j                           e_j the error of ln rate: between nodes, and of the model
//! de_1 = q sqrt(rate_1) dw     de_2 = q sqrt(rate_2) dw     no sensor keeps its time constant: convection, stirring
//!
//! prior  u ~ N(y_0, D^2)     x_j = -share_j (u - y_0), share_2 = s +- sigma_s, share_1 = 1 - s +- sigma_s
//!        a single lag: s = 0, sigma_s = 0.1 q
//!        e_j ~ N(0, half the distance of two nodes squared)
//! nodes  ln tau_1 at most 0.3 apart     ln(tau_1 / tau_2) at most 0.6 apart     D = 1, 8, 64 times the change so far
//!        q = 0.02, 0.1, 0.3, each half as likely as the one before
//! weight of a hypothesis        prior * product of N(innovation; 0, S)
//!
//! drift  y = y_0 + v t + noise    dv = 0.1 v sqrt(dt / t) dw: nothing settles; prior 0.1
//! ```
//! The final value is the mean of u over the hypotheses. Its variance has the variance within and between them, and
//! (0.01 (u - y_0))^2, because sensors creep by a hundredth of a step when they seem to have settled.
//!
//! Source: Paper 2 (Markovsky) for a given sensor; Magill (1965) for the bank; docs/lab/thermometer.md, section M7.

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

use crate::models::slow_sensor::{LogNormal, MIN_LAG_RATIO, SensorDynamics, SlowLag};
use crate::saved::{covariance, finite, not_nan};
use crate::update::{ScalarMeasurement, use_scalar};

const STATES: usize = 5;
const FINAL_VALUE: usize = 0;
/// Rows of x_j.
const TRANSIENTS: [usize; 2] = [1, 2];
/// Rows of e_j.
const RATE_ERRORS: [usize; 2] = [3, 4];

/// The range of an unknown time constant.
const MIN_TIME_CONSTANT_S: f64 = 0.5;
const MAX_TIME_CONSTANT_S: f64 = 1_200.0;
/// Largest distances of two nodes.
const LN_TAU_STEP: f64 = 0.3;
const LN_RATIO_STEP: f64 = 0.6;
/// Nodes reach this number of sigmas to each side: of a known lag, and of the ratio.
const LAG_SIGMAS: f64 = 2.0;
const RATIO_SIGMAS: f64 = 1.5;
/// Of a single lag sigma_s is this share of q: a sensor whose rate walks is no exact exponential either.
const SINGLE_LAG_SHARE_SIGMA: f64 = 0.1;
/// q with its prior weight: of a sensor that keeps its rates, of one in moving water, and of one whose surroundings change
/// as it settles.
const RATE_WALKS: [(f64, f64); 3] = [(0.02, 1.0), (0.1, 0.5), (0.3, 0.25)];
/// Prior sigma of the step, relative to the change that was seen first: that may be most of the step or a fiftieth of it.
const STEP_SCALES: [f64; 3] = [1.0, 8.0, 64.0];
/// That change counts as at least this number of sigmas of a reading.
const MIN_CHANGE_SIGMAS: f64 = 10.0;
/// Prior probability of a change without an end, and the relative walk of its slope.
const DRIFT_PROBABILITY: f64 = 0.1;
const SLOPE_WALK: f64 = 0.1;
/// Share of a step by which a sensor creeps after it seems settled.
const CREEP_SHARE: f64 = 0.01;
/// A hypothesis that is this much less likely than the best one is dropped.
const DROPPED_LN_WEIGHT: f64 = -13.8;
/// A rate that changes by more than a factor of two is none.
const MAX_RATE_ERROR: f64 = 0.7;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanVariance {
    pub mean: f64,
    pub variance: f64,
}

/// The last level of a sensor at rest, and the first sign that it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct StepStart {
    /// y_0 with its variance.
    pub(super) level: MeanVariance,
    /// Change from the level so far, and the time that it took.
    pub(super) change: f64,
    pub(super) duration_s: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct FilterBank {
    members: Vec<Member>,
    drift: Drift,
    #[serde(deserialize_with = "finite")]
    level: f64,
    #[serde(deserialize_with = "finite")]
    elapsed_s: f64,
}

/// The hypothesis that the reading changes without an end.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Drift {
    /// Reading and slope per second.
    #[serde(deserialize_with = "finite")]
    mean: SVector<f64, 2>,
    #[serde(deserialize_with = "covariance")]
    covariance: SMatrix<f64, 2, 2>,
    #[serde(deserialize_with = "not_nan")]
    ln_weight: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Member {
    #[serde(deserialize_with = "finite")]
    rates_per_s: [f64; 2],
    /// q.
    #[serde(deserialize_with = "finite")]
    rate_walk: f64,
    #[serde(deserialize_with = "finite")]
    mean: SVector<f64, STATES>,
    #[serde(deserialize_with = "covariance")]
    covariance: SMatrix<f64, STATES, STATES>,
    #[serde(deserialize_with = "not_nan")]
    ln_weight: f64,
}

/// One node of the bank, before it is a filter.
struct Hypothesis {
    slow_lag_s: f64,
    ratio: f64,
    /// Prior sigmas of the logarithms of both rates: half the distance to the next node.
    rate_sigmas: [f64; 2],
    shares: [f64; 2],
    share_sigma: f64,
    rate_walk: f64,
    ln_weight: f64,
}

/// Values of a quantity with their prior log-weights.
struct Nodes {
    values: Vec<(f64, f64)>,
    /// In the logarithm.
    distance: f64,
}

/// Most members of a bank: those of a sensor of which nothing is known.
pub(super) const MAX_MEMBERS: usize = 4_096;

impl FilterBank {
    /// Whether a bank may have these members.
    pub(super) fn is_sound(&self) -> bool {
        !self.members.is_empty() && self.members.len() <= MAX_MEMBERS
    }

    /// At the last instant of rest. `sigma` is the noise of a reading.
    pub(super) fn new(dynamics: &SensorDynamics, start: &StepStart, sigma: f64) -> Self {
        let change = start.change.abs().max(MIN_CHANGE_SIGMAS * sigma);
        let steps = STEP_SCALES.map(|scale| scale * change);
        let hypotheses = hypotheses(dynamics);
        let members = hypotheses.iter().flat_map(|hypothesis| steps.map(|step| Member::new(hypothesis, start, step)));
        let mut members: Vec<Member> = members.collect();
        let ln_sum = members.iter().map(|member| member.ln_weight.exp()).sum::<f64>().ln();
        for member in &mut members {
            member.ln_weight -= ln_sum;
        }
        let drift = Drift::new(start, change / start.duration_s);
        Self { members, drift, level: start.level.mean, elapsed_s: 0.0 }
    }

    /// Predicts the reading at an instant, in seconds since the start; `noise_variance` is that of a reading.
    pub(super) fn predict(&mut self, at_s: f64, noise_variance: f64) -> MeanVariance {
        let dt_s = at_s - self.elapsed_s;
        self.elapsed_s = at_s;
        for member in &mut self.members {
            member.predict(dt_s);
        }
        self.drift.predict(dt_s, at_s);
        self.mixture(|member| {
            let expected = member.expected();
            MeanVariance { variance: expected.variance + noise_variance, ..expected }
        })
    }

    /// Uses a reading of the instant that was predicted last.
    pub(super) fn update(&mut self, reading: f64, noise_variance: f64) {
        for member in &mut self.members {
            member.update(reading, noise_variance);
        }
        self.drift.update(reading, noise_variance);
        let best = self.members.iter().map(|member| member.ln_weight).fold(f64::NEG_INFINITY, f64::max);
        for member in &mut self.members {
            member.ln_weight -= best;
        }
        self.drift.ln_weight -= best;
        self.members.retain(|member| member.ln_weight > DROPPED_LN_WEIGHT);
        self.members.shrink_to(2 * self.members.len());
    }

    /// Whether no hypothesis is left: the readings contradict all of them beyond what numbers can say.
    pub(super) fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    pub(super) fn final_value(&self) -> MeanVariance {
        let found = self.mixture(|member| member.value_of(FINAL_VALUE));
        let creep = CREEP_SHARE * (found.mean - self.level);
        MeanVariance { variance: found.variance + creep * creep, ..found }
    }

    /// What is left of the transient.
    pub(super) fn remainder(&self) -> f64 {
        self.mixture(|member| member.value_of(TRANSIENTS[0])).mean + self.mixture(|m| m.value_of(TRANSIENTS[1])).mean
    }

    /// Time since the start over the slower time constant.
    pub(super) fn elapsed_lags(&self) -> f64 {
        let rate = self.mixture(|member| MeanVariance { mean: member.rate_per_s(0), variance: 0.0 });
        self.elapsed_s * rate.mean
    }

    /// Probability that the reading changes without an end.
    pub(super) fn drift_probability(&self) -> f64 {
        let members: f64 = self.members.iter().map(|member| member.ln_weight.exp()).sum();
        // The weight of the best member is 1; a drift that is very much likelier has the probability 1.
        let drift = self.drift.ln_weight.min(100.0).exp();
        drift / (drift + members)
    }

    /// From the start to the final value.
    pub(super) fn step(&self) -> f64 {
        self.final_value().mean - self.level
    }

    /// Mean and variance of a quantity that every member has, over all hypotheses.
    fn mixture(&self, of: impl Fn(&Member) -> MeanVariance) -> MeanVariance {
        let weighted = self.members.iter().map(|member| (member.ln_weight.exp(), of(member)));
        let (mut sum, mut first, mut second) = (0.0, 0.0, 0.0);
        for (weight, MeanVariance { mean, variance }) in weighted {
            // From the level, so that the square of a mean loses no digits.
            let off = mean - self.level;
            sum += weight;
            first += weight * off;
            second += weight * (variance + off * off);
        }
        let off = first / sum;
        MeanVariance { mean: self.level + off, variance: (second / sum - off * off).max(0.0) }
    }
}

/// The nodes of the bank; equal weights where nothing is known.
fn hypotheses(dynamics: &SensorDynamics) -> Vec<Hypothesis> {
    let lags = match dynamics.slow_lag {
        SlowLag::Unknown => {
            let count = ((MAX_TIME_CONSTANT_S / MIN_TIME_CONSTANT_S).ln() / LN_TAU_STEP).ceil() as u32;
            let lag_s = |k: u32| MIN_TIME_CONSTANT_S * (LN_TAU_STEP * f64::from(k)).exp();
            Nodes { values: (0..=count).map(|k| (lag_s(k), 0.0)).collect(), distance: LN_TAU_STEP }
        }
        SlowLag::Known(lag) => Nodes::around(lag, LAG_SIGMAS, LN_TAU_STEP),
    };
    let ratios = Nodes::around(dynamics.lag_ratio, RATIO_SIGMAS, LN_RATIO_STEP);
    let rate_sigmas = [0.5 * lags.distance, 0.5 * ratios.distance];
    let ratio_sum: f64 = ratios.values.iter().map(|(_, ln_weight)| ln_weight.exp()).sum();
    let single = dynamics.single_lag_probability;
    let mut all = Vec::with_capacity(lags.values.len() * RATE_WALKS.len() * (ratios.values.len() + 1));
    for &(slow_lag_s, of_lag) in &lags.values {
        for (rate_walk, of_walk) in RATE_WALKS {
            let of_lag = of_lag + of_walk.ln();
            if single > 0.0 {
                all.push(Hypothesis {
                    slow_lag_s,
                    ratio: dynamics.lag_ratio.median,
                    rate_sigmas,
                    shares: [1.0, 0.0],
                    share_sigma: SINGLE_LAG_SHARE_SIGMA * rate_walk,
                    rate_walk,
                    ln_weight: of_lag + single.ln(),
                });
            }
            all.extend(ratios.values.iter().map(|&(ratio, of_ratio)| Hypothesis {
                slow_lag_s,
                ratio: ratio.max(MIN_LAG_RATIO),
                rate_sigmas,
                shares: [1.0 - dynamics.fast_share, dynamics.fast_share],
                share_sigma: dynamics.fast_share_sigma,
                rate_walk,
                ln_weight: of_lag + (1.0 - single).ln() + of_ratio - ratio_sum.ln(),
            }));
        }
    }
    all
}

impl Nodes {
    /// Around the median, at most `distance` apart in the logarithm.
    fn around(of: LogNormal, sigmas: f64, distance: f64) -> Self {
        let reach = sigmas * of.ln_sigma;
        // Not one more by a rounding error; a single node for a quantity that is exactly known.
        let count = (reach / distance - 1e-9).ceil().max(0.0) as i32;
        let node = |k: i32| {
            let share = if count > 0 { f64::from(k) / f64::from(count) } else { 0.0 };
            let z = sigmas * share;
            (of.median * (share * reach).exp(), -0.5 * z * z)
        };
        Self { values: (-count..=count).map(node).collect(), distance: reach / f64::from(count.max(1)) }
    }
}

impl Drift {
    fn new(start: &StepStart, slope_sigma: f64) -> Self {
        let odds: f64 = DRIFT_PROBABILITY / (1.0 - DRIFT_PROBABILITY);
        Self {
            mean: SVector::from([start.level.mean, 0.0]),
            covariance: SMatrix::from_diagonal(&SVector::from([start.level.variance, slope_sigma * slope_sigma])),
            ln_weight: odds.ln(),
        }
    }

    /// To an instant `at_s` after the start.
    fn predict(&mut self, dt_s: f64, at_s: f64) {
        let f = SMatrix::<f64, 2, 2>::new(1.0, dt_s, 0.0, 1.0);
        self.mean = f * self.mean;
        self.covariance = f * self.covariance * f.transpose();
        let share = if at_s > 0.0 { dt_s / at_s } else { 0.0 };
        self.covariance[(1, 1)] += (SLOPE_WALK * self.mean[1]).powi(2) * share;
    }

    fn update(&mut self, reading: f64, variance: f64) {
        let innovation = reading - self.mean[0];
        let measurement = ScalarMeasurement { innovation, rows: [0], jacobian: [1.0], variance };
        let outcome = use_scalar(&mut self.mean, &mut self.covariance, &measurement, f64::INFINITY);
        self.ln_weight -= 0.5 * (outcome.innovation_variance.ln() + outcome.nis);
    }
}

impl Member {
    /// `step_sigma` is D.
    fn new(hypothesis: &Hypothesis, start: &StepStart, step_sigma: f64) -> Self {
        // Columns: the step, the error of the level, the shares' errors, the rates' errors.
        let mut root = SMatrix::<f64, STATES, 6>::zeros();
        root[(FINAL_VALUE, 0)] = step_sigma;
        for (j, row) in TRANSIENTS.into_iter().enumerate() {
            root[(row, 0)] = -hypothesis.shares[j] * step_sigma;
            root[(row, 1)] = hypothesis.shares[j] * start.level.variance.sqrt();
            root[(row, 2 + j)] = hypothesis.share_sigma * step_sigma;
        }
        root[(RATE_ERRORS[0], 4)] = hypothesis.rate_sigmas[0];
        root[(RATE_ERRORS[1], 5)] = hypothesis.rate_sigmas[1];
        let mut mean = SVector::zeros();
        mean[FINAL_VALUE] = start.level.mean;
        let slow_rate = hypothesis.slow_lag_s.recip();
        Self {
            rates_per_s: [slow_rate, slow_rate * hypothesis.ratio],
            rate_walk: hypothesis.rate_walk,
            mean,
            covariance: root * root.transpose(),
            ln_weight: hypothesis.ln_weight,
        }
    }

    fn rate_per_s(&self, j: usize) -> f64 {
        let error = self.mean[RATE_ERRORS[j]].clamp(-MAX_RATE_ERROR, MAX_RATE_ERROR);
        self.rates_per_s[j] * error.exp()
    }

    fn predict(&mut self, dt_s: f64) {
        let elapsed = [self.rate_per_s(0) * dt_s, self.rate_per_s(1) * dt_s];
        let mut f = SMatrix::<f64, STATES, STATES>::identity();
        for j in 0..2 {
            let (row, error) = (TRANSIENTS[j], RATE_ERRORS[j]);
            let kept = (-elapsed[j]).exp();
            self.mean[row] *= kept;
            f[(row, row)] = kept;
            f[(row, error)] = -elapsed[j] * self.mean[row];
        }
        self.covariance = f * self.covariance * f.transpose();
        for (row, elapsed) in RATE_ERRORS.into_iter().zip(elapsed) {
            self.covariance[(row, row)] += self.rate_walk * self.rate_walk * elapsed;
        }
    }

    fn update(&mut self, reading: f64, noise_variance: f64) {
        let measurement = Self::measurement(reading - self.expected().mean, noise_variance);
        let outcome = use_scalar(&mut self.mean, &mut self.covariance, &measurement, f64::INFINITY);
        self.ln_weight -= 0.5 * (outcome.innovation_variance.ln() + outcome.nis);
    }

    /// The reading without its noise.
    fn expected(&self) -> MeanVariance {
        let variance = Self::measurement(0.0, 0.0).innovation_variance(&self.covariance);
        MeanVariance { mean: self.mean[0] + self.mean[1] + self.mean[2], variance }
    }

    fn value_of(&self, row: usize) -> MeanVariance {
        MeanVariance { mean: self.mean[row], variance: self.covariance[(row, row)] }
    }

    /// y = u + x_1 + x_2.
    const fn measurement(innovation: f64, variance: f64) -> ScalarMeasurement<3> {
        ScalarMeasurement {
            innovation,
            rows: [FINAL_VALUE, TRANSIENTS[0], TRANSIENTS[1]],
            jacobian: [1.0; 3],
            variance,
        }
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Celsius, Observation, ObservationKind, SensorId, TimeDelta, Timestamp};

    use super::*;
    use crate::filter::Filter;
    use crate::filters::dynamic::DynamicFilter;
    use crate::models::dynamic_measurement::DynamicModel;

    const START: StepStart =
        StepStart { level: MeanVariance { mean: 20.0, variance: 1e-4 }, change: 5.0, duration_s: 3.0 };

    fn hypothesis() -> Hypothesis {
        let (slow_lag_s, ratio, shares) = (22.0, 4.0, [0.7, 0.3]);
        let rate_sigmas = [0.15, 0.3];
        Hypothesis { slow_lag_s, ratio, rate_sigmas, shares, share_sigma: 0.2, rate_walk: 0.0, ln_weight: 0.0 }
    }

    #[test]
    fn a_member_that_knows_its_rates_is_the_filter_of_the_paper() {
        let (sensor, wide_k, noise_k) = (SensorId::THERMOMETER, 1e4, 0.1);
        let mut config = crate::filter::tests::config();
        config.noise.temperature_k = noise_k;
        let model = DynamicModel::empty().with_lags(sensor, 1.0, &[22.0, 5.5]).unwrap();
        let mut paper = DynamicFilter::with_model(&config, model).with_prior_sigma(wide_k);
        let mut member = Member::new(&hypothesis(), &START, 1.0);
        member.covariance = SMatrix::zeros();
        for row in [FINAL_VALUE, TRANSIENTS[0], TRANSIENTS[1]] {
            member.covariance[(row, row)] = wide_k * wide_k;
        }
        for (k, shown) in [21.0, 24.1, 26.8, 29.5, 31.9, 33.6, 35.9, 37.1].into_iter().enumerate() {
            let at_s = 1.7 * k as f64;
            member.predict(if k == 0 { 0.0 } else { 1.7 });
            member.update(shown, noise_k * noise_k);
            paper.observe(&Observation {
                sensor,
                stamp: Timestamp::from_secs_f64(at_s),
                stamp_sigma: TimeDelta::ZERO,
                measurement: ObservationKind::Temperature(Celsius(shown)),
            });
            let theirs = paper.scalar_at(Timestamp::from_secs_f64(at_s)).unwrap();
            let ours = member.value_of(FINAL_VALUE);
            // After three readings the prior is forgotten.
            if k >= 3 {
                assert!((ours.mean - theirs.value).abs() < 1e-3 * theirs.sigma, "{k}: {ours:?} {theirs:?}");
                assert!((ours.variance.sqrt() / theirs.sigma - 1.0).abs() < 1e-3, "{k}: {ours:?} {theirs:?}");
            }
        }
    }

    /// The covariance after a prediction, against central differences of the prediction of the mean.
    #[test]
    fn a_prediction_is_linearised_as_its_differences_say() {
        let mut middle = Member::new(&hypothesis(), &START, 30.0);
        middle.mean = SVector::from([50.0, -20.0, -9.0, 0.1, -0.2]);
        let mut difference = SMatrix::<f64, STATES, STATES>::zeros();
        for column in 0..STATES {
            let at = |step: f64| {
                let mut moved = middle.clone();
                moved.mean[column] += step;
                moved.predict(3.0);
                moved.mean
            };
            let h = 1e-5;
            difference.set_column(column, &((at(h) - at(-h)) / (2.0 * h)));
        }
        let expected = difference * middle.covariance * difference.transpose();
        middle.predict(3.0);
        assert!((middle.covariance - expected).amax() < 1e-6 * expected.amax(), "{}", middle.covariance);
    }

    #[test]
    fn the_start_is_known_and_the_shares_add_up_to_the_step() {
        let mut certain = hypothesis();
        certain.share_sigma = 0.0;
        let member = Member::new(&certain, &START, 30.0);
        let expected = member.expected();
        assert_eq!(expected.mean, 20.0);
        // Only the level itself is uncertain.
        assert!((expected.variance - 1e-4).abs() < 1e-9, "{expected:?}");
    }

    /// However well a step is known, sensors creep by a hundredth of it.
    #[test]
    fn the_final_value_is_never_known_better_than_to_a_hundredth_of_the_step() {
        let mut bank = FilterBank::new(&SensorDynamics::UNKNOWN, &START, 0.01);
        for k in 1..=400 {
            let at_s = f64::from(k);
            bank.predict(at_s, 1e-4);
            bank.update(50.0 - 30.0 * (-at_s / 22.0).exp(), 1e-4);
        }
        let found = bank.final_value();
        assert!((found.mean - 50.0).abs() < 0.01, "{found:?}");
        assert!((found.variance.sqrt() - 0.3).abs() < 0.01, "{found:?}");
    }
}

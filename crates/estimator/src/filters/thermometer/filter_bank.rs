//! A thermometer with unknown dynamics: recursive least squares for each node of a grid of time constants, weighted by
//! the readings, and interpolated in ln tau, because the readings soon know tau a hundred times better than the grid
//! does.
//!
//! ```text
//! at rest       y = u + noise
//! one lag       y = u + a e^(-t / tau) + noise
//! two lags      y = u + a e^(-t / tau) + b e^(-4 t / tau) + noise
//! prior         u ~ N(first reading, (50 K)^2)       a, b ~ N(0, (50 K)^2)       ln tau uniform over 1 s .. 1097 s
//! J(ln tau)     = sum of ln S_k + nu_k^2 / (kappa^2 S_k)          by the innovations nu_k of the fit: minus twice its log-evidence
//! p(ln tau)     ~ exp(-J / 2)            weight of a kind ~ integral of p over ln tau
//! ```
//! The faster of two lags is a quarter of the slower (a DS18B20 in its sleeve has 5.3 s and 22 s); its share is free.
//!
//! Source: Paper 2 (Markovsky), least squares; docs/lab/thermometer.md, sections M2 and M7.

use nalgebra::{SMatrix, SVector};

use crate::update::{ScalarMeasurement, use_scalar};

/// Rows of a fit: the final value and the amplitudes of both lags.
const ROWS: usize = 3;
const FINAL_VALUE: usize = 0;
/// The fastest time constant; a faster sensor needs no prediction.
const MIN_TIME_CONSTANT_S: f64 = 1.0;
/// Distance of two nodes in ln tau, small enough for cubic interpolation through four nodes.
const LN_TAU_STEP: f64 = 0.1;
/// Nodes up to e^7 s = 1097 s. The thermometer of paper 2 has 148 s.
const NODE_COUNT: usize = 71;
/// The slower of two lags over the faster.
const LAG_RATIO: i32 = 4;
/// Prior sigma of the difference between the bath and the first reading.
const PRIOR_SIGMA_K: f64 = 50.0;
/// Points at which the posterior of ln tau is evaluated.
const QUADRATURE_POINTS: usize = 48;
/// Number of times that the interval of these points is narrowed.
const REFINEMENT_ROUNDS: usize = 3;
/// Beyond this rise of J the density is below a hundredth of its peak and is left out.
const MAX_COST_RISE: f64 = 9.2;
/// A kind of sensor with less weight is left out: a 95 % bound does not need it, and its variance is large.
const MIN_WEIGHT: f64 = 0.01;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MeanVariance {
    pub(super) mean: f64,
    pub(super) variance: f64,
}

#[derive(Clone, Debug)]
pub(super) struct FilterBank {
    hypotheses: [ResponseHypothesis; 3],
    /// Normalised, zero below [`LEAST_WEIGHT`].
    weights: [f64; 3],
    variance: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ResponseShape {
    AtRest,
    OneLag,
    TwoLags,
}

/// One kind of sensor over the grid of time constants.
#[derive(Clone, Debug)]
struct ResponseHypothesis {
    shape: ResponseShape,
    nodes: Vec<TimeConstantNode>,
    /// Places on the grid with their density; the densities sum up to 1.
    points: [(f64, f64); QUADRATURE_POINTS],
    log_evidence: f64,
}

#[derive(Clone, Copy, Debug)]
struct TimeConstantNode {
    tau_s: f64,
    mean: SVector<f64, ROWS>,
    covariance: SMatrix<f64, ROWS, ROWS>,
    /// Sum of ln S.
    volume: f64,
    /// Sum of the squared innovations over S.
    misfit: f64,
    /// H at the predicted instant.
    row: [f64; ROWS],
    expected: MeanVariance,
}

impl FilterBank {
    pub(super) fn new(sigma_k: f64) -> Self {
        let hypotheses =
            [ResponseShape::AtRest, ResponseShape::OneLag, ResponseShape::TwoLags].map(ResponseHypothesis::new);
        Self { hypotheses, weights: [0.0; 3], variance: sigma_k * sigma_k }
    }

    /// Restarts at a first reading, which is then used like any other.
    pub(super) fn restart(&mut self, reading: f64) {
        for kind in &mut self.hypotheses {
            kind.restart(reading);
        }
    }

    /// Predicts the reading at an instant, in seconds since the start, with the weights after the last used reading.
    pub(super) fn predict(&mut self, at_s: f64) -> MeanVariance {
        for kind in &mut self.hypotheses {
            for node in &mut kind.nodes {
                node.predict(kind.shape, at_s, self.variance);
            }
        }
        self.mixture(|node| node.expected.mean, |node| node.expected.variance)
    }

    /// Uses a reading of the instant that was predicted last. `inflation` is the factor on the configured variance.
    pub(super) fn update(&mut self, reading: f64, inflation: f64) {
        for kind in &mut self.hypotheses {
            for node in &mut kind.nodes {
                node.update(reading, self.variance);
            }
            kind.update_evidence(inflation);
        }
        let best = self.hypotheses.iter().map(|kind| kind.log_evidence).fold(f64::NEG_INFINITY, f64::max);
        let raw: [f64; 3] = std::array::from_fn(|index| (self.hypotheses[index].log_evidence - best).exp());
        let sum: f64 = raw.iter().sum();
        let retained = raw.map(|weight| if weight < MIN_WEIGHT * sum { 0.0 } else { weight });
        let sum: f64 = retained.iter().sum();
        self.weights = retained.map(|weight| weight / sum);
    }

    /// The final value, with the variance by the configured noise times `inflation`.
    pub(super) fn final_value(&self, inflation: f64) -> MeanVariance {
        self.mixture(|node| node.mean[FINAL_VALUE], |node| inflation * node.covariance[(FINAL_VALUE, FINAL_VALUE)])
    }

    /// Mean and variance of a quantity that every node has, over all kinds and time constants.
    fn mixture(
        &self,
        mean_of: impl Fn(&TimeConstantNode) -> f64,
        variance_of: impl Fn(&TimeConstantNode) -> f64,
    ) -> MeanVariance {
        let over = |of: &dyn Fn(&ResponseHypothesis, f64) -> f64| -> f64 {
            let kinds = self.hypotheses.iter().zip(self.weights);
            let kinds = kinds.filter(|(_, weight)| *weight > 0.0);
            let parts = kinds.map(|(kind, weight)| {
                let points = kind.points.iter().filter(|(_, density)| *density > 0.0);
                let sum: f64 = points.map(|(at, density)| density * of(kind, *at)).sum();
                weight * sum
            });
            parts.sum()
        };
        let mean = over(&|kind, at| kind.interpolate(at, &mean_of));
        let variance = over(&|kind, at| {
            let off = kind.interpolate(at, &mean_of) - mean;
            kind.interpolate(at, &variance_of).max(0.0) + off * off
        });
        MeanVariance { mean, variance }
    }
}

impl ResponseHypothesis {
    fn new(shape: ResponseShape) -> Self {
        let count = if shape == ResponseShape::AtRest { 1 } else { NODE_COUNT };
        let nodes =
            (0..count).map(|index| TimeConstantNode::new(MIN_TIME_CONSTANT_S * (LN_TAU_STEP * index as f64).exp()));
        Self { shape, nodes: nodes.collect(), points: [(0.0, 0.0); QUADRATURE_POINTS], log_evidence: 0.0 }
    }

    fn restart(&mut self, reading: f64) {
        let free: &[usize] = match self.shape {
            ResponseShape::AtRest => &[FINAL_VALUE],
            ResponseShape::OneLag => &[FINAL_VALUE, 1],
            ResponseShape::TwoLags => &[FINAL_VALUE, 1, 2],
        };
        for node in &mut self.nodes {
            *node = TimeConstantNode::new(node.tau_s);
            node.mean[FINAL_VALUE] = reading;
            for &row in free {
                node.covariance[(row, row)] = PRIOR_SIGMA_K * PRIOR_SIGMA_K;
            }
        }
    }

    /// Locates the density of ln tau, and computes the evidence of this kind of sensor.
    fn update_evidence(&mut self, inflation: f64) {
        let minus_twice_log = |node: &TimeConstantNode| node.volume + node.misfit / inflation;
        let last = (self.nodes.len() - 1) as f64;
        let (mut low, mut high) = (0.0, last);
        let mut least = f64::INFINITY;
        for _ in 0..REFINEMENT_ROUNDS {
            let step = (high - low) / (QUADRATURE_POINTS - 1) as f64;
            for (index, point) in self.points.iter_mut().enumerate() {
                point.0 = low + step * index as f64;
            }
            for index in 0..QUADRATURE_POINTS {
                let at = self.points[index].0;
                self.points[index].1 = self.interpolate(at, &minus_twice_log);
            }
            least = self.points.iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
            let mut near = self.points.iter().filter(|point| point.1 <= least + MAX_COST_RISE);
            let first_near = near.next().map_or(low, |point| point.0);
            let last_near = near.next_back().map_or(first_near, |point| point.0);
            low = (first_near - step).max(0.0);
            high = (last_near + step).min(last);
        }
        for point in &mut self.points {
            let rise = point.1 - least;
            point.1 = if rise <= MAX_COST_RISE { (-0.5 * rise).exp() } else { 0.0 };
        }
        let sum: f64 = self.points.iter().map(|point| point.1).sum();
        let range_s = self.points[QUADRATURE_POINTS - 1].0 - self.points[0].0;
        // The share of the whole grid under the density's peak; a single node is all of its grid.
        let share = if last > 0.0 { sum * range_s / ((QUADRATURE_POINTS - 1) as f64 * last) } else { 1.0 };
        self.log_evidence = -0.5 * least + share.max(f64::MIN_POSITIVE).ln();
        for point in &mut self.points {
            point.1 /= sum;
        }
    }

    /// Cubic interpolation through the four nodes around a place on the grid.
    fn interpolate(&self, at: f64, of: &impl Fn(&TimeConstantNode) -> f64) -> f64 {
        let most = self.nodes.len().saturating_sub(4);
        let first = (at.floor() as usize).saturating_sub(1).min(most);
        match self.nodes.get(first..first + 4) {
            Some([a, b, c, d]) => {
                let s = at - first as f64;
                let (s1, s2, s3) = (s - 1.0, s - 2.0, s - 3.0);
                0.5 * (s * s2 * s3 * of(b) - s * s1 * s3 * of(c)) + (s * s1 * s2 * of(d) - s1 * s2 * s3 * of(a)) / 6.0
            }
            _ => self.nodes.first().map_or(0.0, of),
        }
    }
}

impl TimeConstantNode {
    fn new(tau_s: f64) -> Self {
        Self {
            tau_s,
            mean: SVector::zeros(),
            covariance: SMatrix::zeros(),
            volume: 0.0,
            misfit: 0.0,
            row: [1.0, 0.0, 0.0],
            expected: MeanVariance { mean: 0.0, variance: 0.0 },
        }
    }

    fn predict(&mut self, shape: ResponseShape, at_s: f64, noise_variance: f64) {
        let left = match shape {
            ResponseShape::AtRest => 0.0,
            ResponseShape::OneLag | ResponseShape::TwoLags => (-at_s / self.tau_s).exp(),
        };
        let of_faster = match shape {
            ResponseShape::AtRest | ResponseShape::OneLag => 0.0,
            ResponseShape::TwoLags => left.powi(LAG_RATIO),
        };
        self.row = [1.0, left, of_faster];
        let mean = (0..ROWS).map(|i| self.row[i] * self.mean[i]).sum();
        let variance = self.scalar(0.0, noise_variance).innovation_variance(&self.covariance);
        self.expected = MeanVariance { mean, variance };
    }

    fn update(&mut self, reading: f64, noise_variance: f64) {
        let scalar = self.scalar(reading - self.expected.mean, noise_variance);
        let outcome = use_scalar(&mut self.mean, &mut self.covariance, &scalar, f64::INFINITY);
        self.volume += outcome.innovation_variance.ln();
        self.misfit += outcome.nis;
    }

    fn scalar(&self, innovation: f64, variance: f64) -> ScalarMeasurement<ROWS> {
        ScalarMeasurement { innovation, rows: [0, 1, 2], jacobian: self.row, variance }
    }
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Celsius, Observation, ObservationKind, SensorId, TimeDelta, Timestamp};

    use super::*;
    use crate::filter::Filter;
    use crate::filters::dynamic::DynamicFilter;
    use crate::models::dynamic_measurement::DynamicModel;

    /// Readings twice a second of a sensor with this response, from 20 degrees towards 50, without noise.
    fn played(left: impl Fn(f64) -> f64, sigma_k: f64, until_s: f64) -> FilterBank {
        let mut bank = FilterBank::new(sigma_k);
        bank.restart(20.0);
        for k in 0..=(2.0 * until_s) as u32 {
            let at_s = 0.5 * f64::from(k);
            bank.predict(at_s);
            bank.update(50.0 - 30.0 * left(at_s), 1.0);
        }
        bank
    }

    #[test]
    fn a_time_constant_between_two_nodes_is_found_much_better_than_the_grid_is_wide() {
        let tau_s = 12.7_f64;
        let bank = played(|t| (-t / tau_s).exp(), 0.01, 25.0);
        let one_lag = &bank.hypotheses[1];
        let at: f64 = one_lag.points.iter().map(|(at, weight)| at * weight).sum();
        let found_s = MIN_TIME_CONSTANT_S * (LN_TAU_STEP * at).exp();
        assert!((found_s / tau_s - 1.0).abs() < 0.002, "{found_s} s");
        let settled = bank.final_value(1.0);
        assert!((settled.mean - 50.0).abs() < 0.05, "{settled:?}");
        assert!(settled.variance.sqrt() < 0.1, "{settled:?}");
    }

    #[test]
    fn a_node_is_the_filter_of_the_paper_with_its_time_constant() {
        let config = crate::filter::tests::config();
        let sensor = SensorId::THERMOMETER;
        let node = 26;
        for (kind, ratios) in [(1, vec![1.0]), (2, vec![1.0, 4.0])] {
            let mut bank = FilterBank::new(0.1);
            bank.restart(21.0);
            let tau_s = bank.hypotheses[kind].nodes[node].tau_s;
            let lags: Vec<f64> = ratios.iter().map(|ratio| tau_s / ratio).collect();
            let model = DynamicModel::empty().with_lags(sensor, 1.0, &lags).unwrap();
            let mut paper = DynamicFilter::with_model(&config, model).with_prior_sigma(PRIOR_SIGMA_K);
            for (k, shown) in [21.0, 24.1, 26.8, 29.5, 31.9, 33.6, 35.9, 37.1].into_iter().enumerate() {
                let at_s = 1.7 * k as f64;
                bank.predict(at_s);
                bank.update(shown, 1.0);
                paper.observe(&Observation {
                    sensor,
                    stamp: Timestamp::from_secs_f64(at_s),
                    stamp_sigma: TimeDelta::ZERO,
                    measurement: ObservationKind::Temperature(Celsius(shown)),
                });
                let theirs = paper.scalar_at(Timestamp::from_secs_f64(at_s)).unwrap();
                let ours = &bank.hypotheses[kind].nodes[node];
                assert!((ours.mean[FINAL_VALUE] - theirs.value).abs() < 1e-6, "{k}");
                let sigma = ours.covariance[(FINAL_VALUE, FINAL_VALUE)].sqrt();
                assert!((sigma / theirs.sigma - 1.0).abs() < 1e-6, "{k}");
            }
        }
    }

    #[test]
    fn two_lags_are_distinguished_from_one() {
        let two = |t: f64| 0.7 * (-t / 20.0).exp() + 0.3 * (-t / 5.0).exp();
        let bank = played(two, 0.02, 30.0);
        assert_eq!(bank.weights[0], 0.0);
        assert!(bank.weights[2] > 0.9, "{:?}", bank.weights);
        let bank = played(|t| (-t / 20.0).exp(), 0.02, 30.0);
        assert!(bank.weights[1] > 0.9, "{:?}", bank.weights);
        let bank = played(|_| 1.0, 0.02, 30.0);
        assert!(bank.weights[0] > 0.9, "at rest: {:?}", bank.weights);
    }

    #[test]
    fn a_cubic_is_interpolated_exactly_up_to_the_ends_of_the_grid() {
        let kind = ResponseHypothesis::new(ResponseShape::OneLag);
        let cubic = |x: f64| 0.3 * x.powi(3) - 2.0 * x * x + x - 7.0;
        let node_value = |node: &TimeConstantNode| cubic((node.tau_s / MIN_TIME_CONSTANT_S).ln() / LN_TAU_STEP);
        for at in [0.0, 0.4, 1.0, 35.7, 68.9, 70.0] {
            let (found, expected) = (kind.interpolate(at, &node_value), cubic(at));
            assert!((found - expected).abs() < 1e-6, "{at}: {found} {expected}");
        }
    }
}

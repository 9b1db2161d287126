//! Noise of a sensor at rest: bias, white noise, quantization and random walk, equation (1) of the parent module.
//!
//! ```text
//! white    s^2 = var v - q^2 / 12: rounding to a step adds the square of the step over twelve
//! bias     the mean; var = var v / n + K^2 T / 3 + h^2 / 2
//! hidden   h = q / pi e^(-2 pi^2 s^2 / q^2): bound of the mean's rounding error, however many readings there are
//! ```
//! Source: B. Widrow, I. Kollár, Quantization Noise (2008), section 4.4 for q^2 / 12, and the first harmonic of the mean of the rounding
//! error of Gaussian noise for h.

use std::f64::consts::PI;

use posebridge_estimator::numerics::quantization::find_quantization_step;
use posebridge_telemetry::{Observation, ObservationKind};

use super::record::{RestError, RestRecord};
use super::white_and_walk::{NoiseDecomposition, decompose_noise};
use crate::recorded_drive::wheels;

/// Noise of a sensor at rest, in its own unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestNoise {
    pub samples: usize,
    pub rest_s: f64,
    pub dt_s: f64,
    /// The mean, on average over the record.
    pub bias: f64,
    /// With the random walk and the rounding error of the mean.
    pub bias_sigma: f64,
    /// Quantization step; `None` if none is detected.
    pub quantum: Option<f64>,
    /// White noise of a sample including its rounding, one standard deviation.
    pub total: f64,
    /// White noise without rounding; zero where rounding alone explains the scatter.
    pub white: f64,
    /// Its standard deviation; where `white` is zero, its upper bound.
    pub white_sigma: f64,
    /// `total` times the root of `dt_s`: angle random walk of a rate.
    pub angle_random_walk: f64,
    /// Random walk of the bias per root of a second, with its standard deviation; `None` if not significant.
    pub walk: Option<(f64, f64)>,
}

impl RestNoise {
    /// The noise to configure in a filter that adds the rounding of `quantum` itself: never zero.
    ///
    /// Its upper bound where rounding hides all other noise.
    pub const fn without_rounding(&self) -> f64 {
        if self.white > 0.0 { self.white } else { self.white_sigma }
    }
}

pub fn noise_at_rest(record: &RestRecord) -> Result<RestNoise, RestError> {
    let found = decompose_noise(record).ok_or(RestError::Silent)?;
    let samples: Vec<f64> = record.readings().collect();
    let dt_s = record.interval_s();
    let n = samples.len() as f64;
    let quantum = find_quantization_step(&samples);
    let (white, white_sigma) = without_rounding(&found, quantum);
    let walk = found.walk_per_step.map(|per_step| {
        let walk = per_step / dt_s.sqrt();
        (walk, walk * found.walk_ln_sigma)
    });
    let walked2 = walk.map_or(0.0, |(walk, _)| walk * walk * n * dt_s / 3.0);
    let hidden2 = quantum.map_or(0.0, |quantum| quantization_floor(quantum, white).powi(2) / 2.0);
    Ok(RestNoise {
        samples: samples.len(),
        rest_s: record.rest_s(),
        dt_s,
        bias: samples.iter().sum::<f64>() / n,
        bias_sigma: (found.white * found.white / n + walked2 + hidden2).sqrt(),
        quantum,
        total: found.white,
        white,
        white_sigma,
        angle_random_walk: found.white * dt_s.sqrt(),
        walk,
    })
}

fn without_rounding(found: &NoiseDecomposition, quantum: Option<f64>) -> (f64, f64) {
    let rounding2 = quantum.map_or(0.0, |quantum| quantum * quantum / 12.0);
    let white = (found.white * found.white - rounding2).max(0.0).sqrt();
    // d white = total / white d total
    let sigma = if white > 0.0 { found.white_sigma * found.white / white } else { found.white };
    (white, sigma)
}

/// h of the module's formulas.
fn quantization_floor(quantum: f64, white: f64) -> f64 {
    quantum / PI * (-2.0 * (PI * white / quantum).powi(2)).exp()
}

// The intervals at rest of a drive, with the readings of gyro and accelerometers in them; docs/lab/calibration.md, section 5.

/// Duration without counter changes after which a robot counts as standing.
pub const MIN_STANDSTILL_S: f64 = 0.4;

/// Intervals of rest in time order, each of (timestamp in s, reading in SI).
pub type RestIntervals = Vec<Vec<(f64, f64)>>;

/// The readings of gyro, left and right accelerometer at which no wheel had moved for [`MIN_STANDSTILL_S`] and none moved before the
/// next wheel reading.
///
/// Observations must be in the order of their timestamps. Without wheel readings nothing counts as rest.
pub fn readings_at_rest(observations: &[Observation]) -> [RestIntervals; 3] {
    let seconds = |observation: &Observation| observation.stamp.as_secs_f64();
    let mut channels = [const { Vec::new() }; 3];
    for (from_s, until_s) in rest_intervals(observations) {
        let first = observations.partition_point(|one| seconds(one) <= from_s);
        let rest = observations.iter().skip(first).take_while(|one| seconds(one) <= until_s);
        let mut interval = [const { Vec::new() }; 3];
        for observation in rest {
            for (readings, value) in interval.iter_mut().zip(sensor_readings(&observation.measurement)) {
                readings.extend(value.filter(|value| value.is_finite()).map(|value| (seconds(observation), value)));
            }
        }
        for (channel, readings) in channels.iter_mut().zip(interval) {
            channel.extend(Some(readings).filter(|readings| !readings.is_empty()));
        }
    }
    channels
}

pub fn rest_noise(intervals: &[Vec<(f64, f64)>]) -> Result<RestNoise, RestError> {
    noise_at_rest(&RestRecord::from_stretches(intervals)?)
}

fn sensor_readings(observed: &ObservationKind) -> [Option<f64>; 3] {
    if let ObservationKind::TurnRate(rate) = observed {
        [Some(rate.0), None, None]
    } else if let ObservationKind::WheelAccelerations { left, right } = observed {
        [None, Some(left.0), Some(right.0)]
    } else {
        [None; 3]
    }
}

/// Start and end of each interval in which the robot certainly stood, in seconds.
fn rest_intervals(observations: &[Observation]) -> Vec<(f64, f64)> {
    let readings: Vec<_> = wheels(observations).collect();
    let still = readings.chunk_by(|before, after| before.1 == after.1);
    let rests = still.filter_map(|still| Some((still.first()?.0.as_secs_f64(), still.last()?.0.as_secs_f64())));
    rests
        .filter(|(since_s, until_s)| until_s - since_s > MIN_STANDSTILL_S)
        .map(|(since_s, until_s)| (since_s + MIN_STANDSTILL_S, until_s))
        .collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::test_support::{observation, wheels};
    use posebridge_telemetry::{RadiansPerSecond, SensorId};

    fn normal(count: usize, seed: u64) -> Vec<f64> {
        let mut rng = Pcg64::seed_from_u64(seed);
        (0..count).map(|_| StandardNormal.sample(&mut rng)).collect()
    }

    /// Twenty a second.
    fn found(samples: &[f64]) -> Result<RestNoise, RestError> {
        let stamped = samples.iter().enumerate();
        let stamped = stamped.map(|(k, sample)| (0.05 * k as f64, *sample));
        noise_at_rest(&RestRecord::from_stretches(&[stamped.collect()])?)
    }

    #[test]
    fn rounding_is_seen_and_taken_out() {
        let rounded: Vec<f64> = normal(20_000, 5).iter().map(|n| (0.3 + 0.6 * n).round()).collect();
        let found = found(&rounded).unwrap();
        let step = found.quantum.unwrap();
        assert!((step - 1.0).abs() < 1e-9, "{step}");
        assert!((found.white - 0.6).abs() < 3.0 * found.white_sigma + 0.005, "{found:?}");
        assert_eq!(found.without_rounding(), found.white);
        assert!((found.total * found.total - 0.36 - 1.0 / 12.0).abs() < 0.02);
        assert!((found.bias - 0.3).abs() < 3.0 * found.bias_sigma);
        let random_walk = found.total * 0.05_f64.sqrt();
        assert!((found.angle_random_walk - random_walk).abs() < 1e-12);
        assert!((found.rest_s - 999.95).abs() < 1e-6);
    }

    #[test]
    fn a_bias_within_a_step_is_known_to_no_better_than_the_step() {
        // 0.12 steps of noise on a bias of 0.3 steps: five readings of a hundred are not zero.
        let rounded: Vec<f64> = normal(20_000, 8).iter().map(|n| (0.3 + 0.12 * n).round()).collect();
        let found = found(&rounded).unwrap();
        assert!((found.bias - 0.3).abs() > 0.15, "{found:?}");
        assert!((found.bias - 0.3).abs() < 2.0 * found.bias_sigma);
        // Rounding alone scatters more than that.
        assert_eq!(found.white, 0.0);
        assert_eq!(found.without_rounding(), found.total);
    }

    #[test]
    fn fine_values_have_no_step() {
        let found = found(&normal(1_000, 6)).unwrap();
        assert_eq!((found.quantum, found.walk), (None, None));
        assert_eq!(found.white, found.total);
    }

    #[test]
    fn a_sensor_that_says_nothing_has_no_noise() {
        assert_eq!(found(&[0.0; 1_000]), Err(RestError::Silent));
    }

    #[test]
    fn only_what_was_read_while_the_counters_stood_counts() {
        let mut observations = Vec::new();
        for i in 0..300 {
            let angle = if i < 200 { 0.0 } else { f64::from(i) };
            observations.push(wheels(i64::from(i) * 50, angle, angle));
            let rate = if i < 200 { 0.01 } else { 5.0 };
            let rate = rate + 1e-3 * f64::from(i % 2);
            let rate = ObservationKind::TurnRate(RadiansPerSecond(rate));
            observations.push(observation(SensorId::GYRO, i64::from(i) * 50 + 1, rate));
        }
        observations.push(observation(SensorId::GYRO, 20, ObservationKind::TurnRate(RadiansPerSecond(f64::NAN))));
        let rest = rest_noise(&readings_at_rest(&observations)[0]).unwrap();
        assert!((rest.bias - 0.0105).abs() < 1e-5);
        // 9.95 s of standing less the first 0.4 s, one reading each 50 ms.
        assert_eq!(rest.samples, 191);
    }
}

//! Extracts one sensor channel from observations as a time series.
//!
//! ```text
//! speed of a wheel   (phi_k - phi_(k-1)) / (t_k - t_(k-1)) at the middle of the interval      sigma = tick / dt / sqrt(6)
//! ```
//! The mean speed of an interval is that at its middle, to the second order of the interval over the lag. Both readings are rounded
//! down to whole ticks: a difference of two uniform errors.
//!
//! # Sources
//! docs/lab/calibration.md, section 7.

use posebridge_telemetry::{DriveGeometry, Observation, ObservationKind, SensorId, SensorNoise};

use super::parameter_uncertainty::Sampling;
use super::{TimedSample, sorted_by_time, sorted_finite};
use crate::statistics::median;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorChannel {
    Temperature,
    LeftWheel,
    RightWheel,
    TurnRate,
    WallRange,
}

impl SensorChannel {
    pub const fn name(self) -> &'static str {
        match self {
            Self::Temperature => "temperature",
            Self::LeftWheel => "left wheel",
            Self::RightWheel => "right wheel",
            Self::TurnRate => "turn rate",
            Self::WallRange => "range",
        }
    }

    pub const fn unit(self) -> &'static str {
        match self {
            Self::Temperature => "°C",
            Self::LeftWheel | Self::RightWheel | Self::TurnRate => "rad/s",
            Self::WallRange => "m",
        }
    }

    /// In time order, by the brick's clock; samples that are not finite or not later than the previous one are omitted.
    pub fn samples(self, observations: &[Observation]) -> Vec<TimedSample> {
        let values: Vec<TimedSample> = self.finite_samples(observations).collect();
        let values = sorted_by_time(&values);
        match self {
            Self::LeftWheel | Self::RightWheel => differences(&values),
            Self::Temperature | Self::TurnRate | Self::WallRange => values,
        }
    }

    /// Number of the sensor's observations that [`Self::samples`] omits.
    pub fn excluded_count(self, observations: &[Observation]) -> usize {
        let values: Vec<TimedSample> = self.finite_samples(observations).collect();
        values.len() - sorted_by_time(&values).len()
    }

    fn finite_samples(self, observations: &[Observation]) -> impl Iterator<Item = TimedSample> {
        observations.iter().filter_map(move |observation| {
            Some(TimedSample { at_s: observation.stamp.as_secs_f64(), value: self.value_of(observation)? })
        })
    }

    pub const fn sampling(self) -> Sampling {
        match self {
            Self::LeftWheel | Self::RightWheel => Sampling::Differences,
            Self::Temperature | Self::TurnRate | Self::WallRange => Sampling::Readings,
        }
    }

    fn value_of(self, observation: &Observation) -> Option<f64> {
        match (self, observation.measurement) {
            (Self::Temperature, ObservationKind::Temperature(temperature)) => {
                // A recording may hold further ones.
                (observation.sensor == SensorId::THERMOMETER).then_some(temperature.0)
            }
            (Self::LeftWheel, ObservationKind::WheelAngles { left, .. }) => Some(left.0),
            (Self::RightWheel, ObservationKind::WheelAngles { right, .. }) => Some(right.0),
            (Self::TurnRate, ObservationKind::TurnRate(rate)) => Some(rate.0),
            (Self::WallRange, ObservationKind::WallRange(range)) => Some(range.0),
            _ => None,
        }
    }

    /// Noise of a sample by the robot's description, else estimated from the samples; `None` where neither is possible.
    pub fn noise(self, noise: &SensorNoise, geometry: &DriveGeometry, samples: &[TimedSample]) -> Option<f64> {
        let described = match self {
            Self::Temperature => noise.temperature_k,
            Self::LeftWheel | Self::RightWheel => wheel_speed_sigma(geometry.tick.0, samples)?,
            Self::TurnRate => noise.gyro_rad_per_s.hypot(noise.gyro_resolution_rad_per_s / 12.0_f64.sqrt()),
            Self::WallRange => noise.wall_range_m,
        };
        let is_usable = described > 0.0 && described.is_finite();
        is_usable.then_some(described).or_else(|| estimate_noise(samples))
    }
}

/// Speeds at the middle of each interval, by the module's formula.
fn differences(angles: &[TimedSample]) -> Vec<TimedSample> {
    let pairs = angles.iter().zip(angles.iter().skip(1));
    pairs
        .map(|(a, b)| TimedSample {
            at_s: f64::midpoint(a.at_s, b.at_s),
            value: (b.value - a.value) / (b.at_s - a.at_s),
        })
        .collect()
}

fn mean_interval_s(samples: &[TimedSample]) -> Option<f64> {
    let (first, last) = (samples.first()?, samples.last()?);
    let dt_s = (last.at_s - first.at_s) / samples.len().checked_sub(1)? as f64;
    (dt_s > 0.0).then_some(dt_s)
}

/// Wheel speed from encoder readings by the module's formula: instants in seconds, angles in radians.
pub fn wheel_speed(readings: &[(f64, f64)]) -> Vec<TimedSample> {
    let angles: Vec<TimedSample> = readings.iter().map(|&(at_s, value)| TimedSample { at_s, value }).collect();
    differences(&sorted_finite(&angles))
}

/// The sigma of such a speed, in rad/s; `None` for fewer than two samples.
pub fn wheel_speed_sigma(tick_rad: f64, samples: &[TimedSample]) -> Option<f64> {
    Some(tick_rad / mean_interval_s(samples)? / 6.0_f64.sqrt())
}

// The noise of a sensor with no configured noise, from how its samples scatter about their neighbours.
//
// ```text
// d_k = y_(k+1) - 2 y_k + y_(k-1)      sigma = median |d_k| / (0.6745 sqrt(6)), at least q / sqrt(12)
// ```
// A second difference is blind to slopes, and the median to the few samples in which the step itself bends. q is the smallest
// difference of two neighbours that differ: what a sensor that rounds cannot do without.
//
// # Assumptions
// Errors of neighbours are independent. Where they are not, the residuals of the fit have the last word
// ([`super::parameter_uncertainty`]).
//
// # Sources
// The 75 % quantile of a Gaussian, and the variance 6 sigma^2 of the weights 1, -2, 1; docs/lab/calibration.md, section 7.

/// 75 % quantile of the standard normal distribution, which is its median absolute value.
const MEDIAN_OF_NORMAL: f64 = 0.674_49;
const MIN_SAMPLES: usize = 8;

/// The sigma above, in the sensor's unit; `None` for too few samples, or if all are equal.
pub fn estimate_noise(samples: &[TimedSample]) -> Option<f64> {
    let samples = sorted_finite(samples);
    if samples.len() < MIN_SAMPLES {
        return None;
    }
    let differences = samples.windows(2).map(|pair| (pair[1].value - pair[0].value).abs());
    let quantum = differences.filter(|difference| *difference > 0.0).fold(f64::INFINITY, f64::min);
    if quantum.is_infinite() {
        return None;
    }
    let bends = samples.windows(3).map(|three| (three[2].value - 2.0 * three[1].value + three[0].value).abs());
    let scatter = median(bends)? / (MEDIAN_OF_NORMAL * 6.0_f64.sqrt());
    Some(scatter.max(quantum / 12.0_f64.sqrt()))
}

#[cfg(test)]
mod tests {
    use posebridge_telemetry::{Celsius, RadiansPerSecond};

    use super::*;
    use crate::identification::step_response::{SimulatedSensor, step_input};
    use crate::test_support::{self, observation};

    fn observed(millis: i64, measurement: ObservationKind) -> Observation {
        observation(SensorId::THERMOMETER, millis, measurement)
    }

    #[test]
    fn each_channel_takes_its_own_in_the_order_of_time() {
        let all = [
            test_support::wheels(0, 0.0, 0.0),
            test_support::wheels(200, 0.5, -0.4),
            test_support::wheels(100, 0.1, 0.0),
            test_support::wheels(100, 7.0, 7.0),
            observed(50, ObservationKind::TurnRate(RadiansPerSecond(0.3))),
            observed(60, ObservationKind::TurnRate(RadiansPerSecond(f64::NAN))),
            observed(70, ObservationKind::Temperature(Celsius(21.0))),
            Observation { sensor: SensorId(77), ..observed(80, ObservationKind::Temperature(Celsius(5.0))) },
        ];
        let left = SensorChannel::LeftWheel.samples(&all);
        let right = SensorChannel::RightWheel.samples(&all);
        assert_eq!(left.len(), 2);
        for (found, (at_s, value)) in left.iter().zip([(0.05, 1.0), (0.15, 4.0)]) {
            assert!((found.at_s - at_s).abs() < 1e-12 && (found.value - value).abs() < 1e-9);
        }
        assert!((right[1].value + 4.0).abs() < 1e-9);
        assert_eq!(SensorChannel::TurnRate.samples(&all).len(), 1);
        assert_eq!(SensorChannel::Temperature.samples(&all).len(), 1);
        assert_eq!(SensorChannel::WallRange.samples(&all), []);
    }

    #[test]
    fn the_noise_is_the_described_one_and_else_that_of_the_samples() {
        let noise = SensorNoise {
            gyro_rad_per_s: 0.03,
            gyro_resolution_rad_per_s: 0.04 * 12.0_f64.sqrt(),
            ..SensorNoise::EXACT
        };
        let geometry = test_support::config([0.05; 2], 0.2, 0.01, SensorNoise::EXACT).geometry;
        let of = |channel: SensorChannel, samples: &[TimedSample]| channel.noise(&noise, &geometry, samples);
        assert!((of(SensorChannel::TurnRate, &[]).unwrap() - 0.05).abs() < 1e-12);
        let readings: Vec<(f64, f64)> = (0..11).map(|k| (0.1 * f64::from(k), 0.0)).collect();
        let samples = wheel_speed(&readings);
        let by_tick = of(SensorChannel::LeftWheel, &samples).unwrap();
        assert!((by_tick - 0.1 / 6.0_f64.sqrt()).abs() < 1e-9);
        assert_eq!(wheel_speed_sigma(0.01, &samples), Some(by_tick));
        assert_eq!(of(SensorChannel::Temperature, &samples), None);
    }

    #[test]
    fn it_is_found_in_spite_of_the_step() {
        let sensor = SimulatedSensor::first_order(5.0, 0.1, 0.1);
        let found = estimate_noise(&sensor.run(1, 800, step_input(20.0, 4.0, 10.0))).unwrap();
        // A median of 800 is known to 4 %.
        assert!((found / 0.1 - 1.0).abs() < 0.12, "{found}");
    }

    #[test]
    fn a_sensor_that_rounds_has_its_last_digit_over_the_root_of_twelve_at_least() {
        let mut sensor = SimulatedSensor::first_order(5.0, 1e-6, 0.5);
        sensor.resolution = 0.0625;
        let found = estimate_noise(&sensor.run(1, 800, step_input(20.0, 4.0, 10.0))).unwrap();
        assert!((found - 0.0625 / 12.0_f64.sqrt()).abs() < 1e-9, "{found}");
    }

    #[test]
    fn samples_that_say_nothing_say_nothing() {
        let still = |count: u32| -> Vec<TimedSample> {
            (0..count).map(|k| TimedSample { at_s: f64::from(k), value: 3.0 }).collect()
        };
        assert_eq!(estimate_noise(&still(100)), None);
        let mut few = still(7);
        few[3].value = 4.0;
        assert_eq!(estimate_noise(&few), None);
    }
}

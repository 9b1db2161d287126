//! Detects intervals at rest and collects the gyro and accelerometer readings in them.
//!
//! [`crate::noise_identification`] evaluates these readings; docs/lab/calibration.md, section 5.

use posebridge_telemetry::{Observation, ObservationKind};

use crate::noise_identification::{RestError, RestNoise, RestRecord, noise_at_rest};
use crate::recorded_drive::wheels;

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
    use super::*;
    use crate::test_support::{observation, wheels};
    use posebridge_telemetry::{RadiansPerSecond, SensorId};

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

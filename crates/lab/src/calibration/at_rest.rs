//! Detects intervals at rest and collects the gyro and accelerometer readings in them.
//!
//! [`crate::noise_identification`] evaluates these readings; docs/lab/calibration.md, section 5.

use posebridge_telemetry::{Observation, ObservationKind};

use crate::noise_identification::{RestError, RestNoise, RestRecord, noise_at_rest};

/// Duration without counter changes after which a robot counts as standing.
pub const MIN_STANDSTILL_S: f64 = 0.4;

/// One channel of a sensor at rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestChannel {
    /// Intervals of rest in time order: (timestamp in s, reading in SI).
    pub stretches: Vec<Vec<(f64, f64)>>,
}

/// The channels of a robot at rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestObservations {
    /// Turn rate, rad/s.
    pub gyro: RestChannel,
    /// Forward acceleration at the left wheel, m/s².
    pub left_accelerometer: RestChannel,
    pub right_accelerometer: RestChannel,
}

impl RestObservations {
    /// Selects the readings at which no wheel had moved for [`MIN_STANDSTILL_S`] and none moved before the next wheel reading.
    ///
    /// Observations must be in the order of their timestamps. Without wheel readings nothing counts as rest.
    pub fn from_observations(observations: &[Observation]) -> Self {
        let mut resting = Self::default();
        for (from_s, until_s) in rest_intervals(observations) {
            let first = observations.partition_point(|one| seconds(one) <= from_s);
            let rest = observations.iter().skip(first);
            let mut stretch = [const { Vec::new() }; 3];
            for observation in rest.take_while(|one| seconds(one) <= until_s) {
                let at_s = seconds(observation);
                for (channel, value) in stretch.iter_mut().zip(sensor_readings(&observation.measurement)) {
                    channel.extend(value.filter(|v| v.is_finite()).map(|v| (at_s, v)));
                }
            }
            let [gyro, left, right] = stretch;
            resting.gyro.add(gyro);
            resting.left_accelerometer.add(left);
            resting.right_accelerometer.add(right);
        }
        resting
    }
}

fn seconds(observation: &Observation) -> f64 {
    observation.stamp.as_secs_f64()
}

/// Gyro, left and right accelerometer.
const fn sensor_readings(observed: &ObservationKind) -> [Option<f64>; 3] {
    match observed {
        ObservationKind::TurnRate(rate) => [Some(rate.0), None, None],
        ObservationKind::WheelAccelerations { left, right } => [None, Some(left.0), Some(right.0)],
        ObservationKind::WheelAngles { .. }
        | ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. }
        | ObservationKind::Fix(_)
        | ObservationKind::Landmark { .. }
        | ObservationKind::BeaconRange { .. }
        | ObservationKind::WallRange(_)
        | ObservationKind::CompassHeading(_)
        | ObservationKind::Temperature(_) => [None; 3],
    }
}

/// Start and end of each interval in which the robot certainly stood, in seconds.
fn rest_intervals(observations: &[Observation]) -> Vec<(f64, f64)> {
    let mut rests = Vec::new();
    let mut last: Option<([f64; 2], f64, f64)> = None;
    for observation in observations {
        let ObservationKind::WheelAngles { left, right } = observation.measurement else {
            continue;
        };
        let at_s = seconds(observation);
        let angles = [left.0, right.0];
        last = match last {
            Some((before, since_s, _)) if before == angles => Some((angles, since_s, at_s)),
            Some((_, since_s, until_s)) => {
                rests.push((since_s, until_s));
                Some((angles, at_s, at_s))
            }
            None => Some((angles, at_s, at_s)),
        };
    }
    rests.extend(last.map(|(_, since_s, until_s)| (since_s, until_s)));
    rests
        .into_iter()
        .filter(|(since_s, until_s)| until_s - since_s > MIN_STANDSTILL_S)
        .map(|(since_s, until_s)| (since_s + MIN_STANDSTILL_S, until_s))
        .collect()
}

impl RestChannel {
    fn add(&mut self, stretch: Vec<(f64, f64)>) {
        if !stretch.is_empty() {
            self.stretches.push(stretch);
        }
    }

    pub fn noise(&self) -> Result<RestNoise, RestError> {
        noise_at_rest(&RestRecord::from_stretches(&self.stretches)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{observation, wheel_angles};
    use posebridge_telemetry::{RadiansPerSecond, SensorId};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    #[test]
    fn only_what_was_read_while_the_counters_stood_counts() {
        let mut observations = Vec::new();
        for i in 0..300 {
            let angle = if i < 200 { 0.0 } else { f64::from(i) };
            observations.push(wheel_angles(i64::from(i) * 50, angle, angle));
            let rate = if i < 200 { 0.01 } else { 5.0 };
            let rate = rate + 1e-3 * f64::from(i % 2);
            let rate = ObservationKind::TurnRate(RadiansPerSecond(rate));
            observations.push(observation(SensorId::GYRO, i64::from(i) * 50 + 1, rate));
        }
        observations.push(observation(SensorId::GYRO, 20, ObservationKind::TurnRate(RadiansPerSecond(f64::NAN))));
        let rest = RestObservations::from_observations(&observations).gyro.noise().unwrap();
        assert!((rest.bias - 0.0105).abs() < 1e-5);
        // 9.95 s of standing less the first 0.4 s, one reading each 50 ms.
        assert_eq!(rest.samples, 191);
    }

    #[test]
    fn a_walking_bias_is_told_from_noise() {
        let mut random = Pcg64::seed_from_u64(5);
        let mut draw = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let (walk, dt_s) = (0.004, 0.05_f64);
        let mut bias = 0.0;
        let readings = (0..40_000).map(|i| {
            bias += walk * dt_s.sqrt() * draw();
            (f64::from(i) * dt_s, bias + 0.01 * draw())
        });
        let channel = RestChannel { stretches: vec![readings.collect()] };
        let (found, sigma) = channel.noise().unwrap().walk.unwrap();
        assert!((found / walk - 1.0).abs() < 0.1, "{found}");
        assert!((found - walk).abs() < 3.0 * sigma, "{found} {sigma}");
    }
}

//! Which sensors of a robot are heard, and whether they agree with its filter, as the bits of SYS_STATUS.
//!
//! Source: common.xml, MAV_SYS_STATUS_SENSOR.

use std::collections::BTreeMap;

use posebridge_telemetry::{FusionOutcome, HostClock, Observation, ObservationKind, SensorId, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use crate::host_times::ShiftHostTimes;

/// A sensor without an observation that was used for this long is not healthy: five heartbeats.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(5_000);

const GYRO: u32 = 1 << 0;
const ACCELEROMETER: u32 = 1 << 1;
const MAGNETOMETER: u32 = 1 << 2;
const GPS: u32 = 1 << 5;
const VISION_POSITION: u32 = 1 << 7;
const RANGE_FINDER: u32 = 1 << 8;
const MOTORS: u32 = 1 << 15;

/// The bit of a sensor in SYS_STATUS. Encoders have none of their own: they count as the motors.
const fn status_bit(sensor: SensorId) -> u32 {
    match sensor {
        SensorId::WHEELS | SensorId::ODOMETER => MOTORS,
        SensorId::GYRO => GYRO,
        SensorId::ACCELEROMETER => ACCELEROMETER,
        SensorId::RANGE => RANGE_FINDER,
        SensorId::COMPASS => MAGNETOMETER,
        SensorId::GNSS => GPS,
        SensorId::THERMOMETER => 0,
        // Cameras, landmarks, beacons.
        SensorId(_) => VISION_POSITION,
    }
}

/// Which sensors of a robot are heard, and whether they agree with its filter.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct SensorHealth {
    /// When an observation of each sensor was last used, if one ever was.
    last_used: BTreeMap<SensorId, Option<Timestamp<HostClock>>>,
    /// A satellite receiver has sent positions: its speeds say nothing of these.
    has_satellite_fix: bool,
}

impl ShiftHostTimes for SensorHealth {
    fn shift_host_times(&mut self, by: TimeDelta) {
        let Self { last_used, has_satellite_fix: _ } = self;
        last_used.shift_host_times(by);
    }
}

impl SensorHealth {
    pub(crate) fn observe(&mut self, now: Timestamp<HostClock>, observation: &Observation, outcome: FusionOutcome) {
        if observation.sensor == SensorId::GNSS {
            let is_fix = matches!(observation.measurement, ObservationKind::Fix(_));
            self.has_satellite_fix |= is_fix;
            if self.has_satellite_fix && !is_fix {
                return;
            }
        }
        let is_used = match outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip | FusionOutcome::PoseReset | FusionOutcome::Rebased => true,
            FusionOutcome::Gated | FusionOutcome::TooOld | FusionOutcome::Malformed | FusionOutcome::Unused => false,
        };
        let last = self.last_used.entry(observation.sensor).or_default();
        *last = if is_used { Some(now) } else { *last };
    }

    pub(crate) fn was_used(&self, sensor: SensorId) -> bool {
        self.last_used.get(&sensor).is_some_and(Option::is_some)
    }

    /// The bits of the sensors that were ever heard, and of those that are heard and used.
    pub(crate) fn bits(&self, now: Timestamp<HostClock>) -> [u32; 2] {
        let mut bits = [0, 0];
        for (sensor, last) in &self.last_used {
            let bit = status_bit(*sensor);
            bits[0] |= bit;
            if last.is_some_and(|last| now - last < MAX_SILENCE) {
                bits[1] |= bit;
            }
        }
        bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Fix, Meters, MetersPerSecond, Point2, PositionCovariance, RadiansPerSecond};

    fn observation(sensor: SensorId, measurement: ObservationKind) -> Observation {
        Observation { sensor, stamp: Timestamp::ZERO, stamp_sigma: TimeDelta::ZERO, measurement }
    }

    fn fix(sensor: SensorId) -> Observation {
        let covariance: Option<PositionCovariance> = None;
        let position = Point2::new(Meters(0.0), Meters(0.0));
        let fix = Fix { position, heading: None, covariance, tag_in_body: Point2::ORIGIN, reset_counter: 0 };
        observation(sensor, ObservationKind::Fix(fix))
    }

    #[test]
    fn a_sensor_is_healthy_while_it_is_used_now_and_then() {
        let at = Timestamp::from_millis;
        let mut health = SensorHealth::default();
        health.observe(at(0), &fix(SensorId::CAMERA), FusionOutcome::Accepted);
        health.observe(at(1_000), &fix(SensorId::CAMERA), FusionOutcome::Gated);
        assert_eq!(health.bits(at(1_000)), [VISION_POSITION; 2], "one outlier");
        for second in 2..=5 {
            health.observe(at(1_000 * second), &fix(SensorId::CAMERA), FusionOutcome::Gated);
        }
        assert_eq!(health.bits(at(5_000)), [VISION_POSITION, 0]);
    }

    #[test]
    fn speeds_do_not_hide_that_the_positions_of_satellites_are_refused() {
        let mut health = SensorHealth::default();
        let speeds = ObservationKind::BodyVelocity { forward: MetersPerSecond(1.0), turn: RadiansPerSecond(0.0) };
        for second in 0..10 {
            let now = Timestamp::from_millis(1_000 * second);
            health.observe(now, &fix(SensorId::GNSS), FusionOutcome::Gated);
            health.observe(now, &observation(SensorId::GNSS, speeds), FusionOutcome::Accepted);
        }
        assert_eq!(health.bits(Timestamp::from_millis(9_000)), [GPS, 0]);
    }
}

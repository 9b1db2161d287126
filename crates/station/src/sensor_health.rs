//! Which sensors of a robot are heard, and whether they agree with its filter, as the bits of SYS_STATUS.
//!
//! Source: common.xml, MAV_SYS_STATUS_SENSOR.

use std::collections::BTreeMap;

use posebridge_telemetry::{FusionOutcome, HostClock, SensorId, TimeDelta, Timestamp};

/// A sensor without an observation for this long is not healthy: five heartbeats.
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
#[derive(Debug, Default)]
pub(crate) struct SensorHealth {
    last: BTreeMap<SensorId, (Timestamp<HostClock>, FusionOutcome)>,
}

impl SensorHealth {
    pub(crate) fn observe(&mut self, now: Timestamp<HostClock>, sensor: SensorId, outcome: FusionOutcome) {
        self.last.insert(sensor, (now, outcome));
    }

    /// The bits of the sensors that were ever heard, and of those that are heard and used.
    pub(crate) fn bits(&self, now: Timestamp<HostClock>) -> [u32; 2] {
        let mut bits = [0, 0];
        for (sensor, (last, outcome)) in &self.last {
            let bit = status_bit(*sensor);
            bits[0] |= bit;
            let is_used = match outcome {
                FusionOutcome::Accepted | FusionOutcome::Slip | FusionOutcome::PoseReset | FusionOutcome::Rebased => {
                    true
                }
                FusionOutcome::Gated | FusionOutcome::TooOld | FusionOutcome::Malformed | FusionOutcome::Unused => {
                    false
                }
            };
            if is_used && now - *last < MAX_SILENCE {
                bits[1] |= bit;
            }
        }
        bits
    }
}

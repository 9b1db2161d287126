//! What ground stations want to know of a vehicle beside its pose: its sensors, its battery, and where on the Earth it is.
//!
//! It is sent with each of the vehicle's heartbeats, unless the robot sends it itself, and on request.
//!
//! Source: common.xml, MAV_SYS_STATUS_SENSOR.

use std::collections::BTreeMap;

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Battery, GlobalReference, Message, SystemStatus, WireStamp};
use posebridge_telemetry::{FusionOutcome, GeodeticOrigin, HostClock, SensorId, TimeDelta, Timestamp};

use crate::robot::Robot;

/// The messages of [`vehicle_status`].
pub(crate) const STATUS_MESSAGES: [u32; 5] =
    [ids::SYS_STATUS, ids::BATTERY_STATUS, ids::EXTENDED_SYS_STATE, ids::HOME_POSITION, ids::GPS_GLOBAL_ORIGIN];

/// A sensor without an observation for this long is not healthy: five heartbeats.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(5_000);

const GYRO: u32 = 1 << 0;
const ACCELEROMETER: u32 = 1 << 1;
const MAGNETOMETER: u32 = 1 << 2;
const GPS: u32 = 1 << 5;
const VISION_POSITION: u32 = 1 << 7;
const RANGE_FINDER: u32 = 1 << 8;
const MOTORS: u32 = 1 << 15;
const AHRS: u32 = 1 << 21;
const BATTERY: u32 = 1 << 25;

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
    fn bits(&self, now: Timestamp<HostClock>) -> [u32; 2] {
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

/// The status of a robot as a vehicle, one message of each kind that is known.
pub(crate) fn vehicle_status(now: Timestamp<HostClock>, robot: &Robot) -> Vec<Message> {
    let [mut sensors_present, mut sensors_healthy] = robot.sensor_health.bits(now);
    sensors_present |= AHRS;
    let has_heading = robot.estimator.latest_estimate().is_some_and(|estimate| estimate.validity.heading);
    sensors_healthy |= if has_heading { AHRS } else { 0 };
    if robot.battery.is_some() {
        sensors_present |= BATTERY;
        sensors_healthy |= BATTERY;
    }
    let battery = robot.battery.unwrap_or_default();
    let mut messages =
        vec![Message::SystemStatus(SystemStatus { sensors_present, sensors_healthy, battery }), Message::OnGround];
    messages.extend(robot.battery.map(Message::BatteryStatus));
    messages.extend(robot.extractor.origin.into_iter().flat_map(|origin| {
        let reference = global_reference(now, &origin);
        [Message::HomePosition(reference), Message::GlobalOrigin(reference)]
    }));
    messages
}

pub(crate) fn global_reference(now: Timestamp<HostClock>, origin: &GeodeticOrigin) -> GlobalReference {
    GlobalReference {
        stamp: WireStamp::Micros64(now.as_micros().unsigned_abs()),
        position: origin.point(),
        altitude: origin.altitude(),
    }
}

/// The id of a status message; `None` for any other.
#[expect(clippy::wildcard_enum_match_arm, reason = "only these are status messages")]
pub(crate) const fn status_message_id(message: &Message) -> Option<u32> {
    Some(match message {
        Message::SystemStatus(_) => ids::SYS_STATUS,
        Message::BatteryStatus(_) => ids::BATTERY_STATUS,
        Message::OnGround => ids::EXTENDED_SYS_STATE,
        Message::HomePosition(_) => ids::HOME_POSITION,
        Message::GlobalOrigin(_) => ids::GPS_GLOBAL_ORIGIN,
        _ => return None,
    })
}

/// The battery in a message of a robot, if there is one.
#[expect(clippy::wildcard_enum_match_arm, reason = "only these know a battery")]
pub(crate) fn battery_of(message: &Message) -> Option<Battery> {
    let battery = match message {
        Message::BatteryStatus(battery) => *battery,
        Message::SystemStatus(status) => status.battery,
        _ => return None,
    };
    (battery != Battery::default()).then_some(battery)
}

//! What ground stations want to know of a vehicle beside its pose: its sensors, its battery, and where on the Earth it is.
//!
//! It is sent with each of the vehicle's heartbeats, unless the robot sends it itself, and on request.
//!
//! Source: common.xml, MAV_SYS_STATUS_SENSOR.

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{Battery, GlobalReference, Message, SystemStatus, WireStamp};
use posebridge_telemetry::{GeodeticOrigin, HostClock, Timestamp};

use crate::robot::Robot;

/// The messages of [`vehicle_status`].
pub(crate) const STATUS_MESSAGES: [u32; 5] =
    [ids::SYS_STATUS, ids::BATTERY_STATUS, ids::EXTENDED_SYS_STATE, ids::HOME_POSITION, ids::GPS_GLOBAL_ORIGIN];

const AHRS: u32 = 1 << 21;
const BATTERY: u32 = 1 << 25;

/// The status of a robot as a vehicle, one message of each kind that is known.
pub(crate) fn vehicle_status(now: Timestamp<HostClock>, robot: &Robot) -> Vec<Message> {
    let [mut sensors_present, mut sensors_healthy] = robot.sensor_health.bits(now);
    sensors_present |= AHRS;
    let has_heading = robot.estimator.latest_estimate().is_some_and(|estimate| estimate.validity.heading);
    sensors_healthy |= if has_heading { AHRS } else { 0 };
    let known_battery = robot.battery.current(now);
    sensors_present |= if robot.battery.is_known() { BATTERY } else { 0 };
    sensors_healthy |= if known_battery.is_some() { BATTERY } else { 0 };
    let battery = known_battery.unwrap_or_default();
    let mut messages =
        vec![Message::SystemStatus(SystemStatus { sensors_present, sensors_healthy, battery }), Message::OnGround];
    messages.extend(known_battery.map(Message::BatteryStatus));
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

//! Which messages contain their time of measurement, so that two of them with the same content are one.
//!
//! A sender counts its frames on each link for itself, so the copies of one message on two links differ in sequence number and
//! checksum. Their payloads are equal. For a message with the sender's time in it that is enough to know the copy again. For
//! others it is not: two heartbeats or two equal commands are two.

use crate::dialect::ids;

/// Messages whose payload holds the sender's time: all kinds of telemetry that are fused here, and the commonest of the others.
/// Source: common.xml (fields time_usec and time_boot_ms), our own dialect (time_us). By rising id.
const TIMESTAMPED_MESSAGES: &[u32] = &[
    ids::SYSTEM_TIME,
    24, // GPS_RAW_INT
    ids::SCALED_IMU,
    27, // RAW_IMU
    28, // RAW_PRESSURE
    ids::SCALED_PRESSURE,
    ids::ATTITUDE,
    31, // ATTITUDE_QUATERNION
    ids::LOCAL_POSITION_NED,
    33,  // GLOBAL_POSITION_INT
    36,  // SERVO_OUTPUT_RAW
    65,  // RC_CHANNELS
    85,  // POSITION_TARGET_LOCAL_NED
    101, // GLOBAL_VISION_POSITION_ESTIMATE
    ids::VISION_POSITION_ESTIMATE,
    103, // VISION_SPEED_ESTIMATE
    104, // VICON_POSITION_ESTIMATE
    ids::HIGHRES_IMU,
    106, // OPTICAL_FLOW_RAD
    116, // SCALED_IMU2
    129, // SCALED_IMU3
    ids::DISTANCE_SENSOR,
    ids::ATT_POS_MOCAP,
    ids::ESTIMATOR_STATUS,
    ids::NAMED_VALUE_FLOAT,
    ids::ODOMETRY,
    ids::DEBUG_FLOAT_ARRAY,
    ids::WHEEL_DISTANCE,
    ids::PB_WHEEL_TICKS,
    ids::PB_INERTIAL,
    ids::PB_PLANAR_POSE,
    ids::PB_FUSION_HEALTH,
];

/// Whether equal payloads of this message are one and the same message.
pub fn has_timestamp(message_id: u32) -> bool {
    TIMESTAMPED_MESSAGES.binary_search(&message_id).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink::dialects::common;
    use mavlink_core::Message;

    #[test]
    fn the_list_can_be_searched() {
        assert!(TIMESTAMPED_MESSAGES.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn every_standard_message_of_the_list_has_a_field_for_the_time() {
        let standard = TIMESTAMPED_MESSAGES.iter().filter(|id| **id < 42_000);
        for id in standard {
            let message = common::MavMessage::default_message_from_id(*id).unwrap();
            let fields = format!("{message:?}");
            let is_stamped = ["time_usec:", "time_boot_ms:", "usec:"].iter().any(|field| fields.contains(field));
            assert!(is_stamped, "{id}: {fields}");
        }
    }

    #[test]
    fn conversation_is_not_stamped() {
        for id in
            [ids::HEARTBEAT, ids::COMMAND_LONG, ids::COMMAND_ACK, ids::TIMESYNC, ids::STATUSTEXT, ids::PARAM_VALUE]
        {
            assert!(!has_timestamp(id), "{id}");
        }
    }
}

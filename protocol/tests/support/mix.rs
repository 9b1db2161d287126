//! A stream made by the `mavlink` crate's encoder, shared by tests and the benchmark.

use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavEstimatorType, MavFrame, MavMessage, MavModeFlag, MavState, MavType,
    ODOMETRY_DATA, SCALED_IMU_DATA, WHEEL_DISTANCE_DATA,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};

/// `count` frames, round robin HEARTBEAT (21 bytes), SCALED_IMU (36), WHEEL_DISTANCE (149), ODOMETRY (245), as the
/// `mavlink` crate writes them.
pub(crate) fn four_message_mix(count: usize) -> Vec<Vec<u8>> {
    (0..count)
        .map(|index| {
            let header = MavHeader { system_id: 1, component_id: 1, sequence: index as u8 };
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.serialize_message(header, &mixed_message(index));
            raw.raw_bytes().to_vec()
        })
        .collect()
}

fn mixed_message(index: usize) -> MavMessage {
    let time = index as u32 * 5;
    let ramp = index as f32 * 0.001;
    match index % 4 {
        0 => MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: time,
            mavtype: MavType::MAV_TYPE_GROUND_ROVER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        }),
        1 => MavMessage::SCALED_IMU(SCALED_IMU_DATA {
            time_boot_ms: time,
            xacc: 12,
            yacc: -7,
            zacc: -1000,
            xgyro: 3,
            ygyro: 2,
            zgyro: index as i16,
            xmag: 100,
            ymag: 200,
            zmag: -300,
            temperature: 2_345,
        }),
        2 => MavMessage::WHEEL_DISTANCE(WHEEL_DISTANCE_DATA {
            time_usec: u64::from(time) * 1_000,
            distance: std::array::from_fn(|wheel| f64::from(ramp) + wheel as f64),
            count: 2,
        }),
        _ => MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: u64::from(time) * 1_000,
            x: ramp,
            y: -ramp,
            z: 0.1,
            q: [0.8, 0.0, 0.0, 0.6],
            vx: 0.3,
            vy: 0.01,
            vz: 0.02,
            rollspeed: 0.001,
            pitchspeed: 0.002,
            yawspeed: 0.5,
            pose_covariance: std::array::from_fn(|index| index as f32 * 0.01 + 0.5),
            velocity_covariance: std::array::from_fn(|index| index as f32 * 0.02 + 0.25),
            frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
            child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
            reset_counter: 1,
            estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VIO,
            quality: 90,
        }),
    }
}

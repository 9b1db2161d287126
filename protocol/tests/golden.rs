//! Frames made by a foreign implementation decode to what they say, and our encoder writes the same bytes.
//!
//! The bytes come from pymavlink (tests/data/README.md). Every value below was written from the definition of the message,
//! not from what our decoder returned.

#![expect(clippy::expect_used, reason = "helpers of tests")]

#[path = "support/golden.rs"]
mod frames;

use std::f64::consts::FRAC_PI_3;

use frames::{check, check_encoding, decode_golden, golden, with_frame};
use posebridge_protocol::dialect::PayloadError;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{
    CommandAck, CommandLong, EstimatorStatus, FusionHealth, Heartbeat, Inertial, Message, Odometry, OdometryPose,
    PlanarImu, PlanarPose, PoseFlags, RobotDescription, SetMessageInterval, TextPart, TimeSync, VisionFix, WheelTicks,
    WireStamp,
};
use posebridge_telemetry::{
    Address, EncoderTicks, Heading, Meters, MetersPerSecond, MetersPerSecondSquared, Pose, Radians, RadiansPerSecond,
    SensorId, TimeDelta,
};

const ROBOT: Address = Address::new(1, 1);
const STATION: Address = Address::new(1, 197);
const GCS: Address = Address::new(255, 190);
const STANDARD_GRAVITY: f64 = 9.806_65;

#[test]
fn own_wheel_ticks_and_inertial() {
    check(
        "pb_wheel_ticks",
        &Message::WheelTicks(WheelTicks {
            stamp: WireStamp::Micros32(4_294_967_290),
            left: EncoderTicks(-123_456),
            right: EncoderTicks(2_147_483_647),
        }),
    );
    check(
        "pb_inertial",
        &Message::Inertial(Inertial {
            stamp: WireStamp::Micros32(50_000),
            turn_rate: Some(RadiansPerSecond(-1.5)),
            turn: Some(Radians(-1.5)),
            wheel_accelerations: Some((MetersPerSecondSquared(0.25), MetersPerSecondSquared(-32.768))),
        }),
    );
    check(
        "pb_inertial_gyro_only",
        &Message::Inertial(Inertial {
            stamp: WireStamp::Micros32(50_000),
            turn_rate: Some(RadiansPerSecond(0.5e-3)),
            turn: None,
            wheel_accelerations: None,
        }),
    );
}

#[test]
fn own_planar_pose() {
    let covariance = [0.01_f32, 0.002, -0.003, 0.04, 0.005, 0.06].map(f64::from);
    check(
        "pb_planar_pose",
        &Message::PlanarPose(PlanarPose {
            stamp: WireStamp::Micros32(1_000_001),
            pose: Pose::new(Meters(1.5), Meters(-2.25), Heading::from_rad(3.0)),
            forward_speed: MetersPerSecond(0.125),
            turn_rate: RadiansPerSecond(-0.5),
            covariance,
            fix_age: Some(TimeDelta::from_millis(250)),
            reset_counter: 2,
            flags: PoseFlags {
                position_valid: true,
                heading_valid: true,
                speeds_valid: true,
                dead_reckoning: false,
                predicted: true,
            },
        }),
    );
    check(
        "pb_planar_pose_no_fix",
        &Message::PlanarPose(PlanarPose {
            stamp: WireStamp::Micros32(0),
            pose: Pose::default(),
            forward_speed: MetersPerSecond(0.0),
            turn_rate: RadiansPerSecond(0.0),
            covariance: [0.0; 6],
            fix_age: None,
            reset_counter: 0,
            flags: PoseFlags::default(),
        }),
    );
}

#[test]
fn own_fusion_health_and_robot_description() {
    check(
        "pb_fusion_health",
        &Message::FusionHealth(FusionHealth {
            stamp: WireStamp::Micros32(777),
            sensor: SensorId::CAMERA,
            verdict: 1,
            nis_per_dof: 3.5,
            innovation: [0.5, -0.25, 0.125],
            lag: TimeDelta::from_millis(120),
            accepted: 65_535,
            refused: 3,
        }),
    );
    check(
        "pb_robot_description",
        &Message::RobotDescription(RobotDescription {
            name: "brick-7".to_owned(),
            left_wheel_radius: Meters(f64::from(0.028_f32)),
            right_wheel_radius: Meters(f64::from(0.0281_f32)),
            track_width: Meters(f64::from(0.112_f32)),
            ticks_per_turn: 360.0,
            gyro_sigma: RadiansPerSecond(f64::from(0.0125_f32)),
            gyro_resolution: RadiansPerSecond(f64::from(0.017_453_292_f32)),
        }),
    );
}

#[test]
fn heartbeat_and_time() {
    let rover = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };
    check("heartbeat", &Message::Heartbeat(rover));
    check(
        "system_time",
        &Message::SystemTime { unix_micros: 1_700_000_000_123_456, since_boot: WireStamp::Millis32(98_765) },
    );
    check(
        "timesync_request",
        &Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos: 123_456_789_012, target: None }),
    );
    check(
        "timesync_answer",
        &Message::TimeSync(TimeSync { answer_nanos: -5, request_nanos: 123_456_789_012, target: Some(STATION) }),
    );
}

#[test]
fn values_that_no_definition_lists_are_kept() {
    let strange = decode_golden("heartbeat_of_unlisted_type").unwrap();
    let expected = Heartbeat { vehicle_type: 201, autopilot: 99, base_mode: 255, system_status: 200 };
    assert_eq!(strange, Some(Message::Heartbeat(expected)));
    check(
        "command_of_unlisted_number",
        &Message::Command(CommandLong {
            target: STATION,
            command: 65_000,
            params: [1.0, 2.0, 3.0, -4.0, 5.0, 6.0, 7.5],
        }),
    );
    check(
        "command_ack_of_unlisted_number",
        &Message::CommandAck(CommandAck { command: 65_000, result: 3, target: Some(GCS) }),
    );
}

#[test]
fn commands_and_text() {
    check(
        "set_message_interval",
        &Message::SetMessageInterval(SetMessageInterval {
            target: ROBOT,
            message_id: 42_100,
            interval: Some(TimeDelta::from_millis(20)),
        }),
    );
    check(
        "stop_message",
        &Message::SetMessageInterval(SetMessageInterval { target: ROBOT, message_id: 26, interval: None }),
    );
    check("command_ack", &Message::CommandAck(CommandAck { command: 511, result: 0, target: Some(STATION) }));
    check(
        "statustext",
        &Message::StatusText { severity: 4, text: "battery is low".to_owned(), part: TextPart::default() },
    );
}

#[test]
fn parameters() {
    check("param_request_list", &Message::ParamRequestList { target: Address::new(1, 0) });
    check(
        "param_request_read",
        &Message::ParamRequestRead { target: STATION, name: "GATE_SIGMA".to_owned(), index: -1 },
    );
    check("param_set", &Message::ParamSet { target: STATION, name: "SIXTEEN_BYTES_OK".to_owned(), value: 2.5 });
    check("param_value", &Message::ParamValue { name: "GATE_SIGMA".to_owned(), value: 3.0, count: 40, index: 17 });
}

#[test]
fn wheels_and_inertial_units() {
    check(
        "wheel_distance",
        &Message::WheelDistance {
            stamp: WireStamp::Micros64(5_000_000),
            left: Meters(12.345_678_901),
            right: Meters(-0.5),
        },
    );
    // 100 mG forward; 750 mrad/s against the right-hand rule of "down", so counter-clockwise.
    let imu = PlanarImu {
        stamp: WireStamp::Millis32(4_000),
        turn_rate: Some(RadiansPerSecond(0.75)),
        forward_acceleration: Some(MetersPerSecondSquared(0.1 * STANDARD_GRAVITY)),
    };
    check_encoding("scaled_imu", &Message::ScaledImu(imu), WireVersion::V2);
    let Some(Message::ScaledImu(decoded)) = decode_golden("scaled_imu").unwrap() else {
        panic!("not a SCALED_IMU");
    };
    assert_eq!(decoded.turn_rate, imu.turn_rate);
    let acceleration = decoded.forward_acceleration.unwrap();
    assert!((acceleration.0 - 0.980_665).abs() < 1e-12, "{acceleration}");

    let precise = PlanarImu {
        stamp: WireStamp::Micros64(6_000_000),
        turn_rate: Some(RadiansPerSecond(0.75)),
        forward_acceleration: Some(MetersPerSecondSquared(1.25)),
    };
    check("highres_imu", &Message::HighresImu(precise));
    let gyro_only = PlanarImu { forward_acceleration: None, ..precise };
    check("highres_imu_gyro_only", &Message::HighresImu(gyro_only));
}

#[test]
fn ranges() {
    check(
        "distance_sensor",
        &Message::DistanceSensor { stamp: WireStamp::Millis32(7_000), range: Meters(1.23), sigma: Some(Meters(0.02)) },
    );
    check(
        "distance_sensor_sigma_unknown",
        &Message::DistanceSensor { stamp: WireStamp::Millis32(7_000), range: Meters(1.23), sigma: None },
    );
    assert_eq!(decode_golden("distance_sensor_sideways").unwrap(), None);
    assert_eq!(decode_golden("distance_sensor_bad_quality").unwrap(), None);
}

/// 30 degrees clockwise from north is 60 degrees counter-clockwise from east.
fn close_to_60_degrees(heading: Heading) {
    assert!((heading.rad() - FRAC_PI_3).abs() < 1e-6, "{heading:?}");
}

#[test]
fn fixes_from_outside() {
    let covariance = Some([0.01_f32, 0.005, 0.04, 0.002].map(f64::from));
    let fix = VisionFix {
        stamp: WireStamp::Micros64(8_000_000),
        x: Meters(1.0),
        y: Meters(2.0),
        heading: Some(Heading::from_rad(FRAC_PI_3)),
        covariance,
        reset_counter: 3,
        tag: None,
    };
    check_encoding("vision", &Message::VisionPosition(fix), WireVersion::V2);
    check_encoding("mocap", &Message::MocapPosition(fix), WireVersion::V2);
    let Some(Message::VisionPosition(seen)) = decode_golden("vision").unwrap() else {
        panic!("not a VISION_POSITION_ESTIMATE");
    };
    close_to_60_degrees(seen.heading.unwrap());
    let heading = seen.heading;
    assert_eq!(seen, VisionFix { heading, ..fix });
    let Some(Message::MocapPosition(seen)) = decode_golden("mocap").unwrap() else {
        panic!("not an ATT_POS_MOCAP");
    };
    close_to_60_degrees(seen.heading.unwrap());
    assert_eq!((seen.x, seen.y, seen.covariance), (fix.x, fix.y, covariance));

    let without_heading = VisionFix { heading: None, covariance: None, ..fix };
    check("vision_without_heading", &Message::VisionPosition(without_heading));
}

#[test]
fn odometry_in_the_arena_and_drifting() {
    let covariance = Some([0.01_f32, 0.005, 0.002, 0.04, -0.001, 0.003].map(f64::from));
    let pose = Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(FRAC_PI_3));
    let arena = Odometry {
        stamp: WireStamp::Micros64(9_000_000),
        pose: OdometryPose::Arena(pose),
        forward_speed: MetersPerSecond(0.5),
        turn_rate: RadiansPerSecond(0.25),
        covariance,
        reset_counter: 1,
        quality: 90,
    };
    check_encoding("odometry_arena", &Message::Odometry(arena), WireVersion::V2);
    let decoded = odometry("odometry_arena");
    let OdometryPose::Arena(seen) = decoded.pose else {
        panic!("not in the arena");
    };
    close_to_60_degrees(seen.heading);
    let pose = decoded.pose;
    assert_eq!(decoded, Odometry { pose, ..arena });
    assert_eq!((seen.x.0, seen.y.0), (1.0, 2.0));

    // Forward 2, right 1, 30 degrees clockwise: left -1, heading -30 degrees.
    let drifting = Pose::new(Meters(2.0), Meters(-1.0), Heading::from_rad(-FRAC_PI_3 / 2.0));
    let odom = Odometry {
        pose: OdometryPose::Odom(drifting),
        covariance: Some([0.04_f32, -0.005, -0.001, 0.01, -0.002, 0.003].map(f64::from)),
        ..arena
    };
    check_encoding("odometry_odom", &Message::Odometry(odom), WireVersion::V2);
    let decoded = odometry("odometry_odom");
    let OdometryPose::Odom(seen) = decoded.pose else {
        panic!("not drifting");
    };
    assert!((seen.heading.rad() + FRAC_PI_3 / 2.0).abs() < 1e-6);
    let pose = decoded.pose;
    assert_eq!(decoded, Odometry { pose, ..odom });
    assert_eq!((seen.x.0, seen.y.0), (2.0, -1.0));
}

#[test]
fn odometry_of_other_frames() {
    let decoded = odometry("odometry_enu_flu");
    let OdometryPose::Arena(seen) = decoded.pose else {
        panic!("not in the arena");
    };
    assert_eq!((seen.x.0, seen.y.0), (2.0, 1.0));
    assert_eq!(decoded.turn_rate, RadiansPerSecond(-0.25));
    assert_eq!(decoded.covariance, None);
    let refused = decode_golden("odometry_global").unwrap_err();
    assert!(matches!(refused, PayloadError::UnknownFrame { frame: 0, .. }), "{refused}");
}

fn odometry(name: &str) -> Odometry {
    let decoded = decode_golden(name).expect(name);
    let Some(Message::Odometry(odometry)) = decoded else {
        unreachable!("{name} is {decoded:?}");
    };
    odometry
}

#[test]
fn what_ground_stations_draw() {
    check(
        "local_position_ned",
        &Message::LocalPosition {
            stamp: WireStamp::Millis32(10_000),
            x: Meters(1.0),
            y: Meters(2.0),
            x_speed: MetersPerSecond(0.5),
            y_speed: MetersPerSecond(0.25),
        },
    );
    let mut status = EstimatorStatus {
        stamp: WireStamp::Micros64(11_000_000),
        flags: PoseFlags {
            position_valid: true,
            heading_valid: true,
            speeds_valid: true,
            dead_reckoning: false,
            predicted: false,
        },
        position_ratio: 0.75,
        position_sigma: Meters(0.125),
    };
    check("estimator_status", &Message::EstimatorStatus(status));
    status.flags.speeds_valid = false;
    status.flags.dead_reckoning = true;
    check("estimator_status_dead_reckoning", &Message::EstimatorStatus(status));
}

fn attitude() -> Message {
    Message::Attitude {
        stamp: WireStamp::Millis32(123_456),
        heading: Heading::from_rad(std::f64::consts::FRAC_PI_2 - 0.5),
        turn_rate: RadiansPerSecond(0.25),
    }
}

#[test]
fn attitude_turns_its_sign_and_origin() {
    check("attitude", &attitude());
}

#[test]
fn version_1_leaves_extensions_out() {
    let rover = Heartbeat { vehicle_type: 10, autopilot: 0, base_mode: 0, system_status: 4 };
    check_encoding("v1_heartbeat", &Message::Heartbeat(rover), WireVersion::V1);
    check_encoding("v1_attitude", &attitude(), WireVersion::V1);
    assert_eq!(decode_golden("v1_attitude").unwrap(), Some(attitude()));
    let ack = CommandAck { command: 511, result: 0, target: None };
    check_encoding("v1_command_ack", &Message::CommandAck(ack), WireVersion::V1);
    let decoded = decode_golden("v1_command_ack").unwrap();
    assert_eq!(decoded, Some(Message::CommandAck(ack)));
}

#[test]
fn a_signed_frame_is_taken_with_its_signature() {
    let bytes = &golden()["heartbeat_signed"];
    let (raw, payload) = with_frame(bytes, |frame| (frame.raw.to_vec(), frame.payload.len()));
    assert_eq!(&raw, bytes);
    assert_eq!((raw.len(), payload), (9 + 12 + 13, 9));
}

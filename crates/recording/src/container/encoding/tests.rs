//! The bytes of the format page, written by hand, and the errors.

use posebridge_telemetry::{
    Address, ChannelName, Command, Input, LinkCounts, LinkId, LinkState, Observation, ObservationKind,
    OnlineCalibration, ParameterName, ParameterStorage, PeerId, Pose, RadiansPerSecond, RobotId, SensorId,
    SensorSwitch, SimulatorCommand, SlippingWheel, SteeringSource, TimeDelta, Timestamp,
};

use super::*;

const POSITION: RecordPosition = RecordPosition { sequence: 0, log_time: 0 };

/// Appends the checksum as the format page describes it, computed bit by bit and not by the library.
fn with_checksum(body: &[u8], position: RecordPosition) -> Vec<u8> {
    let mut crc = u32::MAX;
    let prefix = [&position.sequence.to_le_bytes()[..], &position.log_time.to_le_bytes()[..]].concat();
    for byte in prefix.iter().chain(body) {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    [body, &(!crc).to_le_bytes()].concat()
}

#[test]
fn a_time_beyond_the_host_clock_is_refused_and_not_turned_negative() {
    let at = |log_time| {
        let position = RecordPosition { sequence: 0, log_time };
        decode(&with_checksum(&[ENCODING_VERSION, tag::TICK], position), position)
    };
    let last = i64::MAX as u64;
    assert_eq!(at(last), Ok(Input::Tick));
    assert_eq!(at(last + 1), Err(DecodeError::Time(last + 1)));
    assert_eq!(at(u64::MAX), Err(DecodeError::Time(u64::MAX)));
}

fn check(body: &[u8], input: &Input) {
    let position = RecordPosition { sequence: 7, log_time: 1_234_567_890 };
    let bytes = with_checksum(body, position);
    let mut written = Vec::new();
    encode(input, position, &mut written);
    assert_eq!(written, bytes, "{input:?}");
    assert_eq!(decode(&bytes, position).as_ref(), Ok(input));
}

#[test]
fn the_bytes_are_those_of_the_format_page() {
    check(
        &[4, 0, 0x02, 0x01, 0xFE, 0x09],
        &Input::Bytes { link: LinkId(0x0102), peer: PeerId(0), bytes: vec![0xFE, 0x09] },
    );
    check(
        &[4, 5, 0x02, 0x01, 9, 0, 0, 1, 0xFE],
        &Input::Bytes { link: LinkId(0x0102), peer: PeerId(0x0100_0009), bytes: vec![0xFE] },
    );
    let mut counts = vec![4, 6, 7, 0];
    counts.extend_from_slice(&[1, 0, 0, 0, 0, 0, 0, 0]);
    counts.extend_from_slice(&[2, 0, 0, 0, 0, 0, 0, 0]);
    counts.extend_from_slice(&[3, 0, 0, 0, 4, 0, 0, 0, 5, 0, 0, 0]);
    counts.extend_from_slice(&[0, 0, 0, 0, 0, 0, 0xF0, 0xBF]); // -1: none measured
    check(
        &counts,
        &Input::Port {
            link: LinkId(7),
            counts: LinkCounts {
                bytes_out: 1,
                drops_out: 2,
                peers: 3,
                queued_frames: 4,
                queued_bytes: 5,
                capacity_bytes_per_s: None,
            },
        },
    );
    check(&[4, 1, 3, 0, 1], &Input::Link { link: LinkId(3), state: LinkState::Up });
    check(&[4, 4], &Input::Tick);
}

#[test]
fn commands_and_reports_stand_where_the_format_page_says() {
    let command = |body: &[u8], command| check(body, &Input::Command(command));
    command(&[4, 7, 0], Command::ResetPose);
    command(
        &[4, 7, 1, 0, 0, 0, 0, 0, 0, 0xE0, 0xBF, b's', b'l', b'i', b'p'],
        Command::SetParameter { name: ParameterName::from_bytes(b"slip"), value: -0.5 },
    );
    command(&[4, 7, 2], Command::Parameters(ParameterStorage::Save));
    command(&[4, 7, 3], Command::Parameters(ParameterStorage::Reload));
    command(&[4, 7, 4], Command::Parameters(ParameterStorage::Default));
    command(&[4, 7, 5], Command::OnlineCalibration(OnlineCalibration::Frozen));
    command(&[4, 7, 6], Command::OnlineCalibration(OnlineCalibration::Enabled));
    command(&[4, 7, 7], Command::ResetCalibration);
    for (kind, to) in [(8, SensorSwitch::Off), (9, SensorSwitch::On)] {
        let sensor = SensorId::CAMERA;
        command(&[4, 7, kind, 3], Command::SwitchSource { sensor, to });
    }
    command(&[4, 7, 10], Command::StartRecording);
    command(&[4, 7, 11], Command::StopRecording);
    check(&[4, 8, 4, b'f', 0xC3, 0xBC], &Input::Report { severity: 4, text: "f\u{fc}".to_owned() });
}

#[test]
fn a_command_for_one_robot_stands_behind_the_robot_as_one_for_the_station() {
    let robot = RobotId { link: LinkId(0x0102), address: Address::new(7, 1) };
    for (body, command) in [
        (&[7, 0][..], Command::ResetPose),
        (&[7, 8, 3], Command::SwitchSource { sensor: SensorId::CAMERA, to: SensorSwitch::Off }),
        (&[9, 11], Command::Simulator(SimulatorCommand::Path)),
        (
            &[&[3][..], &[0; 40]].concat(),
            Command::SetPose { pose: Pose::default(), position_sigma_m: 0.0, heading_sigma_rad: 0.0 },
        ),
    ] {
        check(&[&[5, 10, 0x02, 0x01, 7, 1][..], body].concat(), &Input::RobotCommand { robot, command });
    }
    for (body, error) in [
        (&[5, 10, 2, 1, 7][..], DecodeError::TooShort { wanted: 1, left: 0 }),
        (&[5, 10, 2, 1, 7, 1, 4], DecodeError::Unknown { field: "command tag", value: 4 }),
        (&[5, 10, 2, 1, 7, 1, 10], DecodeError::Unknown { field: "command tag", value: 10 }),
        (&[5, 10, 2, 1, 7, 1, 7, 0, 0], DecodeError::TooLong(1)),
    ] {
        assert_eq!(decode(&with_checksum(body, POSITION), POSITION), Err(error));
    }
}

#[test]
fn commands_for_the_simulated_brick_stand_where_the_format_page_says() {
    let command = |body: &[u8], command| check(body, &Input::Command(Command::Simulator(command)));
    let minus_half = [0, 0, 0, 0, 0, 0, 0xE0, 0xBF];
    let half = [0, 0, 0, 0, 0, 0, 0xE0, 0x3F];
    let second = [0x00, 0xCA, 0x9A, 0x3B, 0, 0, 0, 0]; // 1e9 ns
    let of = |kind: u8, fields: &[&[u8]]| [&[4, 9, kind][..], &fields.concat()].concat();
    let duration = TimeDelta::from_millis(1_000);
    command(
        &of(0, &[&half, &minus_half, &[0; 8]]),
        SimulatorCommand::Kidnap { forward_m: 0.5, left_m: -0.5, turn_rad: 0.0 },
    );
    for (index, wheel) in SlippingWheel::ALL.into_iter().enumerate() {
        command(&of(1, &[&half, &second, &[index as u8]]), SimulatorCommand::Slip { wheel, factor: 0.5, duration });
    }
    command(&[4, 9, 2], SimulatorCommand::Camera(SensorSwitch::Off));
    command(&[4, 9, 3], SimulatorCommand::Camera(SensorSwitch::On));
    let delay = duration;
    command(&of(4, &[&second]), SimulatorCommand::CameraDelay { delay });
    let rad_per_s = -0.5;
    command(&of(5, &[&minus_half]), SimulatorCommand::GyroBiasStep { rad_per_s });
    let profile = ChannelName::from_bytes(b"usb");
    command(&of(6, &[b"usb"]), SimulatorCommand::LinkProfile(Some(profile)));
    command(&[4, 9, 7], SimulatorCommand::LinkProfile(None));
    command(&of(8, &[&second]), SimulatorCommand::PullCable { duration });
    let odometry = SteeringSource::Odometry;
    command(&[4, 9, 9, 0], SimulatorCommand::Steering(odometry));
    let estimate = SteeringSource::Estimate;
    command(&[4, 9, 9, 1], SimulatorCommand::Steering(estimate));
    command(&of(10, &[&half, &minus_half]), SimulatorCommand::Drive { forward_m_per_s: 0.5, turn_rad_per_s: -0.5 });
    command(&[4, 9, 11], SimulatorCommand::Path);
}

#[test]
fn a_turn_rate_stands_where_the_format_page_says() {
    let mut body = vec![4, 2, 1];
    body.extend_from_slice(&[0x00, 0xCA, 0x9A, 0x3B, 0, 0, 0, 0]); // 1e9 ns
    body.extend_from_slice(&[0xFF; 8]); // -1 ns
    body.push(3);
    body.extend_from_slice(&[0, 0, 0, 0, 0, 0, 0xE0, 0xBF]); // -0.5
    check(
        &body,
        &Input::Observation(Observation {
            sensor: SensorId::GYRO,
            stamp: Timestamp::from_nanos(1_000_000_000),
            stamp_sigma: TimeDelta::from_nanos(-1),
            measurement: ObservationKind::TurnRate(RadiansPerSecond(-0.5)),
        }),
    );
}

#[test]
fn what_the_layout_does_not_have_is_named() {
    let check = |body: &[u8], error: DecodeError| {
        assert_eq!(decode(&with_checksum(body, POSITION), POSITION), Err(error));
    };
    check(&[9, 4], DecodeError::Version(9));
    check(&[1, 4, 0, 0], DecodeError::TooLong(2));
    check(&[1, 0, 5], DecodeError::TooShort { wanted: 2, left: 1 });
    check(&[4, 11], DecodeError::Unknown { field: "input tag", value: 11 });
    check(&[4, 7, 12], DecodeError::Unknown { field: "command", value: 12 });
    for (body, field, value) in [
        (&[4, 9, 12][..], "command for the simulated brick", 12),
        (&[4, 9, 9, 2], "steering source", 2),
        (&[&[4, 9, 1][..], &[0; 16], &[3]].concat(), "slipping wheel", 3),
    ] {
        check(body, DecodeError::Unknown { field, value });
    }
    check(&[4, 7, 5, 0], DecodeError::TooLong(1));
    check(&[4, 8, 6, 0xFF], DecodeError::Text("a report"));
    let name = |name: &[u8]| [&[4, 7, 1][..], &[0; 8], name].concat();
    check(&name(b"a b"), DecodeError::Text("a parameter's name"));
    check(&name(b"seventeen_letters"), DecodeError::Text("a parameter's name"));
    check(&[1, 1, 0, 0, 2], DecodeError::Unknown { field: "link state", value: 2 });
    let set_pose = [&[1, 3][..], &[0; 16], &4.0_f64.to_le_bytes(), &[0; 16]].concat();
    check(&set_pose, DecodeError::Heading(4.0));
}

#[test]
fn the_layouts_before_this_one_are_still_read() {
    assert_eq!(decode(&with_checksum(&[1, 4], POSITION), POSITION), Ok(Input::Tick));
    assert_eq!(decode(&with_checksum(&[2, 4], POSITION), POSITION), Ok(Input::Tick));
    assert_eq!(decode(&with_checksum(&[3, 4], POSITION), POSITION), Ok(Input::Tick));
}

#[test]
fn a_message_at_another_place_is_damage() {
    let bytes = with_checksum(&[1, 4], POSITION);
    let elsewhere = RecordPosition { sequence: 1, log_time: 0 };
    assert!(matches!(decode(&bytes, elsewhere), Err(DecodeError::Checksum { .. })));
}

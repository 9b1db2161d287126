//! Requests of ground stations, in the bytes of a foreign implementation: integers as parameters, and the commands that are served.

use std::f64::consts::FRAC_PI_4;

use posebridge_protocol::dialect::commands::{CommandError, SUPPORTED_COMMANDS, decode_command};
use posebridge_protocol::dialect::decode;
use posebridge_protocol::message::{CommandLong, Message, TextPart};
use posebridge_telemetry::{
    Command, Heading, Meters, OnlineCalibration, ParameterStorage, Pose, SensorId, SensorSwitch,
};

use crate::support::{STATION, framed, golden_frames, with_frame};

fn command_of(name: &str) -> CommandLong {
    match with_frame(&golden_frames()[name], decode) {
        Ok(Some(Message::Command(command))) => command,
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn the_supported_commands_are_those_of_the_page() {
    let pose = Command::SetPose {
        pose: Pose::new(Meters(2.0), Meters(3.0), Heading::from_rad(0.0)),
        position_sigma_m: 0.25,
        heading_sigma_rad: FRAC_PI_4,
    };
    let camera = Command::SwitchSource { sensor: SensorId::CAMERA, to: SensorSwitch::On };
    let expected = [
        ("mav_cmd_preflight_storage", Command::Parameters(ParameterStorage::Save)),
        ("mav_cmd_logging_start", Command::StartRecording),
        ("mav_cmd_logging_stop", Command::StopRecording),
        ("mav_cmd_user_1", pose),
        ("mav_cmd_user_2", Command::ResetPose),
        ("mav_cmd_user_3", Command::ResetCalibration),
        ("mav_cmd_user_4", camera),
    ];
    for ((name, expected), number) in expected.into_iter().zip(SUPPORTED_COMMANDS) {
        let command = command_of(name);
        assert_eq!(command.command, number, "{name}");
        assert_eq!(decode_command(&command), Ok(expected), "{name}");
    }
}

#[test]
fn every_value_of_a_choice_is_distinguished() {
    let with = |name: &str, params: &[f32]| {
        let mut command = command_of(name);
        command.params = [0.0; 7];
        command.params[..params.len()].copy_from_slice(params);
        decode_command(&command)
    };
    let (storage, calibration) = ("mav_cmd_preflight_storage", "mav_cmd_user_3");
    for (name, choice, expected) in [
        (storage, 0.0, Command::Parameters(ParameterStorage::Reload)),
        (storage, 2.0, Command::Parameters(ParameterStorage::Default)),
        (storage, 4.0, Command::Parameters(ParameterStorage::Default)),
        (storage, 3.0, Command::ResetCalibration),
        (calibration, 0.0, Command::OnlineCalibration(OnlineCalibration::Frozen)),
        (calibration, 1.0, Command::OnlineCalibration(OnlineCalibration::Enabled)),
    ] {
        assert_eq!(with(name, &[choice]), Ok(expected), "{name} {choice}");
    }
    for (name, params, wrong) in [
        (storage, &[5.0][..], 1),
        (storage, &[0.5], 1),
        (storage, &[f32::NAN], 1),
        (storage, &[-1.0], 1),
        (calibration, &[3.0], 1),
        (storage, &[1.0, 0.0, -1.0], 3),
        ("mav_cmd_logging_start", &[1.0], 1),
        ("mav_cmd_user_4", &[256.0, 0.0], 1),
        ("mav_cmd_user_4", &[3.0, 2.0], 2),
        ("mav_cmd_user_1", &[0.0, f32::NAN, 0.0, 0.1, 1.0], 2),
        ("mav_cmd_user_1", &[0.0, 0.0, 0.0, 0.0, 1.0], 4),
        ("mav_cmd_user_1", &[0.0, 0.0, 0.0, 0.1, -1.0], 5),
    ] {
        let refused = with(name, params);
        assert!(matches!(refused, Err(CommandError::Parameter { index, .. }) if index == wrong), "{name} {refused:?}");
    }
    let unknown = CommandLong { command: 400, ..command_of("mav_cmd_user_2") };
    assert_eq!(decode_command(&unknown), Err(CommandError::Unknown { command: 400 }));
}

#[test]
fn why_a_command_is_denied_fits_into_one_text() {
    for command in SUPPORTED_COMMANDS {
        let params = [-1.234_567_8e-30; 7];
        let Err(error) = decode_command(&CommandLong { target: STATION, command, params }) else {
            continue;
        };
        let text = error.to_string();
        let bytes =
            framed(0, STATION, &Message::StatusText { severity: 4, text: text.clone(), part: TextPart::default() });
        assert!(bytes.windows(text.len()).any(|window| window == text.as_bytes()), "{text}");
    }
}

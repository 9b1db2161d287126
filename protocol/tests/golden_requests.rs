//! What ground stations ask, in the bytes of a foreign implementation: integers as parameters, and the commands that are served.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop when a frame is missing")]

#[path = "support/golden.rs"]
#[expect(dead_code, reason = "other tests use the rest")]
mod golden;

use std::f64::consts::FRAC_PI_4;

use golden::decode_golden;
use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::dialect::commands::{CommandError, SUPPORTED_COMMANDS, decode_command};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{CommandLong, Message, TextPart};
use posebridge_telemetry::{
    Address, Command, Heading, Meters, OnlineCalibration, ParameterStorage, Pose, SensorId, SensorSwitch,
};

const STATION: Address = Address::new(1, 197);

#[test]
fn whole_numbers_of_every_type_that_fits_are_read_bytewise() {
    for (kind, expected) in [(1, 200.0), (2, -3.0), (3, 40_000.0), (4, -300.0), (5, 70_000.0), (6, -5.0)] {
        let decoded = decode_golden(&format!("param_set_of_type_{kind}"));
        let expected = Message::ParamSet { target: STATION, name: "reset_after_n".to_owned(), value: expected };
        assert_eq!(decoded.expect("it is known"), Some(expected), "type {kind}");
    }
    let decoded = decode_golden("param_set_of_type_10");
    assert!(matches!(
        decoded.expect("it is known"),
        Some(Message::ParamSetUnsupported { target: STATION, name, kind: 10 }) if name == "reset_after_n"
    ));
}

fn command_of(name: &str) -> CommandLong {
    match decode_golden(name).expect(name) {
        Some(Message::Command(command)) => command,
        other => panic!("{name}: {other:?}"),
    }
}

#[test]
fn the_commands_that_are_served_say_what_the_page_says() {
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
fn every_number_of_a_choice_is_told_from_the_others() {
    let with = |name: &str, params: &[f32]| {
        let mut command = command_of(name);
        command.params = [0.0; 7];
        command.params[..params.len()].copy_from_slice(params);
        decode_command(&command)
    };
    let storage = |first| with("mav_cmd_preflight_storage", &[first]);
    assert_eq!(storage(0.0), Ok(Command::Parameters(ParameterStorage::Reload)));
    for to_default in [2.0, 4.0] {
        assert_eq!(storage(to_default), Ok(Command::Parameters(ParameterStorage::Default)));
    }
    assert_eq!(storage(3.0), Ok(Command::ResetCalibration));
    let calibration = |first| with("mav_cmd_user_3", &[first]);
    assert_eq!(calibration(0.0), Ok(Command::OnlineCalibration(OnlineCalibration::Frozen)));
    assert_eq!(calibration(1.0), Ok(Command::OnlineCalibration(OnlineCalibration::Enabled)));
    for (nonsense, index) in [
        (storage(5.0), 1),
        (storage(0.5), 1),
        (storage(f32::NAN), 1),
        (storage(-1.0), 1),
        (calibration(3.0), 1),
        (with("mav_cmd_preflight_storage", &[1.0, 0.0, -1.0]), 3),
        (with("mav_cmd_logging_start", &[1.0]), 1),
        (with("mav_cmd_user_4", &[256.0, 0.0]), 1),
        (with("mav_cmd_user_4", &[3.0, 2.0]), 2),
        (with("mav_cmd_user_1", &[0.0, f32::NAN, 0.0, 0.1, 1.0]), 2),
        (with("mav_cmd_user_1", &[0.0, 0.0, 0.0, 0.0, 1.0]), 4),
        (with("mav_cmd_user_1", &[0.0, 0.0, 0.0, 0.1, -1.0]), 5),
    ] {
        assert!(
            matches!(nonsense, Err(CommandError::Parameter { index: found, .. }) if found == index),
            "{nonsense:?}"
        );
    }
    let unknown = CommandLong { command: 400, ..command_of("mav_cmd_user_2") };
    assert_eq!(decode_command(&unknown), Err(CommandError::Unknown { command: 400 }));
}

#[test]
fn why_a_command_is_denied_fits_into_one_text() {
    for command in SUPPORTED_COMMANDS {
        let params = [-1.234_567_8e-30; 7];
        let target = STATION;
        let Err(error) = decode_command(&CommandLong { target, command, params }) else {
            continue;
        };
        let said = Message::StatusText { severity: 4, text: error.to_string(), part: TextPart::default() };
        let mut bytes = Vec::new();
        Encoder::new(WireVersion::V2).encode(STATION, &said, &mut bytes);
        let text = error.to_string();
        let whole = bytes.windows(text.len()).any(|window| window == text.as_bytes());
        assert!(whole, "{text}");
    }
}

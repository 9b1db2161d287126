//! A run with requests gives the same when it is replayed, and when its bytes come in other pieces.

use super::{CALIBRATION, PREFLIGHT_STORAGE, SET_POSE, SOURCE, name, with_calibration};
use crate::support::ground::{GCS_LINK, Ground, OTHER_GCS_LINK};
use crate::support::{STATION, at, config, link};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{Command, Input, OnlineCalibration, ParameterStorage, SensorId, SensorSwitch};

/// All requests, over a link and as a command, while the robot drives.
fn busy() -> Ground {
    let mut ground = Ground::new(with_calibration);
    ground.drive(0, 1_000);
    ground.send(1_010, &Message::ParamRequestList { target: STATION });
    ground.set(1_020, "gate_prob", 0.9);
    ground.drive(1_050, 2_000);
    ground.set(2_010, "gate_prob", 7.0);
    ground.command(2_011, CALIBRATION, &[0.0]);
    ground.command(2_012, SOURCE, &[3.0, 0.0]);
    ground.drive(2_050, 3_000);
    for command in [
        Command::SetParameter { name: name("accel_m_s2"), value: 3.0 },
        Command::SetParameter { name: name("nothing"), value: 3.0 },
        Command::OnlineCalibration(OnlineCalibration::Enabled),
        Command::SwitchSource { sensor: SensorId::CAMERA, to: SensorSwitch::On },
        Command::Parameters(ParameterStorage::Save),
        Command::StopRecording,
        Command::StartRecording,
    ] {
        ground.station.handle(at(3_010), Input::Command(command));
    }
    let report = Input::Report { severity: 6, text: "saved".to_owned() };
    ground.station.handle(at(3_020), report);
    ground.drive(3_050, 4_000);
    ground.command(4_010, PREFLIGHT_STORAGE, &[2.0]);
    ground.command(4_011, SET_POSE, &[0.0, 0.8, 90.0, 0.1, 5.0]);
    ground.drive(4_050, 5_000);
    ground.station.handle(at(5_010), Input::Command(Command::ResetCalibration));
    ground.station.handle(at(5_011), Input::Command(Command::ResetPose));
    ground.drive(5_050, 6_000);
    ground
}

#[test]
fn a_run_with_requests_is_replayed_bit_for_bit() {
    let live = busy();
    let mut config = config();
    config.links.push(link(GCS_LINK, vec![]));
    config.links.push(link(OTHER_GCS_LINK, vec![]));
    with_calibration(&mut config);
    let replayed = live.station.replayed(&config);
    assert_eq!(format!("{:?}", replayed.outputs), format!("{:?}", live.station.outputs));
    assert!(live.station.texts().len() >= 15, "{:?}", live.station.texts());
}

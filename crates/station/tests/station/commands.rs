//! Requests of people and programs to a running station, over a link and as a command.

mod one_robot;
mod repeated;
mod requests;

use crate::support::ground::{GCS_LINK, Ground, OTHER_GCS_LINK, fix};
use crate::support::{BRICK, LINK, STATION, TestStation, at, config, frame, messages};
use posebridge_estimator::PARAMS;
use posebridge_protocol::message::{Message, TextPart};
use posebridge_station::{AnnouncedAs, StationConfig};
use posebridge_telemetry::{
    Address, Calibration, Command, FusionOutcome, Input, LinkState, ParameterName, ParameterStorage, Pose, Request,
    SensorId, SensorSwitch, UncertainValue,
};

const EVERYBODY_OF_OURS: Address = Address::new(255, 0);

const PREFLIGHT_STORAGE: u16 = 245;
const LOGGING_START: u16 = 2_510;
const LOGGING_STOP: u16 = 2_511;
const SET_POSE: u16 = 31_010;
const RESET_POSE: u16 = 31_011;
const CALIBRATION: u16 = 31_012;
const SOURCE: u16 = 31_013;

const ACCEPTED: u8 = 0;
const DENIED: u8 = 2;
const UNSUPPORTED: u8 = 3;

fn name(key: &str) -> ParameterName {
    ParameterName::from_bytes(key.as_bytes())
}

fn value(index: usize, value: f32) -> Message {
    Message::ParamValue {
        name: PARAMS[index].key.to_uppercase(),
        value,
        count: PARAMS.len() as u16,
        index: index as u16,
    }
}

fn warning(text: &str) -> Message {
    Message::StatusText { severity: 4, text: text.to_owned(), part: TextPart::default() }
}

fn with_calibration(config: &mut StationConfig) {
    config.robot.filter_config.calibration =
        Calibration { radius_scale: UncertainValue { value: 0.0, sigma: 0.05 }, ..Calibration::default() };
}

#[test]
fn all_tunables_are_listed_in_their_order_one_at_a_time() {
    for target in [STATION, EVERYBODY_OF_OURS] {
        let mut ground = Ground::new(|_| {});
        let first_output = ground.station.outputs.len();
        ground.send(100, &Message::ParamRequestList { target });
        ground.station.pass_until(at(2_000));
        let expected: Vec<Message> =
            PARAMS.iter().enumerate().map(|(index, row)| value(index, row.default as f32)).collect();
        assert_eq!(ground.received_since(first_output, GCS_LINK), expected);
        assert_eq!(ground.received_since(first_output, OTHER_GCS_LINK), []);
        // Never two at one instant, nor faster than 2 kB/s.
        let is_value = |message: &Message| matches!(message, Message::ParamValue { .. });
        let values = ground.station.sent().filter(|sent| messages(sent.bytes).iter().any(is_value));
        let mut at_ms: Vec<i64> = values.map(|sent| sent.now.as_micros() / 1_000).collect();
        at_ms.dedup();
        assert_eq!(at_ms.len(), PARAMS.len());
        assert!(at_ms.windows(2).all(|pair| pair[1] - pair[0] >= 20));
        assert_eq!(at_ms[0], 100, "the first one at once");
    }
}

#[test]
fn a_tunable_that_is_set_counts_from_the_next_observation_and_is_announced() {
    let mut ground = Ground::new(|_| {});
    ground.drive(0, 2_000);
    let before = ground.station.last_estimate();
    let read = Message::ParamRequestRead { target: STATION, name: String::new(), index: 0 };
    assert_eq!(ground.send_on(OTHER_GCS_LINK, 2_000, &read), [value(0, 0.999)]);
    let first_output = ground.station.outputs.len();
    assert_eq!(ground.set(2_001, "GATE_PROB", 0.5), [value(0, 0.5)]);
    assert_eq!(ground.received_since(first_output, OTHER_GCS_LINK), [value(0, 0.5)]);
    let to_the_brick = ground.received_since(first_output, LINK);
    assert!(!to_the_brick.contains(&value(0, 0.5)), "it never asked: {to_the_brick:?}");
    assert_eq!(ground.station.last_estimate(), before, "nothing was lost by it");
    assert_eq!(ground.station.texts(), ["gate_prob set to 0.5 (was 0.999)"]);
    // A fix that is refused by the narrow gate is used by the wide one.
    let off = frame(BRICK, &fix(2_000, 0.414));
    ground.station.bytes(at(2_050), &off);
    assert_eq!(ground.last_verdict(SensorId::CAMERA), FusionOutcome::Gated);
    let mut untuned = Ground::new(|_| {});
    untuned.drive(0, 2_000);
    untuned.station.bytes(at(2_050), &off);
    assert_eq!(untuned.last_verdict(SensorId::CAMERA), FusionOutcome::Accepted);
}

#[test]
fn a_tunable_that_changes_without_end_is_reported_to_others_at_a_bounded_rate() {
    let mut ground = Ground::new(|_| {});
    let read = Message::ParamRequestRead { target: STATION, name: String::new(), index: 0 };
    ground.send_on(OTHER_GCS_LINK, 100, &read);
    let first_output = ground.station.outputs.len();
    for step in 0..200 {
        let value_set = if step % 2 == 0 { 0.5 } else { 0.6 };
        assert_eq!(ground.set(200 + 5 * step, "GATE_PROB", value_set), [value(0, value_set)], "its own set at once");
    }
    ground.station.pass_until(at(1_300));
    let reports = ground.received_since(first_output, OTHER_GCS_LINK);
    assert_eq!(reports.len(), 51, "one each 20 ms");
    assert_eq!(reports.last(), Some(&value(0, 0.6)));
}

#[test]
fn an_invalid_value_is_answered_with_the_current_one_and_the_reason() {
    let index = PARAMS.iter().position(|row| row.key == "slip_nis").expect("a row");
    for (requested, why) in [
        (1.0, "slip_nis 1.0 not in 4..100"),
        (f32::NAN, "slip_nis NaN not in 4..100"),
        (f32::INFINITY, "slip_nis inf not in 4..100"),
        (-1e30, "slip_nis -1e30 not in 4..100"),
    ] {
        let mut ground = Ground::new(|_| {});
        let text = warning(why);
        assert_eq!(ground.set(100, "slip_nis", requested), [value(index, 10.83), text]);
        assert_eq!(ground.station.texts(), [why]);
    }
}

#[test]
fn a_value_of_an_unsupported_type_is_answered_with_the_current_one_and_the_reason() {
    for kind in [0, 10, 255] {
        for (index, row) in PARAMS.iter().enumerate() {
            let mut ground = Ground::new(|_| {});
            let set = Message::ParamSetUnsupported { target: STATION, name: row.key.to_uppercase(), kind };
            let why = format!("{}: send MAV_PARAM_TYPE 9, not {kind}", row.key);
            let current = value(index, row.default as f32);
            assert_eq!(ground.send(100, &set), [current, warning(&why)]);
            assert_eq!(ground.station.texts(), [why]);
        }
    }
    let mut ground = Ground::new(|_| {});
    let set = Message::ParamSetUnsupported { target: STATION, name: "RATE_P".to_owned(), kind: 10 };
    assert_eq!(ground.send(100, &set), [warning("no parameter `RATE_P`")]);
}

#[test]
fn every_reason_fits_into_one_text() {
    for row in PARAMS {
        let mut ground = Ground::new(|_| {});
        let answers = ground.set(100, row.key, -1.234_567_8e30);
        let reason = answers.iter().find_map(|answer| match answer {
            Message::StatusText { text, .. } => Some(text.clone()),
            _ => None,
        });
        let reason = reason.expect("a reason");
        assert!(reason.ends_with(&format!("..{}", row.range.end())), "{reason}");
    }
}

#[test]
fn an_unknown_tunable_is_named_in_a_warning() {
    let mut ground = Ground::new(|_| {});
    assert_eq!(ground.set(100, "RATE_P\x1b", 1.0), [warning("no parameter `RATE_P?`")]);
    let request = |target, name: &str, index| Message::ParamRequestRead { target, name: name.to_owned(), index };
    let beyond = PARAMS.len() as i16;
    assert_eq!(ground.send(110, &request(STATION, "", beyond)), [warning(&format!("no parameter `{beyond}`"))]);
    assert_eq!(ground.send(120, &request(STATION, "", -2)), [warning("no parameter `-2`")]);
    // Somebody else may have it, or another system is meant.
    assert_eq!(ground.send(130, &request(EVERYBODY_OF_OURS, "RATE_P", -1)), []);
    assert_eq!(ground.send(140, &request(Address::new(7, 190), "slip_nis", -1)), []);
}

#[test]
fn a_filter_that_is_tuned_only_by_its_start_keeps_its_value_and_reports_it() {
    let mut ground = Ground::new(|config| config.robot.filter = "ekf5".to_owned());
    let answers = ground.set(100, "gate_prob", 0.9);
    let why = "the filter ekf5 is tuned only by its start".to_owned();
    assert_eq!(answers, [value(0, 0.999), warning(&why)]);
    assert_eq!(ground.station.texts(), [why]);
}

#[test]
fn tunables_are_saved_on_request_and_the_outcome_goes_to_the_requester() {
    let mut ground = Ground::new(|_| {});
    ground.set(130, "slip_nis", 40.0);
    assert_eq!(ground.result(140, PREFLIGHT_STORAGE, &[1.0]), ACCEPTED);
    let [Request::SaveParameters { values }] = ground.requests()[..] else {
        panic!("{:?}", ground.requests());
    };
    assert_eq!(values.len(), PARAMS.len());
    assert!(values.contains(&(name("slip_nis"), 40.0)));
    let first_output = ground.station.outputs.len();
    let (severity, text) = (6, "saved to x.toml".to_owned());
    let report = Message::StatusText { severity, text: text.clone(), part: TextPart::default() };
    ground.station.handle(at(150), Input::Report { severity, text });
    assert_eq!(ground.received_since(first_output, GCS_LINK), [report]);
    assert_eq!(ground.received_since(first_output, OTHER_GCS_LINK), []);
}

/// A ground station gets all status texts of the station: the line about a request just before the one about its outcome.
#[test]
fn a_link_for_ground_stations_gets_the_outcome_of_each_request() {
    let mut ground = Ground::new(|config| config.links[1].announced_as = AnnouncedAs::StationAndVehicle);
    let requests = [
        (PREFLIGHT_STORAGE, 1.0, "saved parameters.toml in run1"),
        (LOGGING_STOP, 0.0, "recorded recording.mcap in run1"),
        (LOGGING_STOP, 0.0, "nothing is being recorded"),
        (LOGGING_START, 0.0, "recording recording-2.mcap in run1"),
    ];
    for (millis, (command, first, became)) in (100..).step_by(50).zip(requests) {
        let first_output = ground.station.outputs.len();
        assert_eq!(ground.result(millis, command, &[first]), ACCEPTED);
        let (severity, text) = (6, became.to_owned());
        let report = Input::Report { severity, text };
        ground.station.handle(at(millis), report);
        let messages = ground.received_since(first_output, GCS_LINK);
        let is_it = |message: &Message| matches!(message, Message::StatusText { text, .. } if text == became);
        assert!(messages.iter().any(is_it), "{became}: {messages:?}");
    }
    // Not without end: repeated requests are limited, and the suppressed texts are counted.
    let first_output = ground.station.outputs.len();
    for millis in 300..320 {
        let (severity, text) = (6, "recorded".to_owned());
        let report = Input::Report { severity, text };
        ground.station.handle(at(millis), report);
    }
    assert_eq!(ground.received_since(first_output, GCS_LINK).len(), 4);
}

#[test]
fn tunables_are_restored_to_saved_configured_or_default_values() {
    let mut ground = Ground::new(|config| config.robot.filter_config.params.slip_nis = 20.0);
    assert_eq!(ground.value_of(50, "slip_nis"), 20.0);
    let mut now_ms = 100;
    for (value, action, expected) in [
        // Nothing was saved yet: what the run began with.
        (30.0, 0.0, 20.0),
        (40.0, 1.0, 40.0),
        (50.0, 2.0, 10.83),
        (60.0, 0.0, 40.0),
        (70.0, 4.0, 10.83),
    ] {
        now_ms += 10;
        ground.set(now_ms, "slip_nis", value);
        let answer = ground.result(now_ms + 1, PREFLIGHT_STORAGE, &[action]);
        assert_eq!(answer, ACCEPTED, "{action}");
        assert_eq!(ground.value_of(now_ms + 2, "slip_nis"), expected);
    }
    // A log by this command, an action that there is not.
    for nonsense in [&[0.0, 0.0, 1.0][..], &[5.0], &[f32::NAN]] {
        now_ms += 10;
        assert_eq!(ground.result(now_ms, PREFLIGHT_STORAGE, nonsense), DENIED);
    }
}

#[test]
fn a_pose_is_set_and_forgotten_over_a_link() {
    let mut ground = Ground::new(|config| config.robot.filter_config.start = None);
    ground.drive(0, 1_000);
    // 3 m north, 2 m east, facing east.
    let answer = ground.result(1_010, SET_POSE, &[3.0, 2.0, 90.0, 0.1, 5.0]);
    assert_eq!(answer, ACCEPTED);
    let pose = ground.station.last_estimate().pose;
    assert!((pose.x.0 - 2.0).abs() < 1e-9 && (pose.y.0 - 3.0).abs() < 1e-9);
    assert!(pose.heading.rad().abs() < 1e-9);
    assert!((ground.station.last_estimate().x_sigma_m() - 0.1).abs() < 1e-6);
    for nonsense in [
        &[3.0, 2.0, 90.0][..],
        &[f32::NAN, 2.0, 90.0, 0.1, 5.0],
        &[3.0, 2.0, 90.0, -0.1, 5.0],
        &[3.0, 2.0, 90.0, 0.1, f32::INFINITY],
        &[3.0, 2.0, 1e30, 0.1, 5.0],
        &[3.0, 2.0, -360.5, 0.1, 5.0],
    ] {
        assert_eq!(ground.result(1_020, SET_POSE, nonsense), DENIED);
    }
    assert!(ground.station.last_estimate().validity.position);
    assert_eq!(ground.result(1_030, RESET_POSE, &[]), ACCEPTED);
    assert!(!ground.station.last_estimate().validity.position);
    ground.drive(1_050, 1_250);
    assert!(ground.station.last_estimate().validity.position, "a fix has found it");
    // With a start, that is where it is again.
    let mut ground = Ground::new(|_| {});
    ground.drive(0, 1_000);
    ground.station.handle(at(1_010), Input::Command(Command::ResetPose));
    assert_eq!(ground.station.last_estimate().pose, Pose::default());
    let set_pose = Command::SetPose { pose: Pose::default(), position_sigma_m: f64::NAN, heading_sigma_rad: 0.1 };
    ground.station.handle(at(1_020), Input::Command(set_pose));
    let refused = "the pose was not set: a number is not finite or a sigma is negative";
    assert_eq!(ground.station.texts().last(), Some(&refused));
}

#[test]
fn what_is_learned_is_frozen_thawed_and_reset() {
    let mut ground = Ground::new(with_calibration);
    let scale = |ground: &Ground| {
        let learned = ground.station.engine.first_robot().calibration();
        learned.expect("it learns").radius_scale
    };
    let configured = scale(&ground);
    ground.drive(0, 3_000);
    let learned = scale(&ground);
    assert!(learned.sigma < configured.sigma);
    assert_eq!(ground.result(3_010, CALIBRATION, &[0.0]), ACCEPTED);
    ground.drive(3_050, 6_000);
    assert_eq!(scale(&ground), learned);
    assert_eq!(ground.result(6_010, CALIBRATION, &[1.0]), ACCEPTED);
    ground.drive(6_050, 9_000);
    assert!(scale(&ground).sigma < learned.sigma);
    assert_eq!(ground.result(9_010, CALIBRATION, &[2.0]), ACCEPTED);
    assert_eq!(scale(&ground), configured);
    assert_eq!(ground.result(9_020, PREFLIGHT_STORAGE, &[3.0]), ACCEPTED);
    assert_eq!(ground.result(9_030, CALIBRATION, &[3.0]), DENIED);
    let mut plain = Ground::new(|config| config.robot.filter = "odometry".to_owned());
    assert_eq!(plain.result(100, CALIBRATION, &[0.0]), DENIED);
    assert_eq!(plain.station.texts(), ["the filter odometry does not learn"]);
}

#[test]
fn a_source_that_is_switched_off_is_shown_but_not_used() {
    let mut ground = Ground::new(|_| {});
    ground.drive(0, 1_000);
    let sharp = ground.station.last_estimate().x_sigma_m();
    assert_eq!(ground.last_verdict(SensorId::CAMERA), FusionOutcome::Accepted);
    let camera = f32::from(SensorId::CAMERA.0);
    assert_eq!(ground.result(1_010, SOURCE, &[camera, 0.0]), ACCEPTED);
    ground.drive(1_050, 5_000);
    assert_eq!(ground.last_verdict(SensorId::CAMERA), FusionOutcome::Unused);
    let off: Vec<SensorId> = ground.station.engine.first_robot().switched_off().collect();
    assert_eq!(off, [SensorId::CAMERA]);
    let blurred = ground.station.last_estimate().x_sigma_m();
    assert!(blurred > 1.5 * sharp, "{blurred} {sharp}");
    assert!(ground.station.last_estimate().is_dead_reckoning);
    ground
        .station
        .handle(at(5_010), Input::Command(Command::SwitchSource { sensor: SensorId::CAMERA, to: SensorSwitch::On }));
    ground.drive(5_050, 6_000);
    assert_eq!(ground.station.engine.first_robot().switched_off().count(), 0);
    assert_eq!(ground.last_verdict(SensorId::CAMERA), FusionOutcome::Accepted);
    assert!(ground.station.last_estimate().x_sigma_m() < blurred / 1.5);
    let texts = ground.station.texts();
    assert_eq!(texts, ["source 3 (camera) is left out", "source 3 (camera) is used"]);
}

#[test]
fn a_source_that_is_none_is_not_switched() {
    let mut ground = Ground::new(|_| {});
    ground.drive(0, 1_000);
    for unknown in [11.0, 31.0, 39.0, 250.0, 256.0] {
        assert_eq!(ground.result(6_010, SOURCE, &[unknown, 0.0]), DENIED);
    }
    assert_eq!(ground.result(6_015, SOURCE, &[38.0, 0.0]), ACCEPTED);
    assert_eq!(ground.result(6_020, SOURCE, &[3.5, 0.0]), DENIED);
    assert_eq!(ground.result(6_030, SOURCE, &[3.0, 2.0]), DENIED);
}

#[test]
fn recordings_are_requested_and_unknown_commands_are_unsupported() {
    let mut ground = Ground::new(|_| {});
    assert_eq!(ground.result(100, LOGGING_STOP, &[]), ACCEPTED);
    assert_eq!(ground.result(110, LOGGING_START, &[]), ACCEPTED);
    assert_eq!(ground.result(120, LOGGING_START, &[1.0]), DENIED);
    let requests = ground.requests();
    assert!(matches!(
        requests[..],
        [
            Request::StopRecording,
            Request::StartRecording { values },
        ] if values.len() == PARAMS.len()
    ));
    assert_eq!(ground.result(130, 400, &[1.0]), UNSUPPORTED);
    assert_eq!(ground.result(140, 65_000, &[]), UNSUPPORTED);
}

#[test]
fn a_station_without_a_link_takes_commands_too() {
    let mut config = config();
    config.links.clear();
    let mut station = TestStation::new(&config);
    for command in [Command::ResetPose, Command::ResetCalibration, Command::Parameters(ParameterStorage::Default)] {
        station.handle(at(10), Input::Command(command));
    }
    station.link(at(20), LINK, LinkState::Up);
    assert_eq!(station.events().count(), 3);
}

//! Thermometers beside the robot: any brick has them, each has a filter of its own, and the pose does not wait for them.

use crate::support::{BRICK, HEARTBEAT, TestStation, at, config, frame, messages, ticks};
use posebridge_estimator::filters::thermometer::{ThermometerResponse, ThermometerSettings};
use posebridge_estimator::models::dynamic_measurement::DynamicModel;
use posebridge_protocol::message::{Message, WireStamp};
use posebridge_station::{RobotBlock, RobotConfig, RobotMatch, ThermometerConfig};
use posebridge_telemetry::{Address, Celsius, ChannelName, Event, FusionOutcome, Output, ScalarEstimate, SensorId};

/// A board with nothing but thermometers.
const BATH: Address = Address::new(7, 158);

fn named(name: &str, millis: u32, degrees_c: f64) -> Message {
    Message::Thermometer {
        stamp: WireStamp::Millis32(millis),
        channel: ChannelName::from_bytes(name.as_bytes()),
        temperature: Celsius(degrees_c),
    }
}

/// The reading of a sensor of 20 s that was moved from 20 to 50 degrees so long ago.
fn shown_c(since_s: f64) -> f64 {
    50.0 - 30.0 * (-since_s / 20.0).exp()
}

/// A temperature with its report.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TemperatureReport {
    address: Address,
    channel: ChannelName,
    verdict: FusionOutcome,
    settled: Option<ScalarEstimate>,
}

fn temperature_reports(station: &TestStation) -> Vec<TemperatureReport> {
    station.select(|event| match event {
        Event::Temperature { brick, channel, verdict, settled, .. } => {
            Some(TemperatureReport { address: brick.address, channel: *channel, verdict: *verdict, settled: *settled })
        }
        _ => None,
    })
}

/// A robot that drives, and what else comes in the same reads.
fn driven(beside: impl Fn(u32) -> Option<Message>) -> TestStation {
    let mut station = TestStation::new(&config());
    for k in 0..200 {
        let millis = 5_000 + 50 * k;
        let now = at(i64::from(100 + 50 * k));
        let mut bytes = frame(BRICK, &ticks(millis, i64::from(4 * k), i64::from(5 * k)));
        bytes.extend(beside(k).iter().flat_map(|message| frame(BRICK, message)));
        station.bytes(now, &bytes);
    }
    station
}

#[test]
fn the_pose_is_the_same_with_a_thermometer_and_leaves_before_it() {
    let with = driven(|k| Some(named("temp1", 5_000 + 50 * k, shown_c(0.25 * f64::from(k)))));
    let without = driven(|_| None);
    assert_eq!(with.estimates().len(), 200);
    assert_eq!(with.estimates(), without.estimates());
    let is_other = |message: &Message| !matches!(message, Message::NamedValue(_));
    let sent = |station: &TestStation| {
        let all = station.sent().map(|sent| (sent.now, messages(sent.bytes)));
        let others = all.map(|(now, all)| (now, all.into_iter().filter(is_other).collect::<Vec<_>>()));
        others.filter(|(_, others)| !others.is_empty()).collect::<Vec<_>>()
    };
    assert_eq!(sent(&with), sent(&without));

    assert_eq!(temperature_reports(&with).len(), 200);
    let is_temperature = |output: &Output| matches!(output, Output::Event(Event::Temperature { .. }));
    let first_report = with.outputs.iter().position(|(_, output)| is_temperature(output));
    let before = &with.outputs[..first_report.expect("it was told")];
    let first = before.iter().filter(|(now, _)| *now == at(100));
    let has_left = |output: &Output| match output {
        Output::Transmit { bytes, .. } => {
            messages(bytes).iter().any(|message| matches!(message, Message::PlanarPose(_)))
        }
        Output::Event(_) | Output::Request(_) => false,
    };
    assert!(first.into_iter().any(|(_, output)| has_left(output)));

    // Of a sensor of 4 s, two and a half lags after the step.
    let last = temperature_reports(&with)[199].settled.expect("it was read 200 times");
    let error_k = (last.value - 50.0).abs();
    assert!(error_k <= last.bound_95() && error_k < 5.0, "{last:?}");
    // The brick is told, under names that no station takes for a reading.
    let values = with.sent().flat_map(|sent| messages(sent.bytes)).filter_map(|message| match message {
        Message::NamedValue(named) => Some((named.name.to_string(), named.value)),
        _ => None,
    });
    let values: Vec<(String, f32)> = values.collect();
    let newest = |name: &str| values.iter().rfind(|(known, _)| known == name).map(|(_, value)| *value);
    assert_eq!(newest("end_1"), Some(last.value as f32));
    assert_eq!(newest("sd_1"), Some(last.sigma as f32));
}

#[test]
fn a_board_of_thermometers_is_followed_and_is_not_the_robot() {
    let mut station = TestStation::new(&config());
    for k in 0..80 {
        let now = at(i64::from(100 + 250 * k));
        station.bytes(now, &frame(BATH, &HEARTBEAT));
        // Its clock is its own.
        let millis = 777_000 + 250 * k;
        let since_s = 0.25 * f64::from(k);
        station.bytes(now, &frame(BATH, &named("temp_a", millis, shown_c(since_s))));
        station.bytes(now, &frame(BATH, &named("temp_b", millis, 4.0)));
    }
    station.bytes(at(21_000), &frame(BRICK, &ticks(5_000, 0, 0)));
    station.bytes(at(21_050), &frame(BRICK, &ticks(5_050, 4, 4)));
    station.pass_until(at(30_000));
    let robots: Vec<Address> = station.aligned().iter().map(|aligned| aligned.robot.address).collect();
    assert_eq!(robots, [BRICK; 2]);
    let reports = temperature_reports(&station);
    assert_eq!(reports.len(), 160);
    for (name, end_c, least_k) in [("temp_a", 50.0, 0.5), ("temp_b", 4.0, 0.2)] {
        let channel = ChannelName::from_bytes(name.as_bytes());
        let last = reports.iter().rfind(|report| report.channel == channel);
        let last = last.expect("it was told");
        assert_eq!((last.address, last.verdict), (BATH, FusionOutcome::Accepted));
        let settled = last.settled.expect("it was read");
        assert!((settled.value - end_c).abs() < least_k, "{name}: {settled:?}");
    }
}

#[test]
fn damaged_temperatures_are_reported_and_change_nothing() {
    let mut station = TestStation::new(&config());
    station.bytes(at(100), &frame(BATH, &named("temp", 1_000, 20.0)));
    for damaged in [f64::NAN, f64::INFINITY, -300.0, 1e9] {
        station.bytes(at(200), &frame(BATH, &named("temp", 1_100, damaged)));
    }
    // Twice the same instant, and one from before.
    station.bytes(at(300), &frame(BATH, &named("temp", 1_000, 25.0)));
    station.bytes(at(310), &frame(BATH, &named("temp", 900, 25.0)));
    let verdicts: Vec<FusionOutcome> = temperature_reports(&station).iter().map(|report| report.verdict).collect();
    let expected = [FusionOutcome::Accepted, FusionOutcome::Malformed, FusionOutcome::TooOld];
    assert_eq!(verdicts, expected);
    let settled: Vec<_> = temperature_reports(&station).iter().map(|report| report.settled).collect();
    assert!(settled.iter().all(|settled| *settled == settled_first(&station)));
    assert_eq!(station.count(|event| matches!(event, Event::ReceiveError { .. })), 4);
}

fn settled_first(station: &TestStation) -> Option<ScalarEstimate> {
    temperature_reports(station).first().and_then(|report| report.settled)
}

#[test]
fn a_thermometer_that_is_known_knows_the_end_from_a_second_reading() {
    let mut config = config();
    let thermometers = vec![ThermometerConfig {
        channel: ChannelName::from_bytes(b"temp1"),
        settings: ThermometerSettings {
            response: ThermometerResponse::Exact(Box::new(
                DynamicModel::first_order(SensorId::THERMOMETER, 20.0).unwrap(),
            )),
            sigma_k: 0.001,
            resolution_k: 0.0,
        },
    }];
    // The board has a block of its own.
    let matches = RobotMatch { system: Some(BATH.system), ..RobotMatch::default() };
    config.robots = vec![RobotBlock { matches, robot: RobotConfig { thermometers, ..config.robot.clone() } }];
    let mut station = TestStation::new(&config);
    for k in 0..2_u32 {
        let message = named("temp1", 1_000 + 2_000 * k, shown_c(2.0 * f64::from(k)));
        station.bytes(at(100 + 2_000 * i64::from(k)), &frame(BATH, &message));
    }
    let settled = temperature_reports(&station)[1].settled.expect("it was read");
    assert!((settled.value - 50.0).abs() < 1e-3, "{settled:?}");
}

#[test]
fn a_board_that_was_switched_off_and_on_begins_anew() {
    let mut station = TestStation::new(&config());
    let mut send = |now: i64, millis: u32, degrees_c: f64| {
        station.bytes(at(now), &frame(BATH, &named("temp", millis, degrees_c)));
    };
    (0..40).for_each(|k| send(i64::from(250 * k), 90_000 + 250 * k, 20.0));
    for k in 0..20 {
        send(i64::from(15_000 + 250 * k), 1_000 + 250 * k, 63.0);
    }
    let reports = temperature_reports(&station);
    assert_eq!(reports[40].settled, None, "one reading says nothing of what comes");
    let last = reports[59].settled.expect("it rests");
    assert!((last.value - 63.0).abs() < 1e-9, "{last:?}");
}

#[test]
fn invented_channel_names_are_bounded_and_reported_once() {
    let mut station = TestStation::new(&config());
    for k in 0..40_u32 {
        let message = named(&format!("temp{k}"), 1_000 + k, 20.0);
        station.bytes(at(100 + i64::from(k)), &frame(BATH, &message));
    }
    assert_eq!(temperature_reports(&station).len(), 16);
    assert_eq!(station.count(|event| matches!(event, Event::Text { .. })), 1);
}

/// A robot whose filter is that of a slow sensor is told of its first thermometer, and of no other.
#[test]
fn a_filter_of_one_temperature_follows_the_first_thermometer() {
    let mut config = config();
    config.robot.filter = "dynamic-live".to_owned();
    let mut station = TestStation::new(&config);
    for k in 0..40_u32 {
        let millis = 5_000 + 250 * k;
        let mut bytes = frame(BRICK, &ticks(millis, 0, 0));
        bytes.extend(frame(BRICK, &named("temp_a", millis, 20.0)));
        bytes.extend(frame(BRICK, &named("temp_b", millis, 80.0)));
        station.bytes(at(i64::from(100 + 250 * k)), &bytes);
    }
    let quantities = station.select(|event| match event {
        Event::QuantityUpdated { estimate, .. } => Some(estimate.value),
        _ => None,
    });
    assert!(quantities.len() >= 30, "{}", quantities.len());
    assert!(quantities.iter().all(|value| (value - 20.0).abs() < 1e-9), "{quantities:?}");
}

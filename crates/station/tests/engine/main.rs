//! The engine as its callers rely on it: deterministic, never late, never spinning, never panicking.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]

mod any_input;
#[path = "../support/brick.rs"]
mod brick;
mod deadlines;
mod outputs;
#[path = "../support/station.rs"]
mod station;
#[path = "../support/station_simulation.rs"]
mod station_simulation;

use brick::{BRICK, frame, messages, ticks};
use posebridge_protocol::message::{Message, VisionFix, WireStamp};
use posebridge_sim::Scenario;
use posebridge_station::{BuildError, Station, StationConfig};
use posebridge_telemetry::{Command, Event, FusionOutcome, Heading, HostClock, Input, Meters, Pose, Timestamp};
use station::{LINK, STATION, TestStation, at, config, link, stream};
use station_simulation::StationSimulation;

/// Twenty seconds of a simulated robot on a square, with the camera.
fn driven(config: &StationConfig) -> StationSimulation {
    let mut setup = StationSimulation::new(Scenario::default().with_seed(4), config);
    setup.run_for(20);
    setup
}

/// Gives the same inputs to a fresh station.
fn replayed(inputs: &[(Timestamp<HostClock>, Input)]) -> TestStation {
    let mut config = config();
    config.links[0].outputs = all_outputs();
    let mut station = TestStation {
        engine: Station::new(config, Timestamp::ZERO).expect("the configuration is good"),
        inputs: vec![],
        outputs: vec![],
    };
    for (now, input) in inputs {
        station.handle(*now, input.clone());
    }
    station
}

fn all_outputs() -> Vec<posebridge_station::OutputStream> {
    posebridge_station::OUTPUTS.iter().map(|(_, kind)| stream(*kind, 0)).collect()
}

/// The inputs of a drive: bytes, link states, ticks.
fn inputs() -> Vec<(Timestamp<HostClock>, Input)> {
    driven(&config()).station.inputs
}

/// What was observed and fused, in digits that tell any two numbers apart.
fn observed_and_fused(station: &TestStation) -> Vec<String> {
    station
        .events()
        .filter(|event| matches!(event, Event::ObservationAligned { .. } | Event::ObservationFused { .. }))
        .map(|event| format!("{event:?}"))
        .collect()
}

/// The messages that a station sent, in order, with their instants.
fn sent_messages(station: &TestStation) -> Vec<(Timestamp<HostClock>, Message)> {
    let sent = station.sent();
    let said = sent.flat_map(|(now, bytes)| messages(bytes).into_iter().map(move |said| (now, said)));
    said.collect()
}

#[test]
fn the_same_inputs_give_the_same_outputs_bit_for_bit() {
    let inputs = inputs();
    let (one, two) = (replayed(&inputs), replayed(&inputs));
    assert!(one.outputs.len() > 2_000, "{}", one.outputs.len());
    assert!(format!("{:?}", one.outputs) == format!("{:?}", two.outputs));
}

#[test]
fn how_the_bytes_are_cut_changes_neither_what_is_observed_nor_what_is_fused() {
    let inputs = inputs();
    let expected = observed_and_fused(&replayed(&inputs));
    assert!(expected.len() > 1_500, "{}", expected.len());
    for size in [1, 3, 20, 41] {
        let cut: Vec<_> = inputs.iter().flat_map(|(now, input)| cut(*now, input, size)).collect();
        assert!(cut.len() > inputs.len());
        assert!(observed_and_fused(&replayed(&cut)) == expected, "in pieces of {size}");
    }
}

fn cut(now: Timestamp<HostClock>, input: &Input, size: usize) -> Vec<(Timestamp<HostClock>, Input)> {
    let Input::Bytes { link, peer, bytes } = input else {
        return vec![(now, input.clone())];
    };
    let pieces = bytes.chunks(size).map(|piece| {
        let bytes = piece.to_vec();
        (now, Input::Bytes { link: *link, peer: *peer, bytes })
    });
    pieces.collect()
}

#[test]
fn a_robot_drives_on_through_a_link_that_is_cut() {
    let mut setup = StationSimulation::new(Scenario::default().with_seed(5), &config());
    setup.run_for(8);
    setup.cut_for(3);
    setup.run_for(6);
    let truth = setup.simulation.truth().last().expect("it is logged");
    let estimate = setup.station.engine.estimate_at(truth.brick_time).expect("it was observed");
    let error_m = (estimate.pose.x.0 - truth.pose.x.0).hypot(estimate.pose.y.0 - truth.pose.y.0);
    assert!(error_m < 0.05, "{error_m}");
    assert_eq!(estimate.reset_counter, 0);
}

#[test]
fn an_old_fix_that_the_robot_passes_on_is_late_and_no_restart() {
    let mut station = TestStation::new(&config());
    for step in 0..60 {
        let millis = 1_000 + step * 50;
        station.bytes(at(i64::from(millis)), &frame(BRICK, &ticks(millis, 0, 0)));
    }
    let seen = Message::VisionPosition(VisionFix {
        stamp: WireStamp::Micros64(1_500_000),
        x: Meters(0.0),
        y: Meters(0.0),
        heading: Some(Heading::from_rad(0.0)),
        covariance: None,
        reset_counter: 0,
        tag: None,
    });
    station.bytes(at(4_000), &frame(BRICK, &seen));
    assert!(!station.events().any(|event| matches!(event, Event::BrickRestarted { .. })));
    let fix = station.events().find_map(|event| match event {
        Event::ObservationFused { record, .. } if record.kind == "fix" => Some(record.clone()),
        _ => None,
    });
    let fix = fix.expect("it was held against the estimate of its own time");
    assert_eq!(fix.stamp, Timestamp::from_millis(1_500));
    assert_eq!(fix.outcome, FusionOutcome::Accepted);
}

#[test]
fn a_configuration_that_cannot_be_is_refused_with_its_reason() {
    let mut unknown = config();
    unknown.robot.filter = "magic".to_owned();
    let error = Station::new(unknown, Timestamp::ZERO).err().expect("no such filter");
    let told = error.to_string();
    assert!(told.starts_with("unknown filter `magic`; there are: odometry, pose, "), "{told}");
    let mut doubled = config();
    doubled.links.push(link(LINK, vec![]));
    let error = Station::new(doubled, Timestamp::ZERO).err().expect("one id twice");
    assert_eq!(error, BuildError::DuplicateLink { id: LINK });
}

#[test]
fn a_pose_that_is_commanded_is_believed_and_one_that_cannot_be_is_refused_in_words() {
    let mut station = TestStation::new(&config());
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let set = |x_m| {
        Input::Command(Command::SetPose {
            pose: Pose::new(Meters(x_m), Meters(2.0), Heading::from_rad(0.1)),
            position_sigma_m: 0.01,
            heading_sigma_rad: 0.1,
        })
    };
    station.handle(at(200), set(1.5));
    station.handle(at(300), set(f64::NAN));
    let last = station.events().filter_map(|event| match event {
        Event::EstimateUpdated { estimate, .. } => Some(*estimate),
        _ => None,
    });
    let last = last.last().expect("it was told");
    assert_eq!((last.pose.x.0, last.reset_counter), (1.5, 1));
    let texts: Vec<_> = station
        .events()
        .filter_map(|event| match event {
            Event::Text { source, text, .. } => Some((*source, text.as_str())),
            _ => None,
        })
        .collect();
    assert_eq!(
        texts,
        [
            (STATION, "pose set to x 1.500 m, y 2.000 m, 5.7 deg"),
            (STATION, "the pose was not set: a number is not finite or a sigma is negative")
        ]
    );
}

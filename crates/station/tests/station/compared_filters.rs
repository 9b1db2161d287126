//! Filters that run beside the robot's own.

use crate::support::{BRICK, LINK, TestStation, at, config, frame, ticks, vision_fix};
use posebridge_protocol::message::Message;
use posebridge_station::{BuildError, Station};
use posebridge_telemetry::{Address, Command, Event, FilterComparison, Input, Output, Timestamp};

const CAMERA: Address = Address::new(1, 100);

#[test]
fn estimates_leave_before_any_comparison_and_filters_without_fixes_start_at_the_first_known_pose() {
    let mut config = config();
    config.robot.filter_config.start = None;
    config.robot.compared_filters = vec!["odometry".to_owned(), "wheel-kf".to_owned()];
    let mut station = TestStation::new(&config);
    let mut inputs_with_both = 0;
    for k in 0..40 {
        let first = station.outputs.len();
        let mut bytes = frame(BRICK, &ticks(100 * k, 0, 0));
        bytes.extend(frame(CAMERA, &Message::VisionPosition(vision_fix(100 * i64::from(k), 0.25))));
        station.bytes(at(100 * i64::from(k) + 5), &bytes);
        let outputs = &station.outputs[first..];
        let is_sent = |output: &Output| matches!(output, Output::Transmit { link, .. } if *link == LINK);
        let is_compared = |output: &Output| matches!(output, Output::Event(Event::EstimateCompared { .. }));
        let last_sent = outputs.iter().rposition(|(_, output)| is_sent(output));
        let first_compared = outputs.iter().position(|(_, output)| is_compared(output));
        if let (Some(sent), Some(compared)) = (last_sent, first_compared) {
            assert!(sent < compared, "{sent} {compared}");
            inputs_with_both += 1;
        }
    }
    assert!(inputs_with_both > 10, "{inputs_with_both}");
    for name in ["odometry", "wheel-kf"] {
        let valid = station.select(|event| match event {
            Event::EstimateCompared { filter, estimate, .. } if *filter == name && estimate.validity.position => {
                Some(estimate.pose.x.0)
            }
            _ => None,
        });
        assert!(!valid.is_empty(), "{name}");
        assert!(valid.iter().all(|x_m| (x_m - 0.25).abs() < 0.02), "{name}: {valid:?}");
    }
}

#[test]
fn an_unknown_compared_filter_is_refused_by_name() {
    let mut config = config();
    config.robot.compared_filters = vec!["kalman".to_owned()];
    let refused = Station::new(config, Timestamp::ZERO).err();
    assert!(matches!(refused, Some(BuildError::UnknownFilter { name, .. }) if name == "kalman"));
}

#[test]
fn a_comparison_that_is_switched_on_begins_at_the_robots_pose_and_ends_when_switched_off() {
    let mut station = TestStation::new(&config());
    let drive = |station: &mut TestStation, from: u32| {
        for k in from..from + 20 {
            station.bytes(
                at(100 * i64::from(k) + 5),
                &frame(BRICK, &ticks(100 * k, 10 * i64::from(k), 10 * i64::from(k))),
            );
        }
    };
    let compared = |station: &TestStation| {
        station.select(|event| match event {
            Event::EstimateCompared { filter: "odometry", estimate, .. } => Some(estimate.pose.x.0),
            _ => None,
        })
    };
    drive(&mut station, 0);
    assert!(compared(&station).is_empty());
    station.handle(at(2_000), Input::Command(Command::CompareFilters(FilterComparison::On)));
    drive(&mut station, 20);
    let (x_m, own_m) = (compared(&station), station.last_estimate().pose.x.0);
    assert!(own_m > 0.15, "{own_m}");
    assert!(x_m.last().is_some_and(|x_m| (x_m - own_m).abs() < 0.01), "{x_m:?} {own_m}");
    station.handle(at(4_000), Input::Command(Command::CompareFilters(FilterComparison::Off)));
    let before = compared(&station).len();
    drive(&mut station, 40);
    assert_eq!(compared(&station).len(), before);
    assert_eq!(station.texts().last(), Some(&"filters are compared no longer"));
}

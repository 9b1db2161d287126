//! The set-up checklist over the events of a robot that is plugged in, driven, and unplugged.

use posebridge_report::setup_checklist::{ChecklistItem, SetupChecklist, SetupStep, StepState, is_complete};
use posebridge_telemetry::{
    Address, Event, HostClock, LinkHealth, LinkId, LinkState, Observation, ObservationKind, Radians, RadiansPerSecond,
    RobotId, SensorId, TimeDelta, Timestamp,
};

const ROBOT: RobotId = RobotId { link: LinkId(0), address: Address::new(1, 1) };

fn at(second: i64) -> Timestamp<HostClock> {
    Timestamp::from_nanos(second * 1_000_000_000)
}

fn health(bytes_in: u64, frames_in: u64, frames_out: u64) -> Event {
    let health = LinkHealth { bytes_in, frames_in, frames_out, ..LinkHealth::default() };
    Event::Health { link: LinkId(0), health, sources: Vec::new() }
}

fn aligned(second: i64, sensor: SensorId, measurement: ObservationKind) -> Event {
    let stamp = Timestamp::from_nanos(second * 1_000_000_000);
    let observation = Observation { sensor, stamp, stamp_sigma: TimeDelta::ZERO, measurement };
    Event::ObservationAligned { robot: ROBOT, source: ROBOT.address, arrival: at(second), observation }
}

fn state(items: &[ChecklistItem], step: SetupStep) -> Option<StepState> {
    items.iter().find(|item| item.step == step).map(|item| item.state)
}

#[derive(Clone, Copy, PartialEq)]
enum Motion {
    RightWheel,
    BothWheels,
}

/// A robot of which wheel counts, gyro readings and answers come once per second; each wheel of the motion turns by 1 rad in each.
fn feed(checklist: &mut SetupChecklist, seconds: std::ops::Range<i64>, motion: Motion) {
    for second in seconds {
        let count = second as u64;
        checklist.observe(at(second), &health(400 * count, 20 * count, 5 * count));
        let (left, right) =
            (Radians(if motion == Motion::BothWheels { second as f64 } else { 0.0 }), Radians(second as f64));
        checklist.observe(at(second), &aligned(second, SensorId::WHEELS, ObservationKind::WheelAngles { left, right }));
        let rate = ObservationKind::TurnRate(RadiansPerSecond(0.0));
        checklist.observe(at(second), &aligned(second, SensorId::GYRO, rate));
        let clock = Event::BrickClockAligned {
            robot: ROBOT,
            offset: TimeDelta::ZERO,
            skew_ppm: 0.0,
            uncertainty: TimeDelta::from_millis(2),
            round_trip: Some(TimeDelta::from_millis(4)),
            brick: Timestamp::ZERO,
            host: at(second),
        };
        checklist.observe(at(second), &clock);
    }
}

#[test]
fn each_step_waits_for_the_one_before() {
    let mut checklist = SetupChecklist::default();
    let nothing = checklist.items(at(0), None);
    assert_eq!(state(&nothing, SetupStep::Link), Some(StepState::Waiting));
    checklist.observe(at(0), &Event::Link { link: LinkId(0), state: LinkState::Up });
    checklist.observe(at(1), &health(900, 0, 0));
    checklist.observe(at(2), &health(1_800, 0, 0));
    let noise = checklist.items(at(2), None);
    let steps =
        [SetupStep::Link, SetupStep::Bytes, SetupStep::Frames, SetupStep::Wheels].map(|step| state(&noise, step));
    let expected = [StepState::Done, StepState::Done, StepState::Problem, StepState::Waiting];
    assert_eq!(steps, expected.map(Some));
    let frames = noise.iter().find(|item| item.step == SetupStep::Frames).unwrap();
    assert_eq!(frames.figure, "none in 1800 bytes");
    assert!(frames.advice.contains("baud rate"), "{}", frames.advice);
}

#[test]
fn a_wheel_that_does_not_count_is_named() {
    let mut checklist = SetupChecklist::default();
    feed(&mut checklist, 1..6, Motion::RightWheel);
    let items = checklist.items(at(5), None);
    let wheels = items.iter().find(|item| item.step == SetupStep::Wheels).unwrap();
    assert_eq!((wheels.state, wheels.figure.as_str()), (StepState::Waiting, "1 Hz, the left one has not turned"));
    feed(&mut checklist, 6..12, Motion::BothWheels);
    assert_eq!(state(&checklist.items(at(11), None), SetupStep::Wheels), Some(StepState::Done));
}

#[test]
fn a_pulled_plug_is_a_problem_and_is_forgiven_when_it_is_back() {
    let mut checklist = SetupChecklist::default();
    checklist.observe(at(0), &Event::Link { link: LinkId(0), state: LinkState::Up });
    feed(&mut checklist, 1..10, Motion::BothWheels);
    let items = checklist.items(at(9), None);
    for step in
        [SetupStep::Link, SetupStep::Bytes, SetupStep::Frames, SetupStep::Wheels, SetupStep::Clock, SetupStep::Answer]
    {
        assert_eq!(state(&items, step), Some(StepState::Done), "{step:?}");
    }
    checklist.observe(at(10), &Event::Link { link: LinkId(0), state: LinkState::Down });
    for second in 10..30 {
        checklist.observe(at(second), &health(400 * 9, 20 * 9, 5 * 9));
    }
    let items = checklist.items(at(29), None);
    for step in [SetupStep::Link, SetupStep::Bytes, SetupStep::Wheels, SetupStep::Answer] {
        assert_eq!(state(&items, step), Some(StepState::Problem), "{step:?}");
    }
    assert!(!is_complete(&items));
    checklist.observe(at(30), &Event::Link { link: LinkId(0), state: LinkState::Up });
    feed(&mut checklist, 30..34, Motion::BothWheels);
    let items = checklist.items(at(33), None);
    assert!(items.iter().all(|item| item.state != StepState::Problem), "{items:?}");
}

#[test]
fn a_finding_of_the_wiring_is_a_problem() {
    let mut checklist = SetupChecklist::default();
    feed(&mut checklist, 1..4, Motion::BothWheels);
    let items = checklist.items(at(3), Some("the gyro is reversed".to_owned()));
    let wiring = items.iter().find(|item| item.step == SetupStep::Wiring).unwrap();
    assert_eq!((wiring.state, wiring.figure.as_str()), (StepState::Problem, "the gyro is reversed"));
    assert!(wiring.advice.contains("--fix-wiring"));
}

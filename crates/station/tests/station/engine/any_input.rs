//! Whatever comes: random bytes, numbers, links and instants.

use super::all_outputs;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, config, frame, ticks};
use posebridge_telemetry::{
    Address, Command, Event, Heading, Input, LinkId, LinkState, Meters, Observation, ObservationKind, Ownership,
    Point2, Pose, Radians, RobotId, RobotSnapshot, SensorId, SensorSwitch, SimulatorCommand, TimeDelta, Timestamp,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Any input, with the time since the one before in milliseconds.
fn any_input() -> impl Strategy<Value = (i64, Input)> {
    let link = prop_oneof![4 => Just(LINK), 1 => Just(LinkId(9))];
    let tempting = prop_oneof![3 => any::<u8>(), 1 => Just(0xFD_u8), 2 => 0_u8..10];
    let frames = (any::<u32>(), any::<i32>(), any::<u8>()).prop_map(|(millis, count, component)| {
        let source = Address::new(1, component % 3);
        let count = i64::from(count);
        frame(source, &ticks(millis / 1_000, count, -count))
    });
    let bytes = prop_oneof![
        2 => prop::collection::vec(tempting, 0..300),
        2 => frames,
        1 => Just(frame(BRICK, &HEARTBEAT)),
    ];
    let peer = (0_u32..3).prop_map(posebridge_telemetry::PeerId);
    let bytes = (link.clone(), peer, bytes).prop_map(|(link, peer, bytes)| Input::Bytes { link, peer, bytes });
    let state = prop_oneof![Just(LinkState::Up), Just(LinkState::Down)];
    let state = (link, state).prop_map(|(link, state)| Input::Link { link, state });
    let number = prop_oneof![4 => -100.0..100.0, 1 => any::<f64>()];
    let numbers = (number.clone(), number.clone(), number, any::<i64>(), 0_u8..7);
    let values = numbers.prop_map(|(a, b, c, nanos, kind)| input_of((a, b, c), nanos, kind));
    let wait_ms = prop_oneof![6 => 0_i64..120, 1 => 0_i64..100_000, 1 => any::<u32>().prop_map(i64::from)];
    let input = prop_oneof![6 => bytes, 1 => state, 3 => values, 1 => Just(Input::Tick)];
    (wait_ms, input)
}

fn input_of((a, b, c): (f64, f64, f64), nanos: i64, kind: u8) -> Input {
    let observed = match kind {
        0 => {
            return Input::Command(Command::SetPose {
                pose: Pose::new(Meters(a), Meters(b), Heading::from_rad(c)),
                position_sigma_m: a,
                heading_sigma_rad: b,
            });
        }
        5 => {
            let link = if nanos % 5 == 0 { LinkId(9) } else { LINK };
            let robot = RobotId { link, address: Address::new(1, (nanos % 3) as u8) };
            let to = if a > b { SensorSwitch::On } else { SensorSwitch::Off };
            let switch = Command::SwitchSource { sensor: SensorId((nanos % 4) as u8), to };
            let command = if nanos % 2 == 0 { Command::ResetPose } else { switch };
            return Input::RobotCommand { robot, command };
        }
        6 => {
            let robot = RobotId { link: LINK, address: Address::new(1, (nanos % 3) as u8) };
            let epoch = nanos.unsigned_abs();
            let bytes = nanos.to_le_bytes().into_iter().cycle().take((nanos % 50).unsigned_abs() as usize).collect();
            let state = (a > 0.0).then_some(RobotSnapshot { bytes, clock_offset: TimeDelta::from_nanos(nanos) });
            let ownership = if a > b { Ownership::Owner { epoch, state } } else { Ownership::Standby { epoch } };
            return Input::Ownership { robot, ownership };
        }
        4 => {
            return Input::Command(Command::Simulator(SimulatorCommand::Kidnap {
                forward_m: a,
                left_m: b,
                turn_rad: c,
            }));
        }
        1 => ObservationKind::TurnRate(posebridge_telemetry::RadiansPerSecond(a)),
        2 => ObservationKind::WheelAngles { left: Radians(a), right: Radians(b) },
        _ => ObservationKind::Fix(posebridge_telemetry::Fix {
            position: Point2::new(Meters(a), Meters(b)),
            heading: Some(Heading::from_rad(c)),
            covariance: None,
            tag_in_body: Point2::new(Meters(c), Meters(a)),
            reset_counter: 0,
        }),
    };
    Input::Observation(Observation {
        sensor: SensorId(kind),
        // Mostly within some seconds, now and then anywhere.
        stamp: Timestamp::from_nanos(if nanos % 7 == 0 { nanos } else { nanos % 5_000_000_000 }),
        stamp_sigma: TimeDelta::from_nanos(nanos % 50_000_000),
        measurement: observed,
    })
}

fn cases() -> ProptestConfig {
    ProptestConfig {
        cases: 300,
        rng_seed: RngSeed::Fixed(20_260_103),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn for_any_input_the_engine_neither_panics_nor_spins(
        inputs in prop::collection::vec(any_input(), 1..60),
        begin in prop_oneof![3 => Just(0_i64), 1 => any::<i64>(), 1 => Just(i64::MAX - 5)],
    ) {
        let mut config = config();
        config.links[0].outputs = all_outputs();
        let mut station = TestStation::new(&config);
        let mut now = Timestamp::from_nanos(begin.max(0));
        for (wait_ms, input) in inputs {
            now = now + TimeDelta::from_millis(wait_ms);
            station.handle(now, input);
            let due = station.engine.deadline().expect("there is always a heartbeat");
            // At the end of all time there is no later instant.
            prop_assert!(due > now || due == Timestamp::from_nanos(i64::MAX), "{due:?} at {now:?}");
        }
    }

    #[test]
    fn a_compared_filter_like_the_robots_own_agrees_with_it_for_any_input(
        inputs in prop::collection::vec(any_input(), 1..60),
    ) {
        let mut config = config();
        config.robot.compared_filters = vec![config.robot.filter.clone()];
        let mut station = TestStation::new(&config);
        let mut now = Timestamp::ZERO;
        for (wait_ms, input) in inputs {
            now = now + TimeDelta::from_millis(wait_ms);
            station.handle(now, input);
        }
        station.handle(now, Input::Tick);
        // As text, in which no number differs from itself.
        let own = station.select(|event| match event {
            Event::EstimateUpdated { robot, estimate } => Some(format!("{robot:?} {estimate:?}")),
            Event::ObservationFused { robot, record } => Some(format!("{robot:?} {record:?}")),
            _ => None,
        });
        let compared = station.select(|event| match event {
            Event::EstimateCompared { robot, estimate, .. } => Some(format!("{robot:?} {estimate:?}")),
            Event::ObservationCompared { robot, record, .. } => Some(format!("{robot:?} {record:?}")),
            _ => None,
        });
        // Robots take turns within an input, so only the sums of their events have the same order.
        let sorted = |mut events: Vec<String>| { events.sort(); events };
        prop_assert_eq!(sorted(own), sorted(compared));
    }
}

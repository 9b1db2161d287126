//! Whatever others send: no panic, bounded tables, and the robots that are heard here are served.

use posebridge_fleet::{
    Epoch, Input, Output, Ownership, OwnershipConfig, OwnershipToken, QueryId, Reception, RobotName, RobotRole,
    StateAnswer, StateSnapshot, StationId, StationName,
};
use posebridge_telemetry::TimeDelta;
use proptest::prelude::*;

use crate::steps::{at, connected, epoch, give, robot, station, token, wait};

fn named(text: &str) -> RobotName {
    RobotName::new(text).expect("a name")
}

#[test]
fn a_flood_of_tokens_is_refused_and_a_robot_that_is_heard_gets_its_place_all_the_same() {
    let mut ownership = connected();
    for index in 0..10_000 {
        let input = Input::TokenAppeared { robot: named(&format!("r{index}")), token: token(1, "evil") };
        assert_eq!(give(&mut ownership, 0, input), []);
    }
    assert_eq!(ownership.refusals().robots, 10_000 - 256);
    give(&mut ownership, 1, Input::RobotHeard { robot: robot() });
    assert_eq!(ownership.role(&robot()), RobotRole::StandBy);
    // The owner's own token was refused, perhaps: its answer tells.
    let (heard_ago, silent_in) = (TimeDelta::ZERO, TimeDelta::from_millis(150));
    let answer = StateAnswer::Serving { epoch: epoch(7), heard_ago, silent_in };
    give(&mut ownership, 2, Input::StateAnswer { from: station("a"), robot: robot(), id: QueryId(1), answer });
    assert_eq!(ownership.owner(&robot()), Some(token(7, "a")));
}

#[test]
fn more_robots_than_the_limit_are_refused_and_those_that_are_served_stay() {
    let mut ownership = connected();
    for index in 0..300 {
        give(&mut ownership, 0, Input::RobotHeard { robot: named(&format!("r{index}")) });
    }
    assert_eq!(ownership.refusals().robots, 300 - 256);
    wait(&mut ownership, 300);
    assert_eq!(ownership.role(&named("r0")), RobotRole::Owner(Epoch::FIRST));
    assert_eq!(ownership.role(&named("r299")), RobotRole::None);
}

#[test]
fn many_tokens_of_one_robot_leave_the_highest_and_many_stations_the_first() {
    let mut ownership = connected();
    for number in 1..=100 {
        let token = OwnershipToken { epoch: epoch(number), station: station("evil") };
        give(&mut ownership, 0, Input::TokenAppeared { robot: robot(), token });
        give(&mut ownership, 0, Input::StationAppeared(station(&format!("s{number}"))));
    }
    assert_eq!(ownership.owner(&robot()), Some(token(100, "evil")));
    assert_eq!(ownership.refusals().tokens, 36);
    assert_eq!(ownership.refusals().stations, 37);
}

#[test]
fn what_was_not_asked_is_not_used() {
    let mut ownership = connected();
    give(&mut ownership, 0, Input::TokenAppeared { robot: robot(), token: token(3, "a") });
    let outputs = give(&mut ownership, 0, Input::RobotHeard { robot: robot() });
    let [Output::QueryState { id, .. }] = outputs[..] else { panic!("{outputs:?}") };
    let state = StateSnapshot { epoch: epoch(900), age: TimeDelta::ZERO, bytes: vec![1] };
    let hand_over = |from: &str, id| Input::StateAnswer {
        from: station(from),
        robot: robot(),
        id,
        answer: StateAnswer::HandOver(state.clone()),
    };
    assert_eq!(give(&mut ownership, 1, hand_over("evil", id)), []);
    assert_eq!(give(&mut ownership, 1, hand_over("a", QueryId(77))), []);
    let published = |from: &str, number, len| Input::StatePublished {
        from: station(from),
        robot: robot(),
        reception: Reception::Silent,
        state: StateSnapshot { epoch: epoch(number), age: TimeDelta::ZERO, bytes: vec![1; len] },
    };
    for input in [published("evil", 3, 1), published("a", 4, 1), published("a", 3, 524_289)] {
        assert_eq!(give(&mut ownership, 1, input), []);
    }
    give(&mut ownership, 1, Input::TokenAppeared { robot: robot(), token: token(9, "b") });
    assert_eq!(ownership.refusals().answers, 2);
    assert_eq!(ownership.refusals().states, 3);
    assert_eq!(ownership.refusals().own_id, 1);
    assert_eq!(ownership.owner(&robot()), Some(token(3, "a")));
}

#[test]
fn at_the_last_epoch_stations_settle_by_their_ids_and_the_robot_is_served_when_the_token_goes() {
    let mut ownership = connected();
    let last = |name: &str| OwnershipToken { epoch: Epoch::LAST, station: station(name) };
    give(&mut ownership, 0, Input::TokenAppeared { robot: robot(), token: last("c") });
    let mut exhausted = 0;
    for millis in (0..10_000).step_by(20) {
        let outputs = give(&mut ownership, millis, Input::RobotHeard { robot: robot() });
        exhausted += outputs.iter().filter(|output| matches!(output, Output::Event(_))).count();
        assert_eq!(ownership.role(&robot()), RobotRole::StandBy, "`c` is above `b`");
    }
    assert!((3..=6).contains(&exhausted), "{exhausted}");
    give(&mut ownership, 10_000, Input::TokenVanished { robot: robot(), token: last("c") });
    assert_eq!(ownership.role(&robot()), RobotRole::Owner(Epoch::LAST));
    // Below this station: it stays the owner.
    give(&mut ownership, 10_001, Input::TokenAppeared { robot: robot(), token: last("a") });
    assert_eq!(ownership.owner(&robot()), Some(last("b")));
}

fn any_station() -> impl Strategy<Value = StationId> {
    (0..4_usize, 0..3_u64).prop_map(|(name, instance)| StationId {
        name: StationName::new(["a", "b", "c", "d"][name]).expect("a name"),
        instance,
    })
}

fn any_robot() -> impl Strategy<Value = RobotName> {
    (0..6_usize).prop_map(|index| named(["r0", "r1", "r2", "r3", "r4", "r5"][index]))
}

fn any_epoch() -> impl Strategy<Value = Epoch> {
    prop_oneof![1..6_u32, u32::MAX - 3..=u32::MAX].prop_map(epoch)
}

fn any_delta() -> impl Strategy<Value = TimeDelta> {
    prop_oneof![-1_000_000_000..10_000_000_000_i64, any::<i64>()].prop_map(TimeDelta::from_nanos)
}

fn any_state() -> impl Strategy<Value = StateSnapshot> {
    (any_epoch(), any_delta(), 0..12_usize).prop_map(|(epoch, age, len)| StateSnapshot {
        epoch,
        age,
        bytes: vec![1; len],
    })
}

fn any_token() -> impl Strategy<Value = OwnershipToken> {
    (any_epoch(), any_station()).prop_map(|(epoch, station)| OwnershipToken { epoch, station })
}

fn any_answer() -> impl Strategy<Value = StateAnswer> {
    prop_oneof![
        (any_epoch(), any_delta(), any_delta()).prop_map(|(epoch, heard_ago, silent_in)| StateAnswer::Serving {
            epoch,
            heard_ago,
            silent_in
        }),
        any_state().prop_map(StateAnswer::HandOver),
        Just(StateAnswer::Promised),
        (prop::option::of(any_token()), prop::option::of(any_epoch()), prop::option::of(any_state()))
            .prop_map(|(owner, highest_epoch, state)| StateAnswer::NotOwner { owner, highest_epoch, state }),
    ]
}

fn any_input() -> impl Strategy<Value = Input> {
    let reception = prop_oneof![Just(Reception::Heard), Just(Reception::Silent)];
    prop_oneof![
        6 => any_robot().prop_map(|robot| Input::RobotHeard { robot }),
        1 => any_robot().prop_map(|robot| Input::RobotLinkClosed { robot }),
        3 => (any_robot(), any_token()).prop_map(|(robot, token)| Input::TokenAppeared { robot, token }),
        3 => (any_robot(), any_token()).prop_map(|(robot, token)| Input::TokenVanished { robot, token }),
        2 => any_station().prop_map(Input::StationAppeared),
        1 => any_station().prop_map(Input::StationVanished),
        3 => (any_station(), any_robot(), 0..9_u64, any_delta()).prop_map(|(from, robot, id, heard_for)| {
            Input::StateQuery { from, robot, id: QueryId(id), heard_for }
        }),
        3 => (any_station(), any_robot(), 0..40_u64, any_answer()).prop_map(|(from, robot, id, answer)| {
            Input::StateAnswer { from, robot, id: QueryId(id), answer }
        }),
        2 => (any_station(), any_robot(), reception, any_state()).prop_map(|(from, robot, reception, state)| {
            Input::StatePublished { from, robot, reception, state }
        }),
        2 => Just(Input::FleetConfirmed),
        1 => Just(Input::FleetDisconnected),
        1 => Just(Input::Tick),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 400,
        failure_persistence: None,
        rng_seed: proptest::test_runner::RngSeed::Fixed(20_261_130),
        ..ProptestConfig::default()
    })]

    #[test]
    fn for_any_inputs_tokens_are_declared_once_outputs_are_few_and_an_owner_is_above_all_it_knows(
        steps in prop::collection::vec((any_input(), 0..400_000_000_i64), 1..150),
    ) {
        let config = OwnershipConfig { max_robots: 4, max_stations: 3, max_state_len: 8, ..OwnershipConfig::default() };
        let own = StationId { name: StationName::new("b").expect("a name"), instance: 1 };
        let mut ownership = Ownership::new(config, own.clone(), at(0));
        let mut now_ns = 0;
        let mut declared = std::collections::BTreeSet::new();
        for (input, wait_ns) in steps {
            now_ns += wait_ns;
            let now = posebridge_telemetry::Timestamp::from_nanos(now_ns);
            ownership.handle(now, input);
            let mut count = 0;
            while let Some(output) = ownership.poll() {
                count += 1;
                if let Output::DeclareToken { robot, epoch } = output {
                    prop_assert!(declared.insert((robot, epoch)));
                } else if let Output::WithdrawToken { robot, epoch } = output {
                    prop_assert!(declared.remove(&(robot, epoch)));
                }
            }
            prop_assert!(count <= 40, "{count} outputs");
            prop_assert!(ownership.deadline().is_none_or(|deadline| deadline > now), "time stands still");
            for index in 0..6 {
                let robot = named(&format!("r{index}"));
                if let RobotRole::Owner(epoch) = ownership.role(&robot) {
                    prop_assert_eq!(ownership.owner(&robot), Some(OwnershipToken { epoch, station: own.clone() }));
                    prop_assert!(declared.contains(&(robot, epoch)));
                }
            }
        }
    }
}

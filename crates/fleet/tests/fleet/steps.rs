//! Single steps of the protocol, with the outputs in their order.

use posebridge_fleet::{
    AnswerContent, ClaimReason, Epoch, Input, Output, Ownership, OwnershipConfig, OwnershipEvent, OwnershipToken,
    QueryId, QueryTarget, Reception, RobotName, RobotRole, StartState, StateAnswer, StateSnapshot, StationId,
    StationName, StopReason,
};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

pub(crate) fn at(millis: i64) -> Timestamp<HostClock> {
    Timestamp::from_millis(millis)
}

pub(crate) fn station(name: &str) -> StationId {
    StationId { name: StationName::new(name).expect("a name"), instance: 1 }
}

pub(crate) fn robot() -> RobotName {
    RobotName::new("nxt").expect("a name")
}

pub(crate) fn epoch(number: u32) -> Epoch {
    Epoch::new(number).expect("not zero")
}

pub(crate) fn token(number: u32, name: &str) -> OwnershipToken {
    OwnershipToken { epoch: epoch(number), station: station(name) }
}

pub(crate) fn give(ownership: &mut Ownership, millis: i64, input: Input) -> Vec<Output> {
    ownership.handle(at(millis), input);
    std::iter::from_fn(|| ownership.poll()).collect()
}

/// Lets time pass in ticks until `millis`.
pub(crate) fn wait(ownership: &mut Ownership, millis: i64) -> Vec<Output> {
    let mut outputs = Vec::new();
    while let Some(deadline) = ownership.deadline().filter(|deadline| *deadline <= at(millis)) {
        ownership.handle(deadline, Input::Tick);
        outputs.extend(std::iter::from_fn(|| ownership.poll()));
    }
    outputs
}

/// Station `b` at time 0, confirmed, with `a` connected.
pub(crate) fn connected() -> Ownership {
    let mut ownership = Ownership::new(OwnershipConfig::default(), station("b"), at(0));
    give(&mut ownership, 0, Input::StationAppeared(station("a")));
    give(&mut ownership, 0, Input::FleetConfirmed);
    ownership
}

/// Station `b` owns the robot with epoch 4, and heard it at 100 Hz until 500 ms.
fn owner() -> Ownership {
    let mut ownership = connected();
    give(&mut ownership, 1, Input::TokenAppeared { robot: robot(), token: token(3, "a") });
    give(&mut ownership, 1, Input::RobotHeard { robot: robot() });
    give(&mut ownership, 1, Input::TokenVanished { robot: robot(), token: token(3, "a") });
    for millis in (10..=500).step_by(10) {
        give(&mut ownership, millis, Input::RobotHeard { robot: robot() });
    }
    assert_eq!(ownership.role(&robot()), RobotRole::Owner(epoch(4)));
    ownership
}

fn snapshot(number: u32) -> StateSnapshot {
    StateSnapshot { epoch: epoch(number), age: TimeDelta::ZERO, bytes: vec![7] }
}

fn query(from: &str, heard_for_ms: i64) -> Input {
    let heard_for = TimeDelta::from_millis(heard_for_ms);
    Input::StateQuery { from: station(from), robot: robot(), id: QueryId(9), heard_for }
}

fn answers<'a>(outputs: &'a [Output]) -> Vec<&'a AnswerContent> {
    let content = |output: &'a Output| {
        let Output::AnswerState { content, .. } = output else { return None };
        Some(content)
    };
    outputs.iter().filter_map(content).collect()
}

#[test]
fn nothing_is_claimed_before_the_fleet_is_confirmed_and_a_lone_station_serves_after_the_grace() {
    let mut ownership = Ownership::new(OwnershipConfig::default(), station("b"), at(0));
    assert_eq!(ownership.poll(), Some(Output::ConfirmFleet));
    assert_eq!(give(&mut ownership, 10, Input::RobotHeard { robot: robot() }), []);
    assert_eq!(give(&mut ownership, 20, Input::FleetDisconnected), []);
    for millis in (100..1_999).step_by(100) {
        assert_eq!(give(&mut ownership, millis, Input::RobotHeard { robot: robot() }), []);
    }
    let epoch = Epoch::FIRST;
    let expected = [
        Output::DeclareToken { robot: robot(), epoch },
        Output::Start { robot: robot(), epoch, state: StartState::Cold },
        Output::Event(OwnershipEvent::Started { robot: robot(), epoch, reason: ClaimReason::Unowned }),
    ];
    assert_eq!(wait(&mut ownership, 2_000), expected);
    assert_eq!(ownership.permit(at(2_000), &robot()), Some(epoch));
}

#[test]
fn a_robot_of_which_nothing_is_known_is_claimed_when_everybody_has_answered() {
    let mut ownership = connected();
    give(&mut ownership, 0, Input::StationAppeared(station("c")));
    let (target, id, heard_for) = (QueryTarget::Everyone, QueryId(1), TimeDelta::ZERO);
    let asked = give(&mut ownership, 5, Input::RobotHeard { robot: robot() });
    assert_eq!(asked, [Output::QueryState { robot: robot(), target, id, heard_for }]);
    let from = |name, highest: Option<u32>, state| Input::StateAnswer {
        from: station(name),
        robot: robot(),
        id: QueryId(1),
        answer: StateAnswer::NotOwner { owner: None, highest_epoch: highest.and_then(Epoch::new), state },
    };
    assert_eq!(give(&mut ownership, 10, from("a", Some(8), Some(snapshot(6)))), []);
    assert_eq!(give(&mut ownership, 11, from("a", Some(8), None)), []);
    let outputs = give(&mut ownership, 30, from("c", Some(2), None));
    let aged = StateSnapshot { age: TimeDelta::from_millis(20), ..snapshot(6) };
    let start = Output::Start { robot: robot(), epoch: epoch(9), state: StartState::Received(aged) };
    assert_eq!(outputs[1], start);
}

#[test]
fn a_station_that_cannot_reach_an_owner_yet_of_which_others_tell_waits_for_the_rejoin() {
    let mut ownership = connected();
    let mut claimed_at = None;
    for millis in (10..3_000).step_by(10) {
        let mut outputs = give(&mut ownership, millis, Input::RobotHeard { robot: robot() });
        while let Some(Output::QueryState { id, .. }) = outputs.pop() {
            let answer =
                StateAnswer::NotOwner { owner: Some(token(5, "z")), highest_epoch: Some(epoch(5)), state: None };
            outputs =
                give(&mut ownership, millis, Input::StateAnswer { from: station("a"), robot: robot(), id, answer });
        }
        if claimed_at.is_none() && ownership.role(&robot()) == RobotRole::Owner(epoch(6)) {
            claimed_at = Some(millis);
        }
    }
    assert!(claimed_at.is_some_and(|millis| (1_900..2_400).contains(&millis)), "{claimed_at:?}");
}

#[test]
fn an_owner_that_hears_the_robot_says_so_and_one_that_does_not_hands_over_before_it_stops() {
    let mut ownership = owner();
    let outputs = give(&mut ownership, 510, query("a", 0));
    let (heard_ago, silent_in) = (TimeDelta::from_millis(10), TimeDelta::from_millis(140));
    assert_eq!(answers(&outputs), [&AnswerContent::Serving { epoch: epoch(4), heard_ago, silent_in }]);
    wait(&mut ownership, 650);
    let content = AnswerContent::HandOver { epoch: epoch(4) };
    let answer = Output::AnswerState { to: station("a"), robot: robot(), id: QueryId(9), content };
    let reason = StopReason::HandedOver(station("a"));
    let expected = [
        answer.clone(),
        Output::Stop { robot: robot() },
        Output::Event(OwnershipEvent::Stopped { robot: robot(), epoch: epoch(4), reason }),
    ];
    assert_eq!(give(&mut ownership, 650, query("a", 0)), expected);
    assert_eq!(ownership.permit(at(650), &robot()), None);
    // The answer may have been lost.
    assert_eq!(give(&mut ownership, 700, query("a", 0)), [answer]);
    assert_eq!(answers(&give(&mut ownership, 700, query("c", 0))), [&AnswerContent::Promised]);
    // The token stays until everybody has heard of the new one.
    assert_eq!(wait(&mut ownership, 900), []);
    assert_eq!(give(&mut ownership, 900, Input::TokenAppeared { robot: robot(), token: token(5, "a") }), []);
    assert_eq!(wait(&mut ownership, 1_099), []);
    assert_eq!(wait(&mut ownership, 1_100), [Output::WithdrawToken { robot: robot(), epoch: epoch(4) }]);
}

#[test]
fn a_stand_by_takes_what_is_handed_over_also_when_it_has_lost_the_robot_meanwhile() {
    let mut ownership = connected();
    give(&mut ownership, 1, Input::TokenAppeared { robot: robot(), token: token(3, "a") });
    give(&mut ownership, 2, Input::RobotHeard { robot: robot() });
    give(&mut ownership, 3, Input::RobotLinkClosed { robot: robot() });
    let answer = StateAnswer::HandOver(snapshot(3));
    let input = Input::StateAnswer { from: station("a"), robot: robot(), id: QueryId(1), answer };
    let reason = ClaimReason::HandedOver(station("a"));
    let expected = [
        Output::DeclareToken { robot: robot(), epoch: epoch(4) },
        Output::Start { robot: robot(), epoch: epoch(4), state: StartState::Received(snapshot(3)) },
        Output::Event(OwnershipEvent::Started { robot: robot(), epoch: epoch(4), reason }),
    ];
    assert_eq!(give(&mut ownership, 20, input), expected);
}

#[test]
fn a_hand_over_that_nobody_takes_ends_and_the_robot_can_be_claimed_again() {
    let mut ownership = owner();
    wait(&mut ownership, 650);
    give(&mut ownership, 650, query("a", 0));
    for millis in (700..1_150).step_by(50) {
        assert_eq!(give(&mut ownership, millis, Input::RobotHeard { robot: robot() }), []);
    }
    let outputs = wait(&mut ownership, 1_150);
    assert_eq!(outputs[0], Output::WithdrawToken { robot: robot(), epoch: epoch(4) });
    assert_eq!(outputs[2], Output::Start { robot: robot(), epoch: epoch(5), state: StartState::Kept });
}

#[test]
fn a_higher_token_stops_the_owner_at_once_and_a_lower_one_does_not() {
    let mut ownership = owner();
    assert_eq!(give(&mut ownership, 500, Input::TokenAppeared { robot: robot(), token: token(4, "a") }), []);
    let winner = token(4, "c");
    let outputs = give(&mut ownership, 500, Input::TokenAppeared { robot: robot(), token: winner.clone() });
    assert_eq!(outputs[0], Output::Stop { robot: robot() });
    assert_eq!(ownership.owner(&robot()), Some(winner));
    assert_eq!(ownership.role(&robot()), RobotRole::StandBy);
}

#[test]
fn an_owner_announces_silence_publishes_each_second_and_releases_after_thirty() {
    let mut ownership = owner();
    let publications = |outputs: &[Output]| {
        let count = |wanted| {
            let is_wanted =
                |output: &&Output| matches!(output, Output::PublishState { reception, .. } if *reception == wanted);
            outputs.iter().filter(is_wanted).count()
        };
        (count(Reception::Heard), count(Reception::Silent))
    };
    assert_eq!(publications(&wait(&mut ownership, 799)), (0, 0));
    assert_eq!(publications(&wait(&mut ownership, 800)), (0, 1));
    let outputs = wait(&mut ownership, 30_499);
    assert_eq!(publications(&outputs), (0, 29));
    assert_eq!(ownership.role(&robot()), RobotRole::Owner(epoch(4)));
    let outputs = wait(&mut ownership, 30_500);
    assert_eq!(outputs[0], Output::Stop { robot: robot() });
    assert_eq!(outputs[2], Output::WithdrawToken { robot: robot(), epoch: epoch(4) });
    assert_eq!(ownership.deadline(), None);
}

#[test]
fn after_a_freeze_nothing_is_sent_until_the_fleet_is_confirmed() {
    let mut ownership = owner();
    assert_eq!(ownership.permit(at(750), &robot()), Some(epoch(4)));
    assert_eq!(ownership.permit(at(751), &robot()), None, "before any input");
    let outputs = give(&mut ownership, 751, Input::RobotHeard { robot: robot() });
    assert!(outputs.contains(&Output::Stop { robot: robot() }) && outputs.contains(&Output::ConfirmFleet));
    assert_eq!(ownership.permit(at(751), &robot()), None);
    let resumed = give(&mut ownership, 760, Input::FleetConfirmed);
    assert_eq!(resumed[0], Output::Start { robot: robot(), epoch: epoch(4), state: StartState::Kept });
    assert_eq!(ownership.permit(at(760), &robot()), Some(epoch(4)));
}

#[test]
fn a_stand_by_that_was_frozen_asks_again_because_the_answer_may_wait_to_be_read() {
    let mut ownership = connected();
    give(&mut ownership, 1, Input::TokenAppeared { robot: robot(), token: token(3, "a") });
    give(&mut ownership, 2, Input::RobotHeard { robot: robot() });
    give(&mut ownership, 1_000, Input::RobotHeard { robot: robot() });
    let outputs = give(&mut ownership, 1_010, Input::FleetConfirmed);
    assert!(matches!(outputs[..], [Output::QueryState { id: QueryId(2), .. }]), "{outputs:?}");
}

#[test]
fn a_frozen_owner_that_was_replaced_stops_for_good() {
    let mut ownership = owner();
    give(&mut ownership, 3_000, Input::Tick);
    give(&mut ownership, 3_010, Input::TokenAppeared { robot: robot(), token: token(5, "a") });
    let outputs = give(&mut ownership, 3_020, Input::FleetConfirmed);
    assert!(!outputs.iter().any(|output| matches!(output, Output::Start { .. })));
    assert_eq!(ownership.owner(&robot()), Some(token(5, "a")));
}

#[test]
fn a_program_that_ends_leaves_its_last_state_and_no_token() {
    let mut ownership = owner();
    let outputs = give(&mut ownership, 500, Input::Shutdown);
    let expected = [
        Output::PublishState { robot: robot(), epoch: epoch(4), reception: Reception::Silent },
        Output::Stop { robot: robot() },
        Output::Event(OwnershipEvent::Stopped { robot: robot(), epoch: epoch(4), reason: StopReason::Shutdown }),
        Output::WithdrawToken { robot: robot(), epoch: epoch(4) },
    ];
    assert_eq!(outputs, expected);
    assert_eq!(give(&mut ownership, 510, Input::RobotHeard { robot: robot() }), []);
    assert_eq!(ownership.deadline(), None);
}

#[test]
fn an_event_says_who_took_over_from_whom_and_why() {
    let reason = ClaimReason::OwnerVanished(station("a"));
    let started = OwnershipEvent::Started { robot: robot(), epoch: epoch(5), reason };
    let text = "nxt: owned here, epoch 5: a-0000000000000001 ended or is cut off";
    assert_eq!(started.to_string(), text);
    let reason = StopReason::Replaced(token(6, "c"));
    let stopped = OwnershipEvent::Stopped { robot: robot(), epoch: epoch(5), reason };
    let text = "nxt: no longer served, epoch 5: c-0000000000000001 owns it with epoch 6";
    assert_eq!(stopped.to_string(), text);
}

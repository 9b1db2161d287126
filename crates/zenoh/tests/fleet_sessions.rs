//! Sessions of a fleet over real sockets of this computer.
#![expect(clippy::expect_used, reason = "helpers outside #[test] stop with a reason when the set-up is broken")]

use std::net::TcpListener;
use std::sync::{Arc, Mutex};

use posebridge_fleet::{
    Epoch, FleetEstimate, FleetKey, FleetName, FleetTable, Input, OwnershipToken, QueryId, Reception, RobotName,
    StateAnswer, StateNotice, StateQuestion, StateReply, StateSnapshot, StationId, StationName, encode_message,
};
use posebridge_link::HostTimer;
use posebridge_telemetry::{Heading, Meters, MetersPerSecond, Pose, RadiansPerSecond, TimeDelta, Timestamp, Validity};
use posebridge_zenoh::{Connection, FleetCommand, FleetEvent, FleetSession, Publication};

struct Member {
    id: StationId,
    session: FleetSession,
    table: Arc<Mutex<FleetTable>>,
}

/// A port that was free a moment ago: Zenoh does not say which one it took.
fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    format!("tcp/{}", listener.local_addr().expect("its address"))
}

impl Member {
    fn start(fleet: &str, name: &str, connection: Connection) -> Self {
        let id = StationId { name: StationName::new(name).expect("a name"), instance: 1 };
        let table = Arc::new(Mutex::new(FleetTable::new(16, 16)));
        let fleet = FleetName::new(fleet).expect("a name");
        let session = FleetSession::start(connection, fleet, id.clone(), HostTimer::start(), Arc::clone(&table));
        Self { id, session: session.expect("a session"), table }
    }

    fn listening(fleet: &str, endpoint: &str) -> Self {
        Self::start(fleet, "a", Connection { listen: vec![endpoint.to_owned()], ..Connection::default() })
    }

    fn joining(fleet: &str, name: &str, endpoint: &str) -> Self {
        Self::start(fleet, name, Connection { join: vec![endpoint.to_owned()], ..Connection::default() })
    }

    /// The first input that fits; those before it are dropped.
    async fn wait_for<T>(&mut self, pick: impl Fn(&Input) -> Option<T>) -> T {
        loop {
            if let FleetEvent::Ownership(input) = self.session.next_event().await
                && let Some(found) = pick(&input)
            {
                return found;
            }
        }
    }

    async fn wait_for_input(&mut self, expected: Input) {
        self.wait_for(|input| (*input == expected).then_some(())).await;
    }
}

fn robot() -> RobotName {
    RobotName::new("ada").expect("a name")
}

fn token(member: &Member) -> OwnershipToken {
    OwnershipToken { epoch: Epoch::FIRST, station: member.id.clone() }
}

fn estimate(sequence: u32) -> FleetEstimate {
    FleetEstimate {
        epoch: Epoch::FIRST,
        sequence,
        host_time: Timestamp::ZERO,
        pose: Pose::new(Meters(1.0), Meters(2.0), Heading::from_rad(0.5)),
        covariance: [1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
        forward_speed: MetersPerSecond(0.0),
        turn_rate: RadiansPerSecond(0.0),
        validity: Validity { position: true, heading: true, speeds: true },
        is_dead_reckoning: false,
        reset_counter: 0,
    }
}

#[tokio::test]
async fn stations_learn_of_each_other_of_tokens_and_of_their_end() {
    let endpoint = free_endpoint();
    let mut first = Member::listening("lab", &endpoint);
    first.session.send(FleetCommand::DeclareToken { robot: robot(), epoch: Epoch::FIRST });
    let mut second = Member::joining("lab", "b", &endpoint);
    second.wait_for_input(Input::StationAppeared(first.id.clone())).await;
    first.wait_for_input(Input::StationAppeared(second.id.clone())).await;
    // The return of the first station is confirmed by a sign of life, which lists the tokens.
    second.wait_for_input(Input::TokenAppeared { robot: robot(), token: token(&first) }).await;
    second.wait_for_input(Input::FleetConfirmed).await;
    assert!(second.table.lock().unwrap().offset(Timestamp::ZERO, &first.id).is_some(), "their clocks were compared");
    first.session.send(FleetCommand::WithdrawToken { robot: robot(), epoch: Epoch::FIRST });
    second.wait_for_input(Input::TokenVanished { robot: robot(), token: token(&first) }).await;
    first.session.send(FleetCommand::DeclareToken { robot: robot(), epoch: Epoch::FIRST.next() });
    let id = first.id.clone();
    drop(first);
    let vanished = OwnershipToken { epoch: Epoch::FIRST.next(), station: id.clone() };
    second.wait_for_input(Input::TokenVanished { robot: robot(), token: vanished }).await;
    second.wait_for_input(Input::FleetDisconnected).await;
}

#[tokio::test]
async fn a_station_alone_is_told_that_nobody_is_there() {
    let mut alone = Member::listening("lab", &free_endpoint());
    alone.session.send(FleetCommand::Confirm);
    alone.wait_for_input(Input::FleetDisconnected).await;
}

#[tokio::test]
async fn a_question_reaches_whom_it_is_for_and_a_state_everybody() {
    let endpoint = free_endpoint();
    let mut owner = Member::listening("lab", &endpoint);
    let mut asker = Member::joining("lab", "b", &endpoint);
    let mut third = Member::joining("lab", "c", &endpoint);
    for member in [&mut owner, &mut asker, &mut third] {
        for _ in 0..2 {
            member.wait_for(|input| matches!(input, Input::StationAppeared(_)).then_some(())).await;
        }
    }
    let ask = |asker: &Member, id: u64, to: Option<&Member>| {
        let to = to.map(|member| member.id.clone());
        let heard_for = TimeDelta::from_millis(7);
        let question = StateQuestion { from: asker.id.clone(), to, id: QueryId(id), heard_for };
        asker.session.send(FleetCommand::Ask { robot: robot(), question });
    };
    let asked = |input: &Input| match input {
        Input::StateQuery { from, id, .. } => Some((from.clone(), *id)),
        _ => None,
    };
    let answer = |member: &Member, to: &StationId, id: QueryId| {
        let answer = StateAnswer::NotOwner { owner: None, highest_epoch: None, state: None };
        let reply = StateReply { from: member.id.clone(), answer };
        member.session.send(FleetCommand::Answer { to: to.clone(), robot: robot(), id, reply });
    };
    // The first is for the owner alone, the second for both: the third station hears of the second only.
    for (id, to) in [(1, Some(&owner)), (2, None)] {
        ask(&asker, id, to);
    }
    for id in [1, 2] {
        assert_eq!(owner.wait_for(asked).await, (asker.id.clone(), QueryId(id)));
        answer(&owner, &asker.id, QueryId(id));
    }
    assert_eq!(third.wait_for(asked).await, (asker.id.clone(), QueryId(2)));
    answer(&third, &asker.id, QueryId(2));
    let mut answered = Vec::new();
    for _ in 0..3 {
        answered.push(
            asker
                .wait_for(|input| match input {
                    Input::StateAnswer { from, id, .. } => Some((id.0, from.name.as_str().to_owned())),
                    _ => None,
                })
                .await,
        );
    }
    answered.sort();
    assert_eq!(answered, [(1, "a".to_owned()), (2, "a".to_owned()), (2, "c".to_owned())]);

    let state = StateSnapshot { epoch: Epoch::FIRST, age: TimeDelta::ZERO, bytes: vec![7; 200_000] };
    let notice = StateNotice { from: owner.id.clone(), reception: Reception::Heard, state: state.clone() };
    owner.session.publish(Publication { key: FleetKey::State { robot: robot() }, bytes: encode_message(&notice) });
    let from = owner.id.clone();
    let published = Input::StatePublished { from, robot: robot(), reception: Reception::Heard, state };
    for member in [&mut asker, &mut third] {
        member.wait_for_input(published.clone()).await;
    }
}

#[tokio::test]
async fn estimates_are_counted_and_commands_answered_by_the_owner() {
    let endpoint = free_endpoint();
    let mut owner = Member::listening("lab", &endpoint);
    let mut viewer = Member::joining("lab", "b", &endpoint);
    owner.wait_for_input(Input::StationAppeared(viewer.id.clone())).await;
    viewer.wait_for_input(Input::StationAppeared(owner.id.clone())).await;
    for sequence in [0, 1, 3] {
        let bytes = estimate(sequence).encode().to_vec();
        owner.session.publish(Publication { key: FleetKey::Estimate { robot: robot() }, bytes });
    }
    // Behind the estimates on their way; what it says does not matter.
    owner.session.send(FleetCommand::DeclareToken { robot: robot(), epoch: Epoch::FIRST });
    let (told, answer) = tokio::sync::oneshot::channel();
    let reply = Box::new(move |answer: Result<Vec<u8>, String>| drop(told.send(answer)));
    viewer.session.send(FleetCommand::SendCommand { robot: robot(), request: b"stop".to_vec(), reply });
    loop {
        if let FleetEvent::Command { robot: to, request, reply } = owner.session.next_event().await {
            assert_eq!((to, request), (robot(), b"stop".to_vec()));
            reply.send(b"done".to_vec());
            break;
        }
    }
    assert_eq!(answer.await.unwrap(), Ok(b"done".to_vec()));
    while viewer.table.lock().unwrap().robots().next().is_none_or(|(_, row)| row.received < 3) {
        tokio::task::yield_now().await;
    }
    let table = viewer.table.lock().unwrap();
    let (name, row) = table.robots().next().unwrap();
    assert_eq!((name, row.lost, row.estimate), (&robot(), 1, Some(estimate(3))));
    drop(table);
    let (told, answer) = tokio::sync::oneshot::channel();
    let reply = Box::new(move |answer: Result<Vec<u8>, String>| drop(told.send(answer)));
    drop(owner);
    viewer.session.send(FleetCommand::SendCommand { robot: robot(), request: b"stop".to_vec(), reply });
    assert_eq!(answer.await.unwrap(), Err("no station that owns the robot answered".to_owned()));
}

#[tokio::test]
async fn another_fleet_on_the_same_network_sees_nothing() {
    let endpoint = free_endpoint();
    let mut ours = Member::listening("lab", &endpoint);
    let mut stranger = Member::joining("other", "x", &endpoint);
    let mut friend = Member::joining("lab", "b", &endpoint);
    ours.wait_for_input(Input::StationAppeared(friend.id.clone())).await;
    ours.session.send(FleetCommand::DeclareToken { robot: robot(), epoch: Epoch::FIRST });
    friend.wait_for_input(Input::TokenAppeared { robot: robot(), token: token(&ours) }).await;
    assert!(stranger.session.try_next_event().is_none());
    stranger.session.send(FleetCommand::Confirm);
    stranger.wait_for_input(Input::FleetDisconnected).await;
}

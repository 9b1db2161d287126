//! The parameters of a participant, in virtual time.

use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::session::{Session, SessionConfig, SessionOutput};
use posebridge_telemetry::{Address, BrickClock, TimeDelta, Timestamp};

const OWN: Address = Address::new(1, 197);
const GCS: Address = Address::new(255, 190);
const NAMES: [&str; 3] = ["GATE_PROB", "SIXTEEN_BYTES_OK", "TAU_S"];

type Owner = Session<BrickClock>;

fn at(millis: i64) -> Timestamp<BrickClock> {
    Timestamp::from_millis(millis)
}

fn owner(names: &[&str]) -> Owner {
    let config = SessionConfig {
        own: OWN,
        heartbeat: Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status: 4 },
        // Never within a test.
        heartbeat_period: TimeDelta::from_millis(100_000_000),
        timesync_period: None,
        peer_timeout: TimeDelta::from_millis(3_000),
        requested_messages: vec![],
        offered_messages: vec![],
    };
    let mut session = Session::new(config, at(0));
    session.offer_parameters(names.iter().map(|name| ((*name).to_owned(), 1.5)));
    session.tick(at(0));
    while session.poll().is_some() {}
    session
}

fn list() -> Message {
    Message::ParamRequestList { target: OWN }
}

/// Indices of the values that are sent until an instant, each with its instant in milliseconds.
fn values_sent_until(session: &mut Owner, end: Timestamp<BrickClock>) -> Vec<(i64, u16)> {
    let mut told = Vec::new();
    while let Some(due) = session.deadline().filter(|due| *due <= end) {
        session.tick(due);
        while let Some(output) = session.poll() {
            if let SessionOutput::Send(Message::ParamValue { index, .. }) = output {
                told.push((due.as_micros() / 1_000, index));
            }
        }
    }
    told
}

fn answer(session: &mut Owner, message: &Message) -> Vec<SessionOutput<BrickClock>> {
    session.handle(at(0), GCS, message);
    std::iter::from_fn(|| session.poll()).collect()
}

#[test]
fn who_asks_while_a_list_goes_out_gets_it_whole_and_nobody_makes_it_faster() {
    let mut session = owner(&NAMES);
    session.handle(at(0), GCS, &list());
    assert_eq!(values_sent_until(&mut session, at(25)), [(0, 0), (20, 1)]);
    session.handle(at(25), Address::new(254, 190), &list());
    assert_eq!(values_sent_until(&mut session, at(1_000)), [(40, 2), (60, 0), (80, 1)]);
    // A list that has just ended does not begin again at once.
    let mut session = owner(&NAMES[..1]);
    session.handle(at(0), GCS, &list());
    assert_eq!(values_sent_until(&mut session, at(5)), [(0, 0)]);
    session.handle(at(5), GCS, &list());
    assert_eq!(values_sent_until(&mut session, at(1_000)), [(20, 0)]);
}

#[test]
fn a_clock_that_is_set_back_does_not_hold_a_list_up() {
    let mut session = owner(&NAMES);
    session.handle(at(3_600_000), GCS, &list());
    assert_eq!(values_sent_until(&mut session, at(3_600_010)), [(3_600_000, 0)], "before");
    session.tick(at(5));
    let told = values_sent_until(&mut session, at(1_000));
    let indices: Vec<u16> = told.iter().map(|(_, index)| *index).collect();
    assert_eq!(indices, [1, 2], "{told:?}");
}

#[test]
fn names_are_understood_in_capitals_or_not_and_told_as_they_are() {
    for spelled in ["sixteen_bytes_ok", "SIXTEEN_BYTES_OK", "Sixteen_Bytes_OK"] {
        let mut session = owner(&NAMES);
        let read = Message::ParamRequestRead { target: OWN, name: spelled.to_owned(), index: -1 };
        let value = Message::ParamValue { name: "SIXTEEN_BYTES_OK".to_owned(), value: 1.5, count: 3, index: 1 };
        assert_eq!(answer(&mut session, &read), [SessionOutput::Send(value)], "{spelled}");
        let set = Message::ParamSet { target: OWN, name: spelled.to_owned(), value: 2.5 };
        let wish = SessionOutput::ParameterSetRequested { by: GCS, index: 1, value: 2.5 };
        assert_eq!(answer(&mut session, &set), [wish], "{spelled}");
    }
}

#[test]
fn what_stands_is_told_only_where_somebody_has_asked() {
    let mut session = owner(&NAMES);
    assert_eq!(session.report_parameter(2, 7.0), None);
    session.handle(at(0), GCS, &list());
    let told = Message::ParamValue { name: "TAU_S".to_owned(), value: 8.0, count: 3, index: 2 };
    assert_eq!(session.report_parameter(2, 8.0), Some(told));
    assert_eq!(session.report_parameter(3, 8.0), None);
}

#[test]
fn a_participant_without_parameters_says_nothing_about_them() {
    let mut session = owner(&[]);
    for message in [
        list(),
        Message::ParamRequestRead { target: OWN, name: "TAU_S".to_owned(), index: -1 },
        Message::ParamSet { target: OWN, name: "TAU_S".to_owned(), value: 1.0 },
    ] {
        assert_eq!(answer(&mut session, &message), []);
    }
    assert_eq!(values_sent_until(&mut session, at(10_000)), []);
}

//! What is due at its instant: heartbeats, broken frames, links that go and come.

use super::sent_messages;
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, messages, ticks};
use posebridge_protocol::message::Message;
use posebridge_telemetry::{Event, HostClock, Input, LinkState, ReceiveError, Timestamp};

#[test]
fn ticks_at_the_deadlines_and_nowhere_else_miss_nothing_and_do_not_spin() {
    let mut station = TestStation::new(&config());
    station.bytes(at(100), &frame(BRICK, &HEARTBEAT));
    let mut count = 0;
    while let Some(due) = station.engine.deadline().filter(|due| *due <= at(20_000)) {
        station.handle(due, Input::Tick);
        let next = station.engine.deadline().expect("there is always a heartbeat");
        assert!(next > due, "after {due:?} comes {next:?}");
        count += 1;
    }
    let sent = sent_messages(&station);
    let times = |matches: fn(&Message) -> bool| -> Vec<Timestamp<HostClock>> {
        let selected = sent.iter().filter(|(_, message)| matches(message));
        selected.map(|(now, _)| *now).collect()
    };
    let heartbeats = times(|message| matches!(message, Message::Heartbeat(_)));
    let expected: Vec<_> = (0..=20).map(|k| at(k * 1_000)).collect();
    assert_eq!(heartbeats, expected, "each second, to the nanosecond");
    let requests = times(|message| matches!(message, Message::TimeSync(_)));
    assert!((45..75).contains(&requests.len()), "{}", requests.len());
    // Heartbeats and health share their instants; time requests, interval requests and the loss are the rest.
    assert!(count < 20 + requests.len() + 15, "{count}");
    let lost = station.when(|event| matches!(event, Event::RobotLost { .. }));
    assert_eq!(lost, [at(5_100)], "five seconds after it was heard");
    assert_eq!(station.count(|event| matches!(event, Event::Health { .. })), 20);
}

fn stalled(station: &TestStation) -> bool {
    station.events().any(|event| matches!(event, Event::ReceiveError { defect: ReceiveError::Timeout { .. }, .. }))
}

#[test]
fn a_frame_after_a_truncated_one_is_handled_at_once() {
    let mut station = TestStation::new(&config());
    station.pass_until(at(250));
    // A complete heartbeat hidden behind the header of a long frame that never ends.
    let truncated = [0xFD, 200, 0, 0, 0, 1, 1, 0x4B, 0x01, 0x00];
    station.bytes(at(310), &[&truncated[..], &frame(BRICK, &HEARTBEAT)].concat());
    station.pass_until(at(360));
    assert!(station.events().any(|event| matches!(event, Event::RobotDetected { .. })));
    assert!(station.engine.deadline().is_some_and(|due| due > at(360)));
    let is_requested = station.sent().any(|sent| {
        let is_request = |message: &Message| matches!(message, Message::SetMessageInterval(_));
        sent.now == at(360) && messages(sent.bytes).iter().any(is_request)
    });
    assert!(is_requested, "the robot is asked for its messages");
}

#[test]
fn a_complete_frame_after_a_truncated_one_survives_the_loss_of_its_link() {
    let mut station = TestStation::new(&config());
    // The header of an ODOMETRY (331) of 232 bytes: much more must come until it is refused.
    let truncated = [0xFD, 232, 0, 0, 7, 1, 1, 0x4B, 0x01, 0];
    let complete = frame(BRICK, &ticks(5_100, 3, 3));
    station.bytes(at(150), &[&truncated[..], &complete].concat());
    station.link(at(160), LINK, LinkState::Down);
    station.pass_until(at(2_000));
    assert_eq!(station.health(LINK).0.frames_in, 1);
}

#[test]
fn a_flipped_bit_is_damage_and_in_the_id_an_unknown_message() {
    let mut station = TestStation::new(&config());
    for (index, bit) in [(12, 1), (9, 0x40)] {
        let mut flipped = frame(BRICK, &HEARTBEAT);
        flipped[index] ^= bit;
        station.bytes(at(100), &[flipped, frame(BRICK, &HEARTBEAT)].concat());
    }
    let health = station.later_health(LINK);
    assert_eq!((health.checksum_errors, health.unknown_ids, health.frames_in), (1, 1, 2));
}

#[test]
fn a_link_that_is_down_gets_nothing_and_begins_anew_when_it_is_up() {
    let mut station = TestStation::new(&config());
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let truncated = frame(BRICK, &ticks(5_050, 9, 9));
    station.bytes(at(150), &truncated[..10]);
    station.link(at(160), LINK, LinkState::Down);
    let before = station.sent().count();
    station.pass_until(at(4_500));
    station.bytes(at(4_600), &frame(BRICK, &ticks(9_500, 4, 4)));
    assert_eq!(station.sent().count(), before, "nothing leaves");
    assert!(!stalled(&station), "half a frame dies with its link");
    station.link(at(4_700), LINK, LinkState::Up);
    station.pass_until(at(6_000));
    assert!(station.sent().count() > before);
    let (health, _) = station.health(LINK);
    assert_eq!((health.reconnects, health.frames_in), (1, 2));
    let states = station.select(|event| if let Event::Link { state, .. } = event { Some(*state) } else { None });
    assert_eq!(states, [LinkState::Up, LinkState::Down, LinkState::Up]);
}

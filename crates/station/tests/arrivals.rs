//! Links whose arrivals are handled out of their order in time: the conversation on each goes on undisturbed.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/station.rs"]
mod station;

use brick::{BRICK, HEARTBEAT, frame, messages, ticks};
use posebridge_protocol::message::{Message, TimeSync};
use posebridge_telemetry::{Address, Event, Input, LinkId, Output, PeerId, ReceiveError, TimeDelta, Timestamp};
use station::{LINK, STATION, TestStation, at, config, link};

const BESIDE: LinkId = LinkId(4);

/// A minute of a brick whose clock runs so much faster than the host's, in per cent, and that answers each request at once: how
/// often it was told that its clock makes no sense.
fn clock_warnings_at_rate_error(percent: i64) -> usize {
    let mut station = TestStation::new(&config());
    station.bytes(at(1), &frame(BRICK, &HEARTBEAT));
    let mut seen = 0;
    for k in 0..1_200_i64 {
        let now = at(20 + k * 50);
        station.pass_until(now);
        let brick_ms = (k * 50) * (100 + percent) / 100 + 5_000;
        let stamp = u32::try_from(brick_ms).expect("a minute");
        let requests = time_requests(&station, seen);
        seen = station.outputs.len();
        station.bytes(now, &frame(BRICK, &ticks(stamp, 0, 0)));
        for request_nanos in requests {
            let answer = Message::TimeSync(TimeSync {
                answer_nanos: brick_ms * 1_000_000,
                request_nanos,
                target: Some(STATION),
            });
            station.bytes(now, &frame(BRICK, &answer));
        }
    }
    let unaligned = ReceiveError::ClockNotAligned { source: BRICK };
    let is_told = |event: &&Event| matches!(event, Event::ReceiveError { defect, .. } if *defect == unaligned);
    station.events().filter(is_told).count()
}

#[test]
fn a_clock_that_cannot_be_aligned_is_told_of() {
    assert_eq!(clock_warnings_at_rate_error(0), 0);
    assert_eq!(clock_warnings_at_rate_error(1), 0);
    assert!(clock_warnings_at_rate_error(3) > 3);
}

/// Twenty seconds of a brick that answers on one link while another one talks, whose inputs are stamped so much later than those
/// of the first that are handled after them. How many exchanges of time came of it, and how many peers were lost.
fn exchanges_beside_a_link_ahead(ahead_ms: i64) -> (usize, usize) {
    let mut config = config();
    config.links.push(link(BESIDE, vec![]));
    let mut station = TestStation::new(&config);
    station.bytes(at(1), &frame(BRICK, &HEARTBEAT));
    let (mut seen, mut asked) = (0, Vec::new());
    for k in 0..2_000_i64 {
        let now = at(20 + k * 10);
        if k % 5 == 0 {
            let stamp = u32::try_from(5_000 + k * 10).expect("twenty seconds");
            station.bytes(now, &frame(BRICK, &ticks(stamp, 0, 0)));
        }
        if k % 100 == 0 {
            station.bytes(now, &frame(BRICK, &HEARTBEAT));
        }
        asked.extend(time_requests(&station, seen));
        // Nothing is answered before it was asked, and each way takes a while.
        let (due, later): (Vec<i64>, _) =
            asked.into_iter().partition(|nanos| Timestamp::from_nanos(nanos + 5_000_000) <= now);
        asked = later;
        for request_nanos in due {
            let answer = Message::TimeSync(TimeSync {
                answer_nanos: request_nanos + 4_982_000_000,
                request_nanos,
                target: Some(STATION),
            });
            station.bytes(now, &frame(BRICK, &answer));
        }
        seen = station.outputs.len();
        let beside =
            Input::Bytes { link: BESIDE, peer: PeerId::default(), bytes: frame(Address::new(7, 7), &HEARTBEAT) };
        station.handle(now + TimeDelta::from_millis(ahead_ms), beside);
    }
    let is_exchange = |event: &&Event| matches!(event, Event::BrickClockAligned { .. });
    let is_loss = |event: &&Event| matches!(event, Event::RobotLost { .. });
    (station.events().filter(is_exchange).count(), station.events().filter(is_loss).count())
}

/// The time requests that left on the first link after the first `seen` outputs.
fn time_requests(station: &TestStation, seen: usize) -> Vec<i64> {
    let sent = station.outputs[seen..].iter();
    let sent = sent.filter_map(|(_, output)| match output {
        Output::Transmit { link, bytes, .. } if *link == LINK => Some(messages(bytes)),
        _ => None,
    });
    let requests = sent.flatten().filter_map(|message| match message {
        Message::TimeSync(sync) if sync.answer_nanos == 0 => Some(sync.request_nanos),
        _ => None,
    });
    requests.collect()
}

#[test]
fn arrivals_of_several_links_that_are_handled_out_of_order_lose_no_exchange_and_no_peer() {
    let (in_order, _) = exchanges_beside_a_link_ahead(0);
    assert!(in_order > 40, "{in_order}");
    // Ten milliseconds from one input of the first link to the next: from 10 on its inputs are behind.
    for ahead_ms in [9, 12, 25, 80] {
        let (exchanges, lost) = exchanges_beside_a_link_ahead(ahead_ms);
        assert!(in_order.abs_diff(exchanges) <= 2, "{ahead_ms} ms: {exchanges} of {in_order}");
        assert_eq!(lost, 0, "{ahead_ms} ms");
    }
}

#[test]
fn an_observation_keeps_the_instant_at_which_its_bytes_came() {
    let mut config = config();
    config.links.push(link(BESIDE, vec![]));
    let mut station = TestStation::new(&config);
    let beside = Input::Bytes { link: BESIDE, peer: PeerId::default(), bytes: frame(Address::new(7, 7), &HEARTBEAT) };
    station.handle(at(140), beside);
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let arrivals = station.events().filter_map(|event| match event {
        Event::ObservationAligned { arrival, .. } => Some(*arrival),
        _ => None,
    });
    assert_eq!(arrivals.collect::<Vec<_>>(), [at(100)]);
}

//! Links whose arrivals are handled out of their order in time: the exchange on each goes on undisturbed.

use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, frame, link, ticks, time_answer};
use posebridge_telemetry::{Address, Event, LinkId, PeerId, TimeDelta, Timestamp};

const BESIDE: LinkId = LinkId(4);

/// A minute of a brick whose clock is so many per cent faster than the host's and that answers each request at once: how
/// often its clock could not be aligned.
fn clock_warnings_at_rate_error(percent: i64) -> usize {
    let mut station = TestStation::new(&config());
    station.bytes(at(1), &frame(BRICK, &HEARTBEAT));
    let mut first_output = 0;
    for k in 0..1_200_i64 {
        let now = at(20 + k * 50);
        station.pass_until(now);
        let brick_ms = (k * 50) * (100 + percent) / 100 + 5_000;
        let requests = station.time_requests(first_output);
        first_output = station.outputs.len();
        station.bytes(now, &frame(BRICK, &ticks(brick_ms as u32, 0, 0)));
        for request in requests {
            station.bytes(now, &frame(BRICK, &time_answer(brick_ms * 1_000_000, request.nanos)));
        }
    }
    station.unaligned(BRICK).len()
}

#[test]
fn a_clock_that_cannot_be_aligned_is_reported() {
    assert_eq!(clock_warnings_at_rate_error(0), 0);
    assert_eq!(clock_warnings_at_rate_error(1), 0);
    assert!(clock_warnings_at_rate_error(3) > 3);
}

/// Twenty seconds of a brick that answers on one link while the inputs of another one are stamped later and handled first.
/// How many exchanges of time came of it, and how many robots were lost.
fn exchanges_beside_a_link_ahead(ahead_ms: i64) -> (usize, usize) {
    let mut config = config();
    config.links.push(link(BESIDE, vec![]));
    let mut station = TestStation::new(&config);
    station.bytes(at(1), &frame(BRICK, &HEARTBEAT));
    let (mut first_output, mut pending) = (0, Vec::new());
    for k in 0..2_000_i64 {
        let now = at(20 + k * 10);
        if k % 5 == 0 {
            station.bytes(now, &frame(BRICK, &ticks(5_000 + k as u32 * 10, 0, 0)));
        }
        if k % 100 == 0 {
            station.bytes(now, &frame(BRICK, &HEARTBEAT));
        }
        pending.extend(station.time_requests(first_output).into_iter().filter(|request| request.link == LINK));
        // No reply comes before its request, and each direction takes a while.
        for request in pending.extract_if(.., |request| Timestamp::from_nanos(request.nanos + 5_000_000) <= now) {
            station.bytes(now, &frame(BRICK, &time_answer(request.nanos + 4_982_000_000, request.nanos)));
        }
        first_output = station.outputs.len();
        let ahead = now + TimeDelta::from_millis(ahead_ms);
        station.bytes_from(ahead, BESIDE, PeerId::default(), &frame(Address::new(7, 7), &HEARTBEAT));
    }
    let exchanges = station.count(|event| matches!(event, Event::BrickClockAligned { .. }));
    (exchanges, station.count(|event| matches!(event, Event::RobotLost { .. })))
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
    station.bytes_from(at(140), BESIDE, PeerId::default(), &frame(Address::new(7, 7), &HEARTBEAT));
    station.bytes(at(100), &frame(BRICK, &ticks(5_000, 0, 0)));
    let [observed] = station.aligned()[..] else { panic!("one observation") };
    assert_eq!(observed.arrival, at(100));
}

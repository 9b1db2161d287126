//! Two links to one robot of which one holds back for seconds, and a robot that is restarted behind them.
#![expect(
    clippy::expect_used,
    clippy::wildcard_enum_match_arm,
    reason = "tests stop at the first surprise, and pick the events that they are about"
)]
#![expect(dead_code, reason = "the helpers are shared with tests that need others of them")]

#[path = "support/brick.rs"]
mod brick;
#[path = "support/network.rs"]
mod network;
#[path = "support/station.rs"]
mod station;

use brick::{BRICK, HEARTBEAT, ticks};
use network::{BytesInTransit, RemotePeer};
use posebridge_protocol::framing::TransportKind;
use posebridge_protocol::message::{Message, TimeSync};
use posebridge_telemetry::{Event, HostClock, LinkId, Output, TimeDelta, Timestamp};
use station::{LINK, STATION, TestStation, at, config, link};

const LINKS: [LinkId; 2] = [LinkId(6), LinkId(7)];
const DELAYS_MS: [i64; 2] = [5, 45];
/// Between two messages of telemetry.
const PERIOD_MS: i64 = 50;
/// Brick time minus host time, until the brick is restarted.
const AHEAD_MS: i64 = 60_000;

/// Whether the brick answers time requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TimeReplies {
    Yes,
    No,
}

/// A brick that says everything on a quick link and on a slow one, and answers time requests on each.
struct RedundantBrick {
    station: TestStation,
    remotes: [RemotePeer; 2],
    in_transit: BytesInTransit<usize>,
    seen: usize,
    answers: TimeReplies,
    is_up: [bool; 2],
    /// Until when each link holds back what is sent on it, ms of host time.
    held_until_ms: [i64; 2],
    ahead_ms: i64,
}

impl RedundantBrick {
    fn new(answers: TimeReplies) -> Self {
        let mut config = config();
        config.links = LINKS
            .map(|id| {
                let mut link = link(id, vec![]);
                link.rules.group = Some(0);
                link
            })
            .to_vec();
        Self {
            station: TestStation::new(&config),
            remotes: LINKS.map(|id| RemotePeer::new(BRICK, id, 0)),
            in_transit: BytesInTransit::default(),
            seen: 0,
            answers,
            is_up: [true; 2],
            held_until_ms: [0; 2],
            ahead_ms: AHEAD_MS,
        }
    }

    fn send(&mut self, now: i64, index: usize, message: &Message) {
        let frame = self.remotes[index].frame(message);
        if self.is_up[index] {
            let arrival = (now + DELAYS_MS[index]).max(self.held_until_ms[index]);
            self.in_transit.send(at(arrival), index, frame);
        }
    }

    /// One millisecond; the quick link loses a tenth of the telemetry, so that the slow one brings news, too.
    fn step(&mut self, now: i64) {
        if now % PERIOD_MS == 0 {
            let brick_ms = u32::try_from(now + self.ahead_ms).expect("a short run");
            let turned = now / PERIOD_MS;
            for index in 0..2 {
                if index == 1 || now / PERIOD_MS % 10 != 0 {
                    self.send(now, index, &ticks(brick_ms, turned, turned));
                } else {
                    self.remotes[index].frame(&HEARTBEAT);
                }
                if now % 1_000 == 0 {
                    self.send(now, index, &HEARTBEAT);
                }
            }
        }
        while let Some((index, bytes)) = self.in_transit.take_due(at(now)) {
            self.remotes[index].send_bytes(&mut self.station, at(now), &bytes);
        }
        self.station.pass_until(at(now));
        self.answer(now);
    }

    fn answer(&mut self, now: i64) {
        let sent = self.station.outputs[self.seen..].iter();
        let requests: Vec<(usize, i64)> = sent
            .filter_map(|(_, output)| match output {
                Output::Transmit { link, bytes, .. } => {
                    Some((usize::from(link.0 - LINKS[0].0), brick::messages(bytes)))
                }
                Output::Event(_) | Output::Request(_) => None,
            })
            .flat_map(|(index, messages)| messages.into_iter().map(move |said| (index, said)))
            .filter_map(|(index, message)| match message {
                Message::TimeSync(sync) if sync.answer_nanos == 0 => Some((index, sync.request_nanos)),
                _ => None,
            })
            .collect();
        self.seen = self.station.outputs.len();
        if self.answers == TimeReplies::No {
            return;
        }
        for (index, request_nanos) in requests {
            let answer = Message::TimeSync(TimeSync {
                answer_nanos: (now + DELAYS_MS[index] + self.ahead_ms) * 1_000_000,
                request_nanos,
                target: Some(STATION),
            });
            self.send(now + DELAYS_MS[index], index, &answer);
        }
    }

    /// Brick instants in ms that were observed in (from, to] of host time, in rising order.
    fn observed(&self, from: Timestamp<HostClock>, to: Timestamp<HostClock>) -> Vec<i64> {
        let outputs = self.station.outputs.iter();
        let during = outputs.filter(|(now, _)| *now > from && *now <= to);
        let stamps = during.filter_map(|(_, output)| match output {
            Output::Event(Event::ObservationAligned { observation, .. }) => {
                Some(observation.stamp.as_nanos() / 1_000_000)
            }
            _ => None,
        });
        let mut stamps: Vec<_> = stamps.collect();
        stamps.sort_unstable();
        stamps
    }
}

fn restarts(station: &TestStation) -> Vec<Timestamp<HostClock>> {
    let restarts =
        station.outputs.iter().filter(|(_, output)| matches!(output, Output::Event(Event::BrickRestarted { .. })));
    restarts.map(|(now, _)| *now).collect()
}

#[test]
fn what_a_link_held_back_for_seconds_is_late_and_no_restart() {
    for answers in [TimeReplies::Yes, TimeReplies::No] {
        let mut run = RedundantBrick::new(answers);
        for now in 0..20_000_i64 {
            if now % 6_000 == 2_000 {
                run.held_until_ms[1] = now + 4_000;
            }
            run.step(now);
        }
        assert_eq!(restarts(&run.station), [], "{answers:?}");
        let observed = run.observed(at(-1), at(20_000));
        assert!(observed.windows(2).all(|pair| pair[0] < pair[1]), "twice");
        // What was sent before the last stall has come by one link or the other.
        let early = observed.iter().filter(|stamp| **stamp < 14_000 + AHEAD_MS);
        assert_eq!(early.count(), 280, "{answers:?}");
    }
}

#[test]
fn a_restart_is_seen_once_and_soon_whatever_a_slow_link_still_brings_of_the_time_before() {
    for answers in [TimeReplies::Yes, TimeReplies::No] {
        for held_ms in [0, 500, 5_000] {
            for quick_is_up in [true, false] {
                let case = format!("{answers:?}, {held_ms} ms, {quick_is_up}");
                let mut run = RedundantBrick::new(answers);
                for now in 0..20_000_i64 {
                    match now {
                        8_000 => run.is_up[0] = quick_is_up,
                        9_000 => run.held_until_ms[1] = now + held_ms,
                        // Its clock begins at zero.
                        10_000 => run.ahead_ms = -now,
                        _ => {}
                    }
                    run.step(now);
                }
                let quickest = if quick_is_up { 0 } else { 9_000 + held_ms };
                let seen = restarts(&run.station);
                assert!(matches!(seen[..], [one] if one <= at(quickest.max(10_000) + 150)), "{case}: {seen:?}");
                // What was sent before it and comes after it is no instant of the new clock, and the rest is used once.
                let after = run.observed(seen[0], at(20_000));
                assert!(after.windows(2).all(|pair| pair[0] < pair[1]), "{case}");
                assert!(after.iter().all(|stamp| *stamp < 10_000), "{case}");
                let sent = (at(20_000) - seen[0]).as_millis_f64() / PERIOD_MS as f64;
                assert!(after.len() as f64 > sent - 5.0, "{case}: {}", after.len());
            }
        }
    }
}

#[test]
fn a_link_that_was_never_heard_before_may_bring_old_news() {
    let mut station = TestStation::new(&{
        let mut config = config();
        config.links = LINKS.map(|id| link(id, vec![])).to_vec();
        for link in &mut config.links {
            link.rules.group = Some(0);
        }
        config
    });
    let mut remotes = LINKS.map(|id| RemotePeer::new(BRICK, id, 0));
    for k in 0..200_u32 {
        let now = at(i64::from(k) * PERIOD_MS);
        remotes[0].send(&mut station, now, &ticks(60_000 + k * 50, 0, 0));
        if k >= 100 {
            // Four seconds late, and not a copy: the other link has lost them.
            remotes[1].send(&mut station, now, &ticks(60_025 + (k - 80) * 50, 0, 0));
        }
    }
    assert_eq!(restarts(&station), []);
}

#[test]
fn a_brick_that_restarts_behind_a_new_connection_is_noticed_within_three_seconds() {
    let mut config = config();
    config.links[0].framing = TransportKind::Datagram;
    let mut station = TestStation::new(&config);
    let mut before = RemotePeer::new(BRICK, LINK, 0);
    let mut after = RemotePeer::new(BRICK, LINK, 1);
    for k in 0..200_u32 {
        let now = at(i64::from(k) * PERIOD_MS);
        before.send(&mut station, now, &ticks(60_000 + k * 50, 0, 0));
    }
    // Up again after a tenth of a second, and it comes from another port.
    let up = at(10_050);
    for k in 0..200_u32 {
        let now = up + TimeDelta::from_millis(i64::from(k) * PERIOD_MS);
        after.send(&mut station, now, &ticks(100 + k * 50, 0, 0));
    }
    let seen = restarts(&station);
    assert!(matches!(seen[..], [one] if one <= up + TimeDelta::from_millis(3_000)), "{seen:?}");
}

#[test]
fn a_stamp_from_the_future_by_a_link_that_then_dies_does_not_keep_the_other_one_out() {
    let mut run = RedundantBrick::new(TimeReplies::No);
    for now in 0..20_000_i64 {
        if now == 10_003 {
            let damaged = run.remotes[0].frame(&ticks(100_000, 0, 0));
            run.remotes[0].send_bytes(&mut run.station, at(now), &damaged);
            run.is_up[0] = false;
            run.in_transit.lose(|index| *index == 0);
        }
        run.step(now);
    }
    assert_eq!(restarts(&run.station).len(), 2, "there and back");
    let after = run.observed(at(15_000), at(20_000));
    assert_eq!(after.len(), 100);
    assert!(after.iter().all(|stamp| *stamp < 20_000 + AHEAD_MS));
}

#[test]
fn a_copy_by_a_redundant_link_is_not_used_because_a_detour_was_quicker_still() {
    let mut config = config();
    config.links = [LINKS[0], LINKS[1], LINK].map(|id| link(id, vec![])).to_vec();
    config.links[0].rules.group = Some(0);
    config.links[1].rules.group = Some(0);
    let mut station = TestStation::new(&config);
    let mut remotes = LINKS.map(|id| RemotePeer::new(BRICK, id, 0));
    // The links' counters differ, or their frames would be the same bytes.
    remotes[1].frame(&HEARTBEAT);
    remotes[0].send(&mut station, at(50), &ticks(4_950, 0, 0));
    let frames = [0, 1].map(|index| remotes[index].frame(&ticks(5_000, 7, 7)));
    let detour = RemotePeer::new(BRICK, LINK, 5);
    detour.send_bytes(&mut station, at(100), &frames[1]);
    remotes[0].send_bytes(&mut station, at(110), &frames[0]);
    remotes[1].send_bytes(&mut station, at(120), &frames[1]);
    let is_observation = |event: &&Event| matches!(event, Event::ObservationAligned { .. });
    assert_eq!(station.events().filter(is_observation).count(), 2);
}

//! Two links to one robot: only what both lose is lost, nothing is used twice, both bound its clock, one may hold back for
//! seconds, and the robot may be restarted behind them.

use crate::support::network::{BytesInTransit, RemotePeer};
use crate::support::{BRICK, HEARTBEAT, LINK, TestStation, at, config, link, stream, ticks, time_answer};
use posebridge_protocol::framing::TransportKind;
use posebridge_protocol::message::Message;
use posebridge_station::{OutputKind, StationConfig};
use posebridge_telemetry::{HostClock, LinkId, LinkState, Priority, TimeDelta, Timestamp};

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

fn redundant_config() -> StationConfig {
    let links = LINKS.map(|id| {
        let mut link = link(id, vec![stream(OutputKind::PlanarPose, 0)]);
        link.rules.group = Some(0);
        link
    });
    StationConfig { links: links.to_vec(), ..config() }
}

/// A brick that sends everything on a quick link and on a slow one, and answers time requests on each.
struct RedundantBrick {
    station: TestStation,
    remotes: [RemotePeer; 2],
    in_transit: BytesInTransit<usize>,
    first_output: usize,
    answers: TimeReplies,
    is_up: [bool; 2],
    /// Until when each link holds back what is sent on it, ms of host time.
    held_until_ms: [i64; 2],
    ahead_ms: i64,
    /// Which telemetry each link carried, by its stamps in ms of brick time.
    carried: [Vec<i64>; 2],
}

impl RedundantBrick {
    fn new(answers: TimeReplies) -> Self {
        Self {
            station: TestStation::new(&redundant_config()),
            remotes: LINKS.map(|id| RemotePeer::new(BRICK, id, 0)),
            in_transit: BytesInTransit::default(),
            first_output: 0,
            answers,
            is_up: [true; 2],
            held_until_ms: [0; 2],
            ahead_ms: AHEAD_MS,
            carried: [vec![], vec![]],
        }
    }

    fn send(&mut self, now: i64, index: usize, message: &Message) {
        let frame = self.remotes[index].frame(message);
        if self.is_up[index] {
            let arrival = (now + DELAYS_MS[index]).max(self.held_until_ms[index]);
            self.in_transit.send(at(arrival), index, frame);
        }
    }

    /// One millisecond; of the telemetry `loses` decides what never arrives by which link.
    fn step(&mut self, now: i64, loses: impl Fn(usize) -> bool) {
        let brick_ms = now + self.ahead_ms;
        let counts = now / PERIOD_MS;
        for index in 0..2 {
            if now % PERIOD_MS == 0 {
                let message = ticks(brick_ms as u32, counts, counts);
                if loses(index) {
                    self.remotes[index].frame(&message);
                } else {
                    self.send(now, index, &message);
                    self.carried[index].extend(self.is_up[index].then_some(brick_ms));
                }
            }
            if now % 1_000 == 0 {
                self.send(now, index, &HEARTBEAT);
            }
        }
        while let Some((index, bytes)) = self.in_transit.take_due(at(now)) {
            self.remotes[index].send_bytes(&mut self.station, at(now), &bytes);
        }
        self.station.pass_until(at(now));
        let requests = self.station.time_requests(self.first_output);
        self.first_output = self.station.outputs.len();
        if self.answers == TimeReplies::No {
            return;
        }
        for request in requests {
            let index = usize::from(request.link.0 - LINKS[0].0);
            let received_at = now + DELAYS_MS[index];
            self.send(received_at, index, &time_answer((received_at + self.ahead_ms) * 1_000_000, request.nanos));
        }
    }

    /// One millisecond; the quick link loses a tenth of the telemetry, so that the slow one brings new frames, too.
    fn lossy_step(&mut self, now: i64) {
        self.step(now, |index| index == 0 && now / PERIOD_MS % 10 == 0);
    }

    /// Brick instants in ms that were observed in (from, to] of host time, in rising order.
    fn observed(&self, from: Timestamp<HostClock>, to: Timestamp<HostClock>) -> Vec<i64> {
        let aligned = self.station.aligned().into_iter().filter(|aligned| aligned.now > from && aligned.now <= to);
        let mut stamps: Vec<i64> = aligned
            .map(|aligned| {
                assert_eq!((aligned.robot.link, aligned.robot.address), (LINKS[0], BRICK));
                aligned.observation.stamp.as_nanos() / 1_000_000
            })
            .collect();
        stamps.sort_unstable();
        stamps
    }
}

#[test]
fn two_links_to_one_robot_lose_only_what_both_lose_and_use_nothing_twice() {
    let mut run = RedundantBrick::new(TimeReplies::Yes);
    for now in 0..20_000 {
        let slot = now / PERIOD_MS;
        // Each loses a fifth, at other times, and now and then both.
        run.step(now, |index| match index {
            0 => slot % 5 == 0,
            _ => slot % 5 == 1 || slot % 20 == 0,
        });
    }
    let again = run.station.replayed(&redundant_config());
    assert!(
        format!("{:?}", run.station.outputs) == format!("{:?}", again.outputs),
        "the same inputs, the same outputs"
    );
    let [first, second] = &run.carried;
    let mut either: Vec<i64> = [first.clone(), second.clone()].concat();
    either.sort_unstable();
    either.dedup();
    // The last one may still be on its way.
    let observed = run.observed(at(-1), at(20_000));
    assert_eq!(observed, either[..observed.len()]);
    assert!(either.len() - observed.len() <= 1 && either.len() == 380);
    let both = first.iter().filter(|stamp| second.contains(stamp)).count() as u64;
    let counted: u64 = LINKS.map(|id| run.station.later_health(id).duplicates).iter().sum();
    assert!(both.abs_diff(counted) <= 1, "{both} {counted}");
}

#[test]
fn when_one_of_two_links_goes_down_only_frames_in_transit_are_lost() {
    let mut run = RedundantBrick::new(TimeReplies::Yes);
    for now in 0..12_000 {
        match now {
            4_000 => {
                run.is_up = [false, true];
                run.station.link(at(now), LINKS[0], LinkState::Down);
                run.in_transit.lose(|index| *index == 0);
            }
            7_980 => {
                run.is_up = [true, false];
                run.station.link(at(now), LINKS[1], LinkState::Down);
                run.in_transit.lose(|index| *index == 1);
                run.station.link(at(now), LINKS[0], LinkState::Up);
            }
            _ => {}
        }
        run.step(now, |_| false);
    }
    // The message of 7.95 s was on the slow link alone when that went down.
    let expected: Vec<i64> = (0..240).map(|k| PERIOD_MS * k).filter(|sent| *sent != 7_950).collect();
    assert_eq!(run.observed(at(-1), at(12_000)), expected.iter().map(|sent| AHEAD_MS + sent).collect::<Vec<_>>());
}

#[test]
fn both_links_bound_the_one_clock_and_both_carry_the_estimate() {
    let mut run = RedundantBrick::new(TimeReplies::Yes);
    for now in 0..20_000 {
        run.step(now, |_| false);
    }
    let aligned = run.station.clock_offsets();
    let (offset, uncertainty) = aligned.last().copied().expect("it answers");
    let error_ms = offset.as_millis_f64() - AHEAD_MS as f64;
    assert!(error_ms.abs() <= uncertainty.as_millis_f64() + 0.001);
    // The bounds of the quicker link: half a round trip of 10 ms, and the step of the counter.
    assert!(uncertainty.as_millis_f64() < 10.0);
    // Twice as many as one link gives, which sends a request each half second after ten quick ones.
    assert!(aligned.len() > 60, "{}", aligned.len());
    let poses = LINKS.map(|id| {
        let sent = run.station.sent();
        sent.filter(|sent| sent.link == id && matches!(sent.priority, Priority::Estimate { .. })).count()
    });
    assert_eq!(poses[0], poses[1]);
    assert!(poses[0] > 390, "{poses:?}");
    for id in LINKS {
        let health = run.station.later_health(id);
        assert!(health.clock_uncertainty.is_some() && health.round_trip.is_some());
        assert_eq!(health.forwarded, 0, "redundant links are not joined");
    }
}

#[test]
fn what_a_link_held_back_for_seconds_is_late_and_no_restart() {
    for answers in [TimeReplies::Yes, TimeReplies::No] {
        let mut run = RedundantBrick::new(answers);
        for now in 0..20_000_i64 {
            if now % 6_000 == 2_000 {
                run.held_until_ms[1] = now + 4_000;
            }
            run.lossy_step(now);
        }
        assert_eq!(run.station.restarts(), [], "{answers:?}");
        let observed = run.observed(at(-1), at(20_000));
        assert!(observed.windows(2).all(|pair| pair[0] < pair[1]), "twice");
        // What was sent before the last stall has come by one link or the other.
        let early = observed.iter().filter(|stamp| **stamp < 14_000 + AHEAD_MS);
        assert_eq!(early.count(), 280, "{answers:?}");
    }
}

#[test]
fn a_restart_is_detected_once_and_soon_despite_older_frames_of_a_slow_link() {
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
                    run.lossy_step(now);
                }
                let quickest = if quick_is_up { 0 } else { 9_000 + held_ms };
                let restarts = run.station.restarts();
                assert!(matches!(restarts[..], [one] if one <= at(quickest.max(10_000) + 150)), "{case}: {restarts:?}");
                // What was sent before it and comes after it is no instant of the new clock, and the rest is used once.
                let after = run.observed(restarts[0], at(20_000));
                assert!(after.windows(2).all(|pair| pair[0] < pair[1]), "{case}");
                assert!(after.iter().all(|stamp| *stamp < 10_000), "{case}");
                let sent = (at(20_000) - restarts[0]).as_millis_f64() / PERIOD_MS as f64;
                assert!(after.len() as f64 > sent - 5.0, "{case}: {}", after.len());
            }
        }
    }
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
    let restarts = station.restarts();
    assert!(matches!(restarts[..], [one] if one <= up + TimeDelta::from_millis(3_000)), "{restarts:?}");
}

#[test]
fn a_copy_by_a_redundant_link_is_not_used_because_a_detour_was_quicker_still() {
    let mut config = redundant_config();
    config.links.push(link(LINK, vec![]));
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
    assert_eq!(station.aligned().len(), 2);
}

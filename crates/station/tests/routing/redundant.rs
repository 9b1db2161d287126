//! Two links to one robot: only what both lose is lost, nothing is used twice, and both bound its clock.

use crate::brick::{self, BRICK, HEARTBEAT, ticks};
use crate::network::{BytesInTransit, RemotePeer};
use crate::routing_setup::health;
use crate::station::{STATION, TestStation, at, config, link, stream};
use posebridge_protocol::message::{Message, TimeSync};
use posebridge_station::OutputKind;
use posebridge_telemetry::{Event, LinkId, LinkState, Output, Priority, TimeDelta};

/// A brick that says everything on two links, which delay and lose for themselves, and answers time requests on each.
struct RedundantBrick {
    station: TestStation,
    remotes: [RemotePeer; 2],
    in_transit: BytesInTransit<usize>,
    seen: usize,
    /// Which messages came over which link, by their stamps in ms of brick time.
    arrived: [Vec<u32>; 2],
}

const LINKS: [LinkId; 2] = [LinkId(6), LinkId(7)];
const DELAYS_MS: [i64; 2] = [5, 45];
/// Brick time minus host time.
const AHEAD_MS: i64 = 5_000;

impl RedundantBrick {
    fn new() -> Self {
        let mut config = config();
        config.links = LINKS
            .map(|id| {
                let mut link = link(id, vec![stream(OutputKind::PlanarPose, 0)]);
                link.rules.group = Some(0);
                link
            })
            .to_vec();
        Self {
            station: TestStation::new(&config),
            remotes: LINKS.map(|id| RemotePeer::new(BRICK, id, 0)),
            in_transit: BytesInTransit::default(),
            seen: 0,
            arrived: [vec![], vec![]],
        }
    }

    fn send(&mut self, now: i64, index: usize, message: &Message) {
        let frame = self.remotes[index].frame(message);
        let arrival = at(now + DELAYS_MS[index]);
        self.in_transit.send(arrival, index, frame);
    }

    /// One millisecond; telemetry each 50 ms, of which `loses` decides what never arrives.
    fn step(&mut self, now: i64, is_up: [bool; 2], loses: impl Fn(usize) -> bool) {
        let brick_ms = u32::try_from(now + AHEAD_MS).expect("a short run");
        for index in 0..2 {
            if now % 1_000 == 0 && is_up[index] {
                self.send(now, index, &HEARTBEAT);
            }
            if now % 50 == 0 {
                let counts = now / 50;
                let message = ticks(brick_ms, counts, counts);
                let frame = self.remotes[index].frame(&message);
                if is_up[index] && !loses(index) {
                    self.in_transit.send(at(now + DELAYS_MS[index]), index, frame);
                    self.arrived[index].push(brick_ms);
                }
            }
        }
        while let Some((index, bytes)) = self.in_transit.take_due(at(now)) {
            self.remotes[index].send_bytes(&mut self.station, at(now), &bytes);
        }
        self.station.pass_until(at(now));
        self.answer(now, is_up);
    }

    fn answer(&mut self, now: i64, is_up: [bool; 2]) {
        let mut requests = Vec::new();
        for (_, output) in &self.station.outputs[self.seen..] {
            let Output::Transmit { link, bytes, .. } = output else {
                continue;
            };
            let index = usize::from(link.0 - LINKS[0].0);
            for message in brick::messages(bytes) {
                if let (Message::TimeSync(sync), true) = (message, is_up[index])
                    && sync.answer_nanos == 0
                {
                    requests.push((index, sync.request_nanos));
                }
            }
        }
        self.seen = self.station.outputs.len();
        for (index, request_nanos) in requests {
            let heard = now + DELAYS_MS[index];
            let answer = Message::TimeSync(TimeSync {
                answer_nanos: (heard + AHEAD_MS) * 1_000_000,
                request_nanos,
                target: Some(STATION),
            });
            self.send(heard, index, &answer);
        }
    }

    /// Brick times in ms of which an observation spoke, in the order in which they were used.
    fn observed(&self) -> Vec<u32> {
        let stamps = self.station.events().filter_map(|event| match event {
            Event::ObservationAligned { robot, observation, .. } => {
                assert_eq!((robot.link, robot.address), (LINKS[0], BRICK));
                u32::try_from(observation.stamp.as_nanos() / 1_000_000).ok()
            }
            _ => None,
        });
        stamps.collect()
    }
}

fn sorted(mut stamps: Vec<u32>) -> Vec<u32> {
    stamps.sort_unstable();
    stamps
}

#[test]
fn two_links_to_one_robot_lose_only_what_both_lose_and_use_nothing_twice() {
    let mut run = RedundantBrick::new();
    for now in 0..20_000 {
        let slot = now / 50;
        // Each loses a fifth, at other times, and now and then both.
        run.step(now, [true; 2], |index| match index {
            0 => slot % 5 == 0,
            _ => slot % 5 == 1 || slot % 20 == 0,
        });
    }
    let [first, second] = run.arrived.clone();
    let mut either: Vec<u32> = [first.clone(), second.clone()].concat();
    either.sort_unstable();
    either.dedup();
    // The last one may still be on its way.
    let observed = sorted(run.observed());
    assert_eq!(observed, either[..observed.len()]);
    assert!(either.len() - observed.len() <= 1 && either.len() == 380);
    let both = first.iter().filter(|stamp| second.contains(stamp)).count() as u64;
    let counted: u64 = LINKS.map(|id| health(&mut run.station, id).duplicates).iter().sum();
    assert!(both.abs_diff(counted) <= 1, "{both} {counted}");
}

#[test]
fn when_one_of_two_links_goes_down_only_what_was_on_its_way_is_lost() {
    let mut run = RedundantBrick::new();
    for now in 0..12_000 {
        let is_up = match now {
            0..4_000 => [true, true],
            4_000..7_980 => [false, true],
            _ => [true, false],
        };
        match now {
            4_000 => {
                run.station.link(at(now), LINKS[0], LinkState::Down);
                run.in_transit.lose(|index| *index == 0);
            }
            7_980 => {
                run.station.link(at(now), LINKS[1], LinkState::Down);
                run.in_transit.lose(|index| *index == 1);
                run.station.link(at(now), LINKS[0], LinkState::Up);
            }
            _ => {}
        }
        run.step(now, is_up, |_| false);
    }
    let observed = sorted(run.observed());
    let all: Vec<u32> = (0..240).map(|k| 5_000 + k * 50).collect();
    let missing: Vec<&u32> = all.iter().filter(|stamp| !observed.contains(stamp)).collect();
    // One message of brick time 12950 was on the slow link alone when that went down.
    assert_eq!(missing, [&12_950]);
    assert!(observed.windows(2).all(|pair| pair[0] < pair[1]));
}

#[test]
fn both_links_bound_the_one_clock_and_both_carry_the_estimate() {
    let mut run = RedundantBrick::new();
    for now in 0..20_000 {
        run.step(now, [true; 2], |_| false);
    }
    let aligned: Vec<(TimeDelta, TimeDelta)> = run
        .station
        .events()
        .filter_map(|event| match event {
            Event::BrickClockAligned { robot, offset, uncertainty, .. } => {
                assert_eq!(robot.link, LINKS[0]);
                Some((*offset, *uncertainty))
            }
            _ => None,
        })
        .collect();
    let (offset, uncertainty) = aligned.last().copied().expect("it answers");
    let error_ms = offset.as_millis_f64() - AHEAD_MS as f64;
    println!("{} alignments, {error_ms:+.3} ms, ± {:.3} ms", aligned.len(), uncertainty.as_millis_f64());
    assert!(error_ms.abs() <= uncertainty.as_millis_f64() + 0.001);
    // The bounds of the quicker link: half a round trip of 10 ms, and the step of the counter.
    assert!(uncertainty.as_millis_f64() < 10.0);
    // Twice as many as one link gives, which asks each half second after ten quick ones.
    assert!(aligned.len() > 60, "{}", aligned.len());
    let poses = LINKS.map(|id| {
        let sent = run.station.outputs.iter().filter(|(_, output)| {
            matches!(output, Output::Transmit { link, priority: Priority::Estimate { .. }, .. }
                if *link == id)
        });
        sent.count()
    });
    assert_eq!(poses[0], poses[1]);
    assert!(poses[0] > 390, "{poses:?}");
    for id in LINKS {
        let health = health(&mut run.station, id);
        assert!(health.clock_uncertainty.is_some() && health.round_trip.is_some());
        assert_eq!(health.forwarded, 0, "redundant links are not joined");
    }
}

#[test]
fn the_same_inputs_give_the_same_outputs_with_many_links_too() {
    let mut run = RedundantBrick::new();
    for now in 0..5_000 {
        run.step(now, [true; 2], |index| now % 3 == index as i64);
    }
    let fresh = RedundantBrick::new().station;
    let mut again = TestStation { engine: fresh.engine, inputs: vec![], outputs: fresh.outputs };
    // The first inputs are those that brought the links up.
    for (now, input) in &run.station.inputs[LINKS.len()..] {
        again.handle(*now, input.clone());
    }
    assert!(run.station.outputs.len() > 500);
    assert!(format!("{:?}", run.station.outputs) == format!("{:?}", again.outputs));
}

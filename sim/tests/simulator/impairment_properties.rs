//! What holds on every link: the books balance, a stream keeps its order, the log tells what arrived, equal seeds give equal links.

use std::collections::BTreeMap;

use posebridge_sim::impairment::{
    BurstLoss, ByteOutcome, Delay, DirectionProfile, Disconnects, Fragment, ImpairedDirection, ImpairedLink,
    ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile, LogEntry, LossCause, PieceSizes, RandomDelay, Rate,
};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_log_of_a_stream_tells_every_byte(profile in stream_profile(), traffic in traffic(), seed: u64) {
        let run = ImpairedRun::of(&profile, LinkKind::Stream, &traffic, seed);
        run.check_books()?;
        let mut logged = Vec::new();
        for entry in &run.log {
            if let ByteOutcome::Delivered { .. } = entry.outcome {
                logged.extend(entry.bytes.clone().map(|index| run.damaged(entry.unit, index)));
            }
        }
        let arrived: Vec<u8> = run.arrived.iter().flat_map(|(_, bytes)| bytes.clone()).collect();
        prop_assert_eq!(arrived, logged);
        let delivered: Vec<(u64, usize)> = run.byte_positions(|fate| matches!(fate, ByteOutcome::Delivered { .. }));
        prop_assert!(delivered.is_sorted(), "a stream keeps its order");
        prop_assert!(run.arrived.iter().all(|(at, _)| *at >= Timestamp::ZERO));
    }

    #[test]
    fn the_log_of_datagrams_tells_every_one(profile in datagram_profile(), traffic in traffic(), seed: u64) {
        let run = ImpairedRun::of(&profile, LinkKind::Datagram, &traffic, seed);
        run.check_books()?;
        let mut logged = Vec::new();
        for entry in &run.log {
            let whole = 0..run.units[entry.unit as usize].len();
            if let ByteOutcome::Delivered { at } | ByteOutcome::Duplicated { at } = entry.outcome {
                prop_assert_eq!(&entry.bytes, &whole);
                let bytes: Vec<u8> = whole.map(|index| run.damaged(entry.unit, index)).collect();
                logged.push((at, bytes));
            } else if let ByteOutcome::Lost(_) = entry.outcome {
                prop_assert_eq!(&entry.bytes, &whole, "whole or not at all");
            }
        }
        prop_assert_eq!(&run.arrived, &logged);
    }

    #[test]
    fn equal_seeds_give_equal_links_however_often_one_asks((kind, profile) in link(), traffic in traffic(), seed: u64) {
        let whole = ImpairedRun::of(&profile, kind, &traffic, seed);
        let again = ImpairedRun::of(&profile, kind, &traffic, seed);
        prop_assert_eq!(&whole.log, &again.log);
        // Asking at the end only: what arrives, and when, is the same.
        let mut late = ImpairedDirection::new(&profile, kind, seed, "test");
        for (at, bytes) in &traffic {
            late.offer(*at, bytes);
        }
        let arrived = std::iter::from_fn(|| late.poll(Timestamp::from_millis(10_000_000)));
        let arrived: Vec<_> = arrived.map(|delivery| (delivery.at, delivery.bytes)).collect();
        prop_assert_eq!(arrived, whole.arrived);
    }

    #[test]
    fn more_loss_of_any_kind_changes_nothing_for_what_still_arrives(
        (kind, profile) in link(), traffic in traffic(), seed: u64, stage in 0..3,
    ) {
        let profile = DirectionProfile { loss: 0.0, byte_loss: 0.0, burst_loss: None, ..profile };
        let burst_loss = Some(BurstLoss { mean_good_s: 0.3, mean_bad_s: 0.1, loss_good: 0.1, loss_bad: 0.9 });
        let more = match stage {
            0 => DirectionProfile { loss: 0.3, ..profile.clone() },
            1 if kind == LinkKind::Stream => DirectionProfile { byte_loss: 0.1, ..profile.clone() },
            _ => DirectionProfile { burst_loss, ..profile.clone() },
        };
        check_subset(&profile, &more, kind, &traffic, seed)?;
    }

    #[test]
    fn bursts_lie_where_they_lie_however_many_units_are_lost(traffic in traffic(), seed: u64) {
        let burst_loss = BurstLoss { mean_good_s: 0.1, mean_bad_s: 0.1, loss_good: 0.0, loss_bad: 1.0 };
        let profile = DirectionProfile { burst_loss: Some(burst_loss), ..DirectionProfile::default() };
        let more = DirectionProfile { loss: 0.5, ..profile.clone() };
        check_subset(&profile, &more, LinkKind::Datagram, &traffic, seed)?;
        let lost_in_bursts = |run: &ImpairedRun| run.byte_positions(|fate| fate == ByteOutcome::Lost(LossCause::Burst));
        let [all, some] = [&profile, &more].map(|profile| ImpairedRun::of(profile, LinkKind::Datagram, &traffic, seed));
        let all = lost_in_bursts(&all);
        prop_assert!(lost_in_bursts(&some).iter().all(|index| all.contains(index)));
    }

    #[test]
    fn both_directions_balance_over_outages(profile in stream_profile(), traffic in traffic(), seed: u64) {
        let disconnects = Disconnects { mean_up_s: 0.2, down_from_s: 0.05, down_to_s: 0.3 };
        let profile = LinkProfile {
            kind: LinkKind::Stream,
            to_station: profile.clone(),
            to_brick: profile,
            disconnects: Some(disconnects),
        };
        let mut link = ImpairedLink::new(&profile, seed, Timestamp::ZERO);
        let mut arrived = [0_u64; 2];
        let mut last = Timestamp::<HostClock>::ZERO;
        let mut is_up = true;
        let mut take = |event: ImpairedLinkEvent| {
            let at = match event {
                ImpairedLinkEvent::Arrived { end, delivery } => {
                    assert!(is_up, "nothing arrives over a link that is down");
                    arrived[usize::from(end == LinkEnd::Brick)] += delivery.bytes.len() as u64;
                    delivery.at
                }
                ImpairedLinkEvent::Down { at } => { is_up = false; at }
                ImpairedLinkEvent::Up { at } => { is_up = true; at }
            };
            assert!(at >= last, "in the order of time");
            last = at;
        };
        for (index, (at, bytes)) in traffic.iter().enumerate() {
            let from = if index % 2 == 0 { LinkEnd::Brick } else { LinkEnd::Station };
            while let Some(event) = link.poll(*at) {
                take(event);
            }
            link.offer(from, *at, bytes);
        }
        for _ in 0..1_000 {
            let next = link.deadline().unwrap_or(Timestamp::ZERO);
            while let Some(event) = link.poll(next) {
                take(event);
            }
        }
        for (end, arrived) in [(LinkEnd::Station, arrived[0]), (LinkEnd::Brick, arrived[1])] {
            let counters = link.counters(end);
            prop_assert_eq!(counters.bytes_delivered, arrived);
            prop_assert_eq!(counters.bytes_offered, arrived + counters.bytes_lost() + counters.bytes_on_the_way);
        }
    }
}

#[test]
fn an_instant_before_the_last_is_taken_for_the_last() {
    let mut direction = ImpairedDirection::new(&DirectionProfile::default(), LinkKind::Stream, 1, "test");
    direction.offer(Timestamp::from_millis(100), b"first");
    direction.offer(Timestamp::from_millis(-5), b"second");
    let mut arrived = Vec::new();
    while let Some(delivery) = direction.poll(Timestamp::ZERO) {
        arrived.push((delivery.at, delivery.bytes));
    }
    let at = Timestamp::from_millis(100);
    assert_eq!(arrived, [(at, b"first".to_vec()), (at, b"second".to_vec())]);
}

#[test]
fn a_long_delay_does_not_fill_the_memory() {
    let profile = LinkProfile::default().with_extra(0.0, 600_000.0).to_station;
    let mut direction = ImpairedDirection::new(&profile, LinkKind::Stream, 1, "test");
    for _ in 0..40 {
        direction.offer(Timestamp::ZERO, &vec![0; 1 << 20]);
    }
    let counters = direction.counters();
    assert_eq!(counters.bytes_on_the_way, 16 << 20);
    assert_eq!(counters.bytes_lost_to_full_buffer, 24 << 20);
}

#[test]
fn an_outage_frees_the_line() {
    let profile = DirectionProfile {
        rate: Some(Rate { bytes_per_s: 100.0, buffer_bytes: 2_000, burst_bytes: 0 }),
        ..DirectionProfile::default()
    };
    let mut direction = ImpairedDirection::new(&profile, LinkKind::Stream, 1, "test");
    // Ten seconds of bytes wait; after the outage the next ten bytes take a tenth of a second and not ten more.
    direction.offer(Timestamp::ZERO, &[0; 1_000]);
    direction.disconnect(Timestamp::from_millis(10));
    direction.offer(Timestamp::from_millis(15), b"unheard");
    direction.reconnect(Timestamp::from_millis(20));
    direction.offer(Timestamp::from_millis(20), b"ten bytes.");
    let trickled = direction.deadline().unwrap();
    assert_eq!(trickled, Timestamp::from_millis(120));
    assert_eq!(direction.counters().bytes_lost_to_outages, 1_007);
}

#[test]
fn an_outage_ends_a_long_delay() {
    let profile =
        DirectionProfile { delay: Delay { base_ms: 0.0, jitter_mean_ms: 60_000.0 }, ..DirectionProfile::default() };
    // What was on the way is gone, so the next unit need not arrive behind it: of two long delays the second is the shorter one
    // in half of all cases.
    let arrives_sooner = |seed: &u64| {
        let mut direction = ImpairedDirection::new(&profile, LinkKind::Stream, *seed, "test");
        direction.offer(Timestamp::ZERO, b"late");
        let late = direction.deadline();
        direction.disconnect(Timestamp::ZERO);
        direction.reconnect(Timestamp::ZERO);
        direction.offer(Timestamp::ZERO, b"next");
        direction.deadline() < late
    };
    let sooner = (0..400).filter(arrives_sooner).count();
    // Binomial: sigma 10.
    assert!((167..=233).contains(&sooner), "{sooner} of 400");
}

/// What still arrives with more loss arrives when it did, as it did and as often as it did.
fn check_subset(
    profile: &DirectionProfile,
    more: &DirectionProfile,
    kind: LinkKind,
    traffic: &[(Timestamp<HostClock>, Vec<u8>)],
    seed: u64,
) -> Result<(), TestCaseError> {
    let before = ImpairedRun::of(profile, kind, traffic, seed);
    let after = ImpairedRun::of(more, kind, traffic, seed);
    let (arrivals, still) = (before.arrivals(), after.arrivals());
    for (index, arrival) in &still {
        prop_assert_eq!(Some(arrival), arrivals.get(index), "{:?}", index);
    }
    // What is missing is what the added stage has taken.
    let taken = after.lost - before.lost;
    prop_assert_eq!(arrivals.len() as u64, still.len() as u64 + taken);
    Ok(())
}

/// What became of a byte that arrived.
#[derive(Debug, PartialEq, Eq)]
struct ByteArrivals {
    /// Once, or twice with a copy.
    instants: Vec<Timestamp<HostClock>>,
    as_what: u8,
}

/// What went in and what came out of one direction.
struct ImpairedRun {
    units: Vec<Vec<u8>>,
    arrived: Vec<(Timestamp<HostClock>, Vec<u8>)>,
    log: Vec<LogEntry>,
    flips: BTreeMap<(u64, usize), u8>,
    delivered: u64,
    lost: u64,
}

impl ImpairedRun {
    fn of(profile: &DirectionProfile, kind: LinkKind, traffic: &[(Timestamp<HostClock>, Vec<u8>)], seed: u64) -> Self {
        let mut direction = ImpairedDirection::new(profile, kind, seed, "test");
        let mut arrived = Vec::new();
        let mut poll_until = |direction: &mut ImpairedDirection, now| {
            while let Some(delivery) = direction.poll(now) {
                arrived.push((delivery.at, delivery.bytes));
            }
        };
        for (at, bytes) in traffic {
            poll_until(&mut direction, *at);
            direction.offer(*at, bytes);
        }
        while let Some(next) = direction.deadline() {
            poll_until(&mut direction, next);
        }
        let log = direction.take_log();
        let mut flips = BTreeMap::new();
        for entry in &log {
            if let ByteOutcome::Flipped { bit } = entry.outcome {
                *flips.entry((entry.unit, entry.bytes.start)).or_default() ^= 1 << bit;
            }
        }
        Self {
            units: traffic.iter().map(|(_, bytes)| bytes.clone()).collect(),
            arrived,
            log,
            flips,
            delivered: direction.counters().bytes_delivered,
            lost: direction.counters().bytes_lost(),
        }
    }

    /// A byte as it arrives, if it does.
    fn damaged(&self, unit: u64, index: usize) -> u8 {
        let flips = self.flips.get(&(unit, index)).copied().unwrap_or(0);
        self.units[unit as usize][index] ^ flips
    }

    /// When each byte arrives, each time that it does, and as what.
    fn arrivals(&self) -> BTreeMap<(u64, usize), ByteArrivals> {
        let mut arrivals = BTreeMap::new();
        for entry in &self.log {
            let (ByteOutcome::Delivered { at } | ByteOutcome::Duplicated { at }) = entry.outcome else {
                continue;
            };
            for index in entry.bytes.clone() {
                let as_what = self.damaged(entry.unit, index);
                let key = (entry.unit, index);
                let arrival = arrivals.entry(key).or_insert_with(|| ByteArrivals { instants: Vec::new(), as_what });
                arrival.instants.push(at);
            }
        }
        arrivals
    }

    fn byte_positions(&self, is_match: impl Fn(ByteOutcome) -> bool) -> Vec<(u64, usize)> {
        let entries = self.log.iter().filter(|entry| is_match(entry.outcome));
        entries.flat_map(|entry| entry.bytes.clone().map(|index| (entry.unit, index))).collect()
    }

    /// Every offered byte is delivered once or lost once, by the log and by the counters.
    fn check_books(&self) -> Result<(), TestCaseError> {
        let mut positions =
            self.byte_positions(|fate| matches!(fate, ByteOutcome::Delivered { .. } | ByteOutcome::Lost(_)));
        positions.sort_unstable();
        let offered: Vec<(u64, usize)> = self
            .units
            .iter()
            .enumerate()
            .flat_map(|(unit, bytes)| (0..bytes.len()).map(move |index| (unit as u64, index)))
            .collect();
        prop_assert_eq!(&positions, &offered);
        prop_assert_eq!(self.delivered + self.lost, offered.len() as u64);
        Ok(())
    }
}

/// Units of up to 300 bytes, up to 60 ms apart.
fn traffic() -> impl Strategy<Value = Vec<(Timestamp<HostClock>, Vec<u8>)>> {
    let unit = (0_i64..60_000, prop::collection::vec(any::<u8>(), 0..300));
    prop::collection::vec(unit, 1..40).prop_map(|units| {
        let mut at = Timestamp::ZERO;
        let arrival = |(gap_micros, bytes): (i64, Vec<u8>)| {
            at = at + TimeDelta::from_micros(gap_micros);
            (at, bytes)
        };
        units.into_iter().map(arrival).collect()
    })
}

/// Up to these.
fn random_delay(probability: f64, from_ms: f64, longer_ms: f64) -> impl Strategy<Value = RandomDelay> {
    (0.0..probability, 0.0..from_ms, 0.0..longer_ms).prop_map(|(probability, from_ms, longer_ms)| {
        let to_ms = from_ms + longer_ms;
        RandomDelay { probability, from_ms, to_ms }
    })
}

/// What both kinds of link have in common.
fn profile() -> impl Strategy<Value = DirectionProfile> {
    let rate = prop::option::of((500.0..20_000.0, 64_u32..2_000, 0_u32..200));
    let burst_loss = prop::option::of((0.05..0.5, 0.01..0.2, 0.0..0.2, 0.5..1.0));
    let delay = (0.0..30.0, 0.0..20.0);
    let stall = prop::option::of(random_delay(0.2, 50.0, 300.0));
    let slot_ms = prop::option::of(0.5..20.0);
    (rate, burst_loss, 0.0..0.2, 0.0..0.01, delay, stall, slot_ms).prop_map(
        |(rate, burst_loss, loss, bit_error_rate, (base_ms, jitter_mean_ms), stall, slot_ms)| DirectionProfile {
            rate: rate.map(|(bytes_per_s, buffer_bytes, burst_bytes)| Rate { bytes_per_s, buffer_bytes, burst_bytes }),
            loss,
            burst_loss: burst_loss.map(|(mean_good_s, mean_bad_s, loss_good, loss_bad)| BurstLoss {
                mean_good_s,
                mean_bad_s,
                loss_good,
                loss_bad,
            }),
            bit_error_rate,
            delay: Delay { base_ms, jitter_mean_ms },
            stalls: stall.into_iter().collect(),
            slot_ms,
            ..DirectionProfile::default()
        },
    )
}

fn stream_profile() -> impl Strategy<Value = DirectionProfile> {
    let sizes = prop_oneof![Just(PieceSizes::Fixed), Just(PieceSizes::Random)];
    let fragment = prop::option::of((1_u32..100, sizes));
    (profile(), 0.0..0.1, fragment).prop_map(|(profile, byte_loss, fragment)| DirectionProfile {
        byte_loss,
        fragment: fragment.map(|(most_bytes, sizes)| Fragment { most_bytes, sizes }),
        ..profile
    })
}

fn datagram_profile() -> impl Strategy<Value = DirectionProfile> {
    let reorder = prop::option::of(random_delay(0.5, 20.0, 50.0));
    (profile(), 0.0..0.3, reorder).prop_map(|(profile, duplicate, reorder)| DirectionProfile {
        duplicate,
        reorder,
        ..profile
    })
}

fn link() -> impl Strategy<Value = (LinkKind, DirectionProfile)> {
    prop_oneof![
        stream_profile().prop_map(|profile| (LinkKind::Stream, profile)),
        datagram_profile().prop_map(|profile| (LinkKind::Datagram, profile)),
    ]
}

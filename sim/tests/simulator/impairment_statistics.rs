//! Every stage of a link against the distribution that it claims, seeded: Kolmogorov-Smirnov, chi-square or the normal limit of a
//! binomial, each at about one false alarm in a thousand seeds.

use posebridge_sim::impairment::{
    BurstLoss, ByteOutcome, Delay, Delivery, DirectionProfile, Disconnects, Fragment, ImpairedDirection, ImpairedLink,
    ImpairedLinkEvent, LinkEnd, LinkKind, LinkProfile, LogEntry, PieceSizes, RandomDelay, Rate,
};
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

const SEED: u64 = 20;

#[test]
fn jitter_is_exponential_above_the_base() {
    let profile = impaired(|profile| profile.delay = Delay { base_ms: 15.0, jitter_mean_ms: 8.0 });
    let delays_ms = delays_ms(&profile, LinkKind::Stream, 4_000);
    assert!(delays_ms.iter().all(|delay| *delay >= 15.0));
    assert_distribution(&delays_ms, |delay| 1.0 - (-(delay - 15.0) / 8.0).exp());
}

#[test]
fn stalls_come_as_often_and_last_as_long_as_they_should() {
    let profile =
        impaired(|profile| profile.stalls = vec![RandomDelay { probability: 0.05, from_ms: 50.0, to_ms: 500.0 }]);
    let delays_ms = delays_ms(&profile, LinkKind::Stream, 20_000);
    let stalls: Vec<f64> = delays_ms.into_iter().filter(|delay| *delay > 0.0).collect();
    assert_frequency(stalls.len(), 20_000, 0.05);
    assert_distribution(&stalls, |stall| (stall - 50.0) / 450.0);
}

#[test]
fn a_saturated_line_carries_its_rate_and_drops_the_rest() {
    let profile =
        impaired(|profile| profile.rate = Some(Rate { bytes_per_s: 5_760.0, buffer_bytes: 2_048, burst_bytes: 0 }));
    for kind in [LinkKind::Stream, LinkKind::Datagram] {
        let mut direction = ImpairedDirection::new(&profile, kind, SEED, "line");
        for millis in 0..10_000 {
            direction.offer(ms(millis), &[0x55; 40]);
        }
        while direction.poll(ms(10_000)).is_some() {}
        let counters = direction.counters();
        // One piece may be unfinished, and the buffer may hold a unit less than it could.
        let carried = counters.bytes_delivered as f64;
        assert!((carried - 57_600.0).abs() <= 40.0, "{kind:?}: {carried}");
        let waiting = counters.bytes_on_the_way;
        assert!((2_008..=2_048).contains(&waiting), "{kind:?}: {waiting}");
        let dropped = counters.bytes_lost_to_full_buffer;
        assert_eq!(dropped, 400_000 - waiting - counters.bytes_delivered);
    }
}

#[test]
fn bursts_last_and_lie_apart_as_the_two_states_say() {
    let profile = impaired(|profile| {
        profile.burst_loss = Some(BurstLoss { mean_good_s: 0.5, mean_bad_s: 0.05, loss_good: 0.0, loss_bad: 1.0 });
    });
    let mut direction = ImpairedDirection::new(&profile, LinkKind::Datagram, SEED, "bursts");
    // Ten looks per mean burst would hide the short ones: two hundred.
    let look = TimeDelta::from_micros(250);
    let mut now = Timestamp::<HostClock>::ZERO;
    let mut is_lost = Vec::new();
    for _ in 0..800_000 {
        now = now + look;
        direction.offer(now, b"x");
        is_lost.push(direction.poll(now).is_none());
    }
    let (mut bursts_ms, mut gaps_ms) = (Vec::new(), Vec::new());
    for run in is_lost.chunk_by(|before, after| before == after) {
        let length_ms = run.len() as f64 * 0.25;
        if run[0] {
            bursts_ms.push(length_ms);
        } else {
            gaps_ms.push(length_ms);
        }
    }
    assert_distribution(&bursts_ms, |length| 1.0 - (-(length - 0.125) / 50.0).exp());
    assert_distribution(&gaps_ms, |length| 1.0 - (-(length - 0.125) / 500.0).exp());
    // About 360 pairs of gap and burst: the share of 1/11 has a sigma of 0.6 %.
    let share = is_lost.iter().filter(|lost| **lost).count() as f64 / is_lost.len() as f64;
    assert!((share - 1.0 / 11.0).abs() < 0.02, "{share}");
}

#[test]
fn a_link_begins_in_either_state_as_often_as_it_is_in_it() {
    let profile = impaired(|profile| {
        profile.burst_loss = Some(BurstLoss { mean_good_s: 3.0, mean_bad_s: 1.0, loss_good: 0.0, loss_bad: 1.0 });
    });
    let is_bad_at_first = |seed: &u64| {
        let mut direction = ImpairedDirection::new(&profile, LinkKind::Datagram, *seed, "begin");
        direction.offer(Timestamp::ZERO, b"x");
        direction.deadline().is_none()
    };
    assert_frequency((0..3_000).filter(is_bad_at_first).count(), 3_000, 0.25);
}

#[test]
fn each_state_loses_with_its_own_probability() {
    let lossy = |loss_good, loss_bad| {
        impaired(|profile| {
            profile.burst_loss = Some(BurstLoss { mean_good_s: 1.0, mean_bad_s: 1.0, loss_good, loss_bad });
        })
    };
    for (good, bad) in [(0.1, 0.1), (0.0, 1.0), (0.2, 0.6)] {
        let kinds = [LinkKind::Stream, LinkKind::Datagram];
        for kind in kinds {
            let mut direction = ImpairedDirection::new(&lossy(good, bad), kind, SEED, "states");
            for second in 0..8_000 {
                direction.offer(ms(second * 1_000), b"x");
            }
            // Looks a second apart hang together a little: e^-2 of one survives to the next, 1.3 sigma at most.
            let lost = direction.counters().bytes_lost_in_bursts as f64;
            let mean = 8_000.0 * 0.5 * (good + bad);
            assert!((lost - mean).abs() < 200.0, "{kind:?} {good} {bad}: {lost} for {mean}");
        }
    }
}

#[test]
fn bits_fail_at_their_rate_and_none_more_than_another() {
    let profile = impaired(|profile| profile.bit_error_rate = 1e-3);
    let (log, deliveries) = pass(&profile, LinkKind::Stream, 4_000, &[0; 250]);
    let mut per_bit = [0_usize; 8];
    for entry in &log {
        if let ByteOutcome::Flipped { bit } = entry.outcome {
            per_bit[usize::from(bit)] += 1;
        }
    }
    let flipped: usize = per_bit.iter().sum();
    assert_frequency(flipped, 8_000_000, 1e-3);
    assert_uniform(&per_bit);
    let ones: u32 = deliveries.iter().flat_map(|delivery| &delivery.bytes).map(|byte| byte.count_ones()).sum();
    assert_eq!(ones as usize, flipped, "what the log says is what arrived");
}

#[test]
fn single_bytes_and_whole_units_are_lost_at_their_rates() {
    let bytes = impaired(|profile| profile.byte_loss = 0.002);
    let units = LinkProfile::default().with_extra(0.1, 0.0).to_station;
    for (profile, count, length, probability) in [(bytes, 4_000, 250, 0.002), (units, 20_000, 5, 0.1)] {
        let (log, deliveries) = pass(&profile, LinkKind::Stream, count, &vec![0; length]);
        let lost = log.iter().filter(|entry| matches!(entry.outcome, ByteOutcome::Lost(_)));
        let lost_bytes: usize = lost.map(|entry| entry.bytes.len()).sum();
        // A unit is lost whole or not at all.
        let trial_bytes = if profile.loss > 0.0 { length } else { 1 };
        let offered = count as usize * length;
        assert_frequency(lost_bytes / trial_bytes, offered / trial_bytes, probability);
        assert!(trial_bytes == 1 || log.iter().all(|entry| entry.bytes == (0..length)));
        let arrived: usize = deliveries.iter().map(|delivery| delivery.bytes.len()).sum();
        assert_eq!(arrived + lost_bytes, offered);
    }
}

#[test]
fn datagrams_are_repeated_and_overtaken_at_their_rates() {
    let profile = impaired(|profile| {
        profile.duplicate = 0.05;
        profile.reorder = Some(RandomDelay { probability: 0.1, from_ms: 2.0, to_ms: 6.0 });
    });
    let mut direction = ImpairedDirection::new(&profile, LinkKind::Datagram, SEED, "copies");
    for millis in 0..20_000 {
        direction.offer(ms(millis), &(millis as u32).to_le_bytes());
    }
    let mut arrived = Vec::new();
    while let Some(delivery) = direction.poll(ms(30_000)) {
        arrived.push(u32::from_le_bytes(delivery.bytes.try_into().unwrap()));
    }
    let waits_ms: Vec<f64> = direction
        .take_log()
        .iter()
        .filter_map(|entry| {
            let ByteOutcome::HeldBack { by } = entry.outcome else {
                return None;
            };
            Some(by.as_millis_f64())
        })
        .collect();
    assert_frequency(waits_ms.len(), 20_000, 0.1);
    assert_distribution(&waits_ms, |wait| (wait - 2.0) / 4.0);
    let overtaken = arrived.windows(2).filter(|pair| pair[0] > pair[1]).count();
    assert!(overtaken > 1_000, "{overtaken}");
    let copies = arrived.len() - 20_000;
    assert_frequency(copies, 20_000, 0.05);
    assert_eq!(direction.counters().repeated as usize, copies);
    arrived.sort_unstable();
    arrived.dedup();
    assert_eq!(arrived.len(), 20_000, "nobody is missing");
}

#[test]
fn arrivals_lie_on_the_slots_and_wait_evenly_for_them() {
    let profile = impaired(|profile| profile.slot_ms = Some(15.0));
    let mut direction = ImpairedDirection::new(&profile, LinkKind::Stream, SEED, "slots");
    let mut waits_ms = Vec::new();
    let mut phases = Vec::new();
    for unit in 0..3_000_i64 {
        // 97.003 ms are no multiple of the slot: the offers walk through it.
        let now = Timestamp::from_micros(unit * 97_003);
        direction.offer(now, b"x");
        let at = direction.deadline().unwrap();
        waits_ms.push((at - now).as_millis_f64());
        phases.push(at.as_nanos().rem_euclid(15_000_000));
        direction.poll(at).unwrap();
    }
    assert!(phases.iter().all(|phase| *phase == phases[0]));
    assert_distribution(&waits_ms, |wait| wait / 15.0);
    // What waits for one slot comes together: 15 units of two bytes.
    let mut direction = ImpairedDirection::new(&profile, LinkKind::Stream, SEED, "slots");
    for millis in 0..300 {
        direction.offer(ms(millis), b"ab");
    }
    let chunks: Vec<usize> =
        std::iter::from_fn(|| direction.poll(ms(400))).map(|delivery| delivery.bytes.len()).collect();
    assert!(chunks[1..20].iter().all(|length| *length == 30), "{chunks:?}");
}

#[test]
fn pieces_of_random_size_are_equally_likely_up_to_the_largest() {
    let profile = impaired(|profile| profile.fragment = Some(Fragment { most_bytes: 8, sizes: PieceSizes::Random }));
    let (_, deliveries) = pass(&profile, LinkKind::Stream, 20, &[7; 10_000]);
    let mut sizes = [0_usize; 8];
    for delivery in &deliveries {
        sizes[delivery.bytes.len() - 1] += 1;
    }
    assert_uniform(&sizes);
    let fixed = impaired(|profile| profile.fragment = Some(Fragment { most_bytes: 20, sizes: PieceSizes::Fixed }));
    let (_, deliveries) = pass(&fixed, LinkKind::Stream, 1, &[7; 45]);
    let sizes: Vec<usize> = deliveries.iter().map(|delivery| delivery.bytes.len()).collect();
    assert_eq!(sizes, [20, 20, 5]);
}

#[test]
fn outages_come_exponentially_last_evenly_and_take_what_is_on_the_way() {
    let profile = LinkProfile {
        disconnects: Some(Disconnects { mean_up_s: 12.0, down_from_s: 1.0, down_to_s: 10.0 }),
        ..LinkProfile::default().with_extra(0.0, 50.0)
    };
    let mut link = ImpairedLink::new(&profile, SEED, Timestamp::ZERO);
    let (mut ups_s, mut downs_s) = (Vec::new(), Vec::new());
    let mut changed = Timestamp::<HostClock>::ZERO;
    for step in 0..200_000_i64 {
        let now = ms(step * 100);
        link.offer(LinkEnd::Brick, now, b"to the station");
        link.offer(LinkEnd::Station, now, b"to the brick");
        while let Some(event) = link.poll(now) {
            match event {
                ImpairedLinkEvent::Down { at } => {
                    ups_s.push((at - changed).as_secs_f64());
                    changed = at;
                }
                ImpairedLinkEvent::Up { at } => {
                    downs_s.push((at - changed).as_secs_f64());
                    changed = at;
                }
                ImpairedLinkEvent::Arrived { .. } => {}
            }
        }
    }
    assert_distribution(&ups_s, |up| 1.0 - (-up / 12.0).exp());
    assert_distribution(&downs_s, |down| (down - 1.0) / 9.0);
    // A unit is lost if it is offered while the link is down or less than its 50 ms before: 5.5 s and 0.05 s of 17.5.
    for end in [LinkEnd::Station, LinkEnd::Brick] {
        let counters = link.counters(end);
        let share = counters.bytes_lost_to_outages as f64 / counters.bytes_offered as f64;
        assert!((share - 5.55 / 17.5).abs() < 0.03, "{end:?}: {share}");
    }
}

/// A clean direction but for what `change` sets.
fn impaired(change: impl FnOnce(&mut DirectionProfile)) -> DirectionProfile {
    let mut profile = DirectionProfile::default();
    change(&mut profile);
    profile
}

/// Log and deliveries of so many equal units a second apart.
fn pass(profile: &DirectionProfile, kind: LinkKind, units: i64, bytes: &[u8]) -> (Vec<LogEntry>, Vec<Delivery>) {
    let mut direction = ImpairedDirection::new(profile, kind, SEED, "test");
    let mut deliveries = Vec::new();
    for unit in 0..units {
        direction.offer(ms(unit * 1_000), bytes);
        while let Some(delivery) = direction.poll(ms(unit * 1_000)) {
            deliveries.push(delivery);
        }
    }
    (direction.take_log(), deliveries)
}

/// Delays of single units that lie so far apart that none waits for another.
fn delays_ms(profile: &DirectionProfile, kind: LinkKind, units: i64) -> Vec<f64> {
    let mut direction = ImpairedDirection::new(profile, kind, SEED, "test");
    (0..units)
        .map(|unit| {
            let now = ms(unit * 60_000);
            direction.offer(now, b"unit");
            let at = direction.deadline().unwrap();
            direction.poll(at).unwrap();
            (at - now).as_millis_f64()
        })
        .collect()
}

fn ms(millis: i64) -> Timestamp<HostClock> {
    Timestamp::from_millis(millis)
}

/// Kolmogorov-Smirnov: the largest distance between sample and distribution stays below 1.95 / sqrt(n), its 0.1 % quantile.
fn assert_distribution(sample: &[f64], distribution: impl Fn(f64) -> f64) {
    let mut sorted = sample.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    assert!(n > 300.0, "only {n} values");
    let distance = sorted
        .iter()
        .enumerate()
        .map(|(index, value)| {
            let expected = distribution(*value);
            let (below, above) = (index as f64 / n, (index + 1) as f64 / n);
            (expected - below).abs().max((expected - above).abs())
        })
        .fold(0.0, f64::max);
    assert!(distance < 1.95 / n.sqrt(), "distance {distance}, n {n}");
}

/// A binomial count lies within 3.3 sigma of its mean.
fn assert_frequency(count: usize, trials: usize, probability: f64) {
    let mean = trials as f64 * probability;
    let sigma = (mean * (1.0 - probability)).sqrt();
    let off = (count as f64 - mean).abs();
    assert!(off < 3.3 * sigma, "{count} of {trials}, expected {mean} +- {sigma}");
}

/// Chi-square with seven degrees of freedom: 24.3 is its 0.1 % quantile.
fn assert_uniform(counts: &[usize; 8]) {
    let mean = counts.iter().sum::<usize>() as f64 / 8.0;
    let chi_square: f64 = counts.iter().map(|count| (*count as f64 - mean).powi(2) / mean).sum();
    assert!(chi_square < 24.3, "{chi_square}: {counts:?}");
}

//! The alignment of one clock over links of known delays: how exact it is, how soon, and whether its bounds hold.
//!
//! The figures are those of docs/maths/clock.md: `cargo test -p posebridge-station --test station clock_alignment -- --nocapture`.

use crate::support::exchanges::{Path, RemoteTime, RoundTrip, bluetooth};
use posebridge_protocol::message::WireStamp;
use posebridge_station::clock::Endpoint;
use posebridge_station::clock::align::{ClockAligner, ExchangeOutcome};
use posebridge_telemetry::{BrickClock, HostClock, TimeDelta, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const SEEDS: std::ops::RangeInclusive<u64> = 1..=8;
/// For the figure that is nearest to its limit.
const MANY_SEEDS: std::ops::RangeInclusive<u64> = 1..=20;
/// Replies are stamped in full microseconds.
const RESOLUTION_S: f64 = 1e-6;

fn host(seconds: f64) -> Timestamp<HostClock> {
    Timestamp::from_secs_f64(seconds)
}

/// What became of an alignment.
#[derive(Clone, Copy, Debug, Default)]
#[expect(clippy::struct_field_names, reason = "the unit is part of every name of a bare number")]
struct AlignmentErrors {
    /// Worst error from the scored instant on, s.
    worst_s: f64,
    /// By how much the error left the bounds at any time, s; negative: never.
    outside_s: f64,
    /// From the first request to the first conversion, s.
    first_s: Option<f64>,
    /// By how much a converted instant ran backwards, s; zero or less: never.
    backwards_s: f64,
    /// The bound at the end, s.
    uncertainty_s: f64,
}

/// A clock that is aligned, watched at all times.
struct AlignmentMonitor<'a> {
    aligner: ClockAligner<BrickClock>,
    truth: &'a RemoteTime,
    scored_from_s: f64,
    last_host: Option<Timestamp<HostClock>>,
    last_remote: Option<Timestamp<BrickClock>>,
    outcome: AlignmentErrors,
}

impl<'a> AlignmentMonitor<'a> {
    fn new(truth: &'a RemoteTime, scored_from_s: f64) -> Self {
        Self {
            aligner: ClockAligner::default(),
            truth,
            scored_from_s,
            last_host: None,
            last_remote: None,
            outcome: AlignmentErrors { outside_s: f64::NEG_INFINITY, ..AlignmentErrors::default() },
        }
    }

    fn exchange(&mut self, trip: &RoundTrip) -> ExchangeOutcome<BrickClock> {
        let nanos = (self.truth.at(trip.answered_s) * 1e9) as i64;
        let outcome =
            self.aligner.observe_exchange(Endpoint::default(), host(trip.sent_s), host(trip.received_s), nanos);
        self.sample(trip);
        outcome
    }

    /// A message without a request, such as telemetry.
    fn arrival(&mut self, trip: &RoundTrip) {
        let stamp = WireStamp::Micros64((self.truth.at(trip.answered_s) * 1e6) as u64);
        self.aligner.observe_arrival(Endpoint::default(), stamp, host(trip.received_s));
        self.sample(trip);
    }

    /// Samples the alignment at the reply's stamp, at now, at shortly after and at some seconds before.
    fn sample(&mut self, trip: &RoundTrip) {
        let now_s = trip.received_s;
        for at_s in [(now_s - 2.0).max(0.0), trip.answered_s, now_s + 0.08, now_s] {
            self.check(at_s);
        }
        if self.outcome.first_s.is_none() {
            self.outcome.first_s = self.aligner.host_at(self.brick(now_s)).map(|_| trip.received_s);
        }
        self.order(trip);
    }

    fn brick(&self, host_s: f64) -> Timestamp<BrickClock> {
        Timestamp::from_secs_f64(self.truth.at(host_s))
    }

    fn check(&mut self, at_s: f64) {
        let Some((found, bound)) = self.aligner.host_at(self.brick(at_s)) else {
            return;
        };
        let error_s = (found - host(at_s)).as_secs_f64().abs();
        let outside_s = error_s - bound.as_secs_f64() - RESOLUTION_S;
        self.outcome.outside_s = self.outcome.outside_s.max(outside_s);
        self.outcome.uncertainty_s = bound.as_secs_f64();
        if at_s >= self.scored_from_s {
            self.outcome.worst_s = self.outcome.worst_s.max(error_s);
        }
    }

    /// Stamps in order must come out in order, in both directions, whatever was learnt between them.
    fn order(&mut self, trip: &RoundTrip) {
        let mut backwards = TimeDelta::ZERO;
        if let Some((found, _)) = self.aligner.host_at(self.brick(trip.answered_s)) {
            backwards = backwards.max(self.last_host.replace(found).unwrap_or(found) - found);
        }
        if let Some((found, _)) = self.aligner.remote_at(host(trip.received_s)) {
            backwards = backwards.max(self.last_remote.replace(found).unwrap_or(found) - found);
        }
        self.outcome.backwards_s = self.outcome.backwards_s.max(backwards.as_secs_f64());
    }
}

fn followed(path: &Path, truth: &RemoteTime, (from_s, to_s): (f64, f64)) -> AlignmentErrors {
    let mut watched = AlignmentMonitor::new(truth, from_s);
    for trip in path.round_trips(to_s) {
        watched.exchange(&trip);
    }
    watched.outcome
}

/// The worst of all seeds.
fn worst_of(outcomes: impl Iterator<Item = AlignmentErrors>) -> AlignmentErrors {
    let mut all = AlignmentErrors { outside_s: f64::NEG_INFINITY, first_s: Some(0.0), ..AlignmentErrors::default() };
    for one in outcomes {
        all.worst_s = all.worst_s.max(one.worst_s);
        all.outside_s = all.outside_s.max(one.outside_s);
        all.backwards_s = all.backwards_s.max(one.backwards_s);
        all.uncertainty_s = all.uncertainty_s.max(one.uncertainty_s);
        all.first_s = one.first_s.and_then(|one| all.first_s.map(|all| all.max(one)));
    }
    all
}

/// Prints the figures and holds what every case promises: bounds that hold, order, an early start.
fn promised(name: &str, outcome: AlignmentErrors) {
    let AlignmentErrors { worst_s, outside_s, first_s, backwards_s, uncertainty_s } = outcome;
    println!(
        "{name}: worst {:.3} ms, bound at the end {:.3} ms, first after {:.2} s, outside its bounds by {:.3} ms",
        worst_s * 1e3,
        uncertainty_s * 1e3,
        first_s.unwrap_or(f64::NAN),
        outside_s * 1e3
    );
    assert!(outside_s <= 0.0, "{name}: left the bounds by {outside_s} s");
    assert!(backwards_s <= 0.0, "{name}: ran backwards by {backwards_s} s");
    assert!(first_s.is_some_and(|first_s| first_s <= 3.0), "{name}");
}

#[test]
fn a_steady_clock_behind_a_bluetooth_link_is_known_to_a_tenth_of_a_millisecond() {
    for skew_ppm in [50.0, 2_021.0, -2_000.0] {
        let truth = RemoteTime::new(1_234.5, 180.0, |_| skew_ppm * 1e-6);
        let outcomes = MANY_SEEDS.map(|seed| followed(&bluetooth(seed), &truth, (100.0, 180.0)));
        let outcome = worst_of(outcomes);
        promised(&format!("{skew_ppm} ppm"), outcome);
        assert!(outcome.worst_s <= 0.1e-3, "{skew_ppm} ppm");
    }
}

#[test]
fn a_resonator_that_is_one_per_cent_off_is_aligned_throughout() {
    for skew_ppm in [9_000.0, -9_000.0, 10_000.0, -10_000.0] {
        let truth = RemoteTime::new(1_234.5, 180.0, |_| skew_ppm * 1e-6);
        let mut watched = AlignmentMonitor::new(&truth, 100.0);
        for (k, trip) in bluetooth(4).round_trips(180.0).iter().enumerate() {
            watched.exchange(trip);
            let aligned = watched.aligner.host_at(watched.brick(trip.answered_s));
            assert!(k < 2 || aligned.is_some(), "{skew_ppm} ppm, answer {k}");
        }
        promised(&format!("{skew_ppm} ppm"), watched.outcome);
        assert!(watched.outcome.worst_s <= 0.1e-3, "{skew_ppm} ppm");
    }
}

#[test]
fn half_of_an_asymmetry_is_the_error_and_the_bounds_know() {
    for (name, forth_s, back_s) in [("forth", 0.030, 0.015), ("back", 0.015, 0.030)] {
        let truth = RemoteTime::new(1_234.5, 180.0, |_| 50e-6);
        let outcome = worst_of(SEEDS.map(|seed| {
            let path = Path { forth_s, back_s, ..bluetooth(seed) };
            followed(&path, &truth, (100.0, 180.0))
        }));
        promised(&format!("15 ms longer {name}"), outcome);
        assert!((outcome.worst_s - 0.0075).abs() < 0.2e-3);
    }
}

/// A rate that walks: 0.1 ppm per root second.
fn walk(seed: u64) -> impl FnMut(f64) -> f64 {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut skew = 50e-6;
    move |_| {
        // Uniform steps with the variance of a step of 0.1 s.
        skew += 0.1e-6 * 0.1_f64.sqrt() * 3.0_f64.sqrt() * rng.random_range(-1.0..1.0);
        skew
    }
}

/// Ten minutes of clocks that warm up, 10 ppm in all.
fn drifting(seed: u64) -> Vec<(&'static str, RemoteTime)> {
    let phase = seed as f64;
    let turn = std::f64::consts::TAU / 600.0;
    vec![
        ("ramp of 10 ppm in 10 minutes", RemoteTime::new(5.0, 600.0, |t_s| 50e-6 + 10e-6 * t_s / 600.0)),
        (
            "sine of 10 ppm and 10 minutes",
            RemoteTime::new(5.0, 600.0, move |t_s| 50e-6 + 10e-6 * (turn * t_s + phase).sin()),
        ),
        ("walk of 0.1 ppm per root second", RemoteTime::new(5.0, 600.0, walk(seed))),
    ]
}

#[test]
fn a_clock_that_warms_up_is_followed_and_on_a_quick_link_the_bounds_are_narrow() {
    let cable = |path: Path| Path { forth_s: 10e-6, back_s: 10e-6, jitter_s: 100e-6, ..path };
    for kind in 0..3 {
        for (link, most_s, widest_s) in [("Bluetooth", 0.3e-3, f64::INFINITY), ("cable", 0.1e-3, 0.25e-3)] {
            let mut name = "";
            let outcome = worst_of(SEEDS.map(|seed| {
                let (kind_name, truth) = drifting(seed).swap_remove(kind);
                name = kind_name;
                let path = if link == "cable" { cable(bluetooth(seed)) } else { bluetooth(seed) };
                followed(&path, &truth, (100.0, 600.0))
            }));
            promised(&format!("{link}, {name}"), outcome);
            assert!(outcome.worst_s <= most_s && outcome.uncertainty_s <= widest_s, "{link}, {name}");
        }
    }
}

#[test]
fn a_restarted_clock_is_known_again_within_three_seconds() {
    for seed in SEEDS {
        let before = RemoteTime::new(700.0, 60.0, |_| 300e-6);
        let mut watched = AlignmentMonitor::new(&before, 0.0);
        for trip in bluetooth(seed).round_trips(60.0) {
            watched.exchange(&trip);
        }
        // Switched off and on: it counts from zero at host instant 62 s.
        let after = RemoteTime::new(-62.0, 120.0, |_| 300e-6);
        let mut anew = AlignmentMonitor::new(&after, 100.0);
        anew.aligner = watched.aligner;
        let mut restarts = 0;
        let late = bluetooth(seed + 100).round_trips(120.0);
        for trip in late.iter().filter(|trip| trip.sent_s >= 63.0) {
            restarts += u32::from(anew.exchange(trip).has_restarted);
        }
        let first_s = anew.outcome.first_s.map(|first_s| first_s - 63.0);
        promised("restart", AlignmentErrors { first_s, ..anew.outcome });
        assert_eq!(restarts, 1);
    }
}

#[test]
fn the_bounds_hold_while_answers_stay_away_and_telemetry_goes_on() {
    let truth = RemoteTime::new(50.0, 240.0, |_| 120e-6);
    let mut watched = AlignmentMonitor::new(&truth, 100.0);
    for trip in bluetooth(5).round_trips(170.0) {
        if trip.sent_s < 100.0 {
            watched.exchange(&trip);
        } else {
            watched.arrival(&trip);
        }
    }
    promised("70 s without answers", watched.outcome);
    assert!(watched.outcome.worst_s < 2e-3);
}

#[test]
fn a_clock_that_never_answers_is_known_within_its_assumption() {
    let truth = RemoteTime::new(50.0, 180.0, |_| 120e-6);
    let mut watched = AlignmentMonitor::new(&truth, 100.0);
    for trip in bluetooth(6).round_trips(180.0) {
        watched.arrival(&trip);
    }
    promised("one way", watched.outcome);
    // The smallest delay is 15 ms and not the 10 ms that were assumed.
    assert!((watched.outcome.worst_s - 5e-3).abs() < 0.2e-3);
    assert!((10e-3..15e-3).contains(&watched.outcome.uncertainty_s));
}

#[test]
fn an_answer_from_before_its_request_bounds_nothing() {
    let mut aligner = ClockAligner::<BrickClock>::default();
    for k in 0..10_i64 {
        let received = Timestamp::from_millis(k * 100);
        let sent = received + TimeDelta::from_millis(50);
        let outcome = aligner.observe_exchange(Endpoint::default(), sent, received, k * 100_000_000);
        assert_eq!(outcome.alignment, None);
    }
    assert_eq!(aligner.round_trip(), None);
}

#[test]
fn a_clock_that_steps_without_falling_is_known_again_after_three_answers() {
    let truth = RemoteTime::new(50.0, 60.0, |_| 0.0);
    let stepped = RemoteTime::new(50.5, 60.0, |_| 0.0);
    let mut watched = AlignmentMonitor::new(&truth, 0.0);
    let trips = bluetooth(7).round_trips(60.0);
    let (before, after) = trips.split_at(300);
    for trip in before {
        watched.exchange(trip);
    }
    let mut anew = AlignmentMonitor::new(&stepped, 0.0);
    anew.aligner = watched.aligner;
    for (k, trip) in after.iter().enumerate() {
        assert_eq!(anew.exchange(trip).alignment.is_some(), k >= 2, "answer {k}");
    }
    assert!(anew.outcome.outside_s <= 0.0);
}

//! Comparison of methods for clock alignment over a link: ours and those of other programs.
//!
//! # Model
//! ```text
//! s_k = k / 10 s                                    request k leaves
//! m_k = max(m_k-1, s_k + d)                         the brick answers it      d = base + Exp(8 ms), 1 %: + U(50, 500) ms
//! r_k = max(r_k-1, m_k + d')                        the answer arrives
//! b_k = clock(m_k)                                  what it is stamped with, whole microseconds
//! e_k = b_k + offset(m_k) - m_k                     the method's error, positive: taken for later than it was
//! ```
//! Sources: docs/maths/clock.md, section 6; of each foreign method the source of the program that uses it.

mod methods;

use posebridge_estimator::numerics::statistics::mean;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

pub use self::methods::{
    ArrivalTime, ClockExchange, ClockMethod, JitterCorrection, OneWayHull, TimeSyncFilter, TwoWayHulls,
};

#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    pub name: &'static str,
    pub open: fn() -> Box<dyn ClockMethod>,
}

pub const METHODS: &[MethodEntry] = &[
    // The instant of arrival stands for the stamp.
    MethodEntry { name: "arrival", open: || Box::new(ArrivalTime::default()) },
    // The TIMESYNC filter of PX4 and MAVROS as it is shipped, round trips below 10 ms only.
    MethodEntry { name: "timesync-10ms", open: || Box::new(TimeSyncFilter::new(0.010)) },
    // The same filter, round trips below 60 ms.
    MethodEntry { name: "timesync-60ms", open: || Box::new(TimeSyncFilter::new(0.060)) },
    // The same filter, any round trip.
    MethodEntry { name: "timesync-no-gate", open: || Box::new(TimeSyncFilter::new(f64::INFINITY)) },
    // ArduPilot's JitterCorrection: the quickest message of each hundred.
    MethodEntry { name: "one-way-minimum", open: || Box::new(JitterCorrection::default()) },
    // The line below all arrivals of the window.
    MethodEntry { name: "one-way-hull", open: || Box::new(OneWayHull::default()) },
    // Ours: half-way between the hulls of both directions.
    MethodEntry { name: "two-way-hulls", open: || Box::new(TwoWayHulls::default()) },
];

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockRow {
    pub case: &'static str,
    pub method: &'static str,
    /// Largest error of any seed; `None` without estimates.
    pub worst_ms: Option<f64>,
    /// Positive: timestamps are converted to later host times than true.
    pub mean_ms: Option<f64>,
    /// Share of the scored exchanges with an estimate, 0 to 1.
    pub answered: f64,
}

/// Runs every method of [`METHODS`] over every case of [`CLOCK_CASES`] with these seeds: one row for each, case by case.
///
/// The same seeds give the same rows. Without seeds no method starts.
pub fn compare_methods(seeds: &[u64]) -> Vec<ClockRow> {
    let pairs = CLOCK_CASES.iter().flat_map(|case| METHODS.iter().map(move |method| (case, method)));
    pairs.map(|(case, method)| row_of(case, method, seeds)).collect()
}

fn row_of(case: &ClockCase, method: &MethodEntry, seeds: &[u64]) -> ClockRow {
    let mut errors_ms: Vec<Option<f64>> = Vec::new();
    for seed in seeds {
        let mut clock = (method.open)();
        for known in case.exchanges(*seed) {
            clock.observe_exchange(&known.exchange);
            if known.answered_s >= case.scored_from_s {
                let found_s = clock.offset_at(known.answered_s).map(|offset_s| known.exchange.remote_s + offset_s);
                errors_ms.push(found_s.map(|found_s| (found_s - known.answered_s) * 1e3));
            }
        }
    }
    let answered_ms = || errors_ms.iter().flatten().copied();
    ClockRow {
        case: case.name,
        method: method.name,
        worst_ms: answered_ms().map(f64::abs).reduce(f64::max),
        mean_ms: mean(answered_ms()),
        answered: answered_ms().count() as f64 / errors_ms.len().max(1) as f64,
    }
}

// Simulated links and clocks with known truth: a Bluetooth serial port with about 30 ms for the radio's turn-around, jitter, and stalls
// as reported by users. Messages keep their order, as on a serial port.

const PERIOD_S: f64 = 0.1;
/// Minimum each way.
const BASE_DELAY_S: f64 = 0.015;
/// Mean of the exponential part of the delay.
const JITTER_S: f64 = 0.008;
/// Probability of a stall, and its duration.
const STALL_PROBABILITY: f64 = 0.01;
const STALL_S: std::ops::Range<f64> = 0.05..0.5;
/// Remote clock at the start of the session: the brick was switched on before.
const START_S: f64 = 1_234.5;

#[derive(Clone, Copy, Debug)]
pub struct ClockCase {
    pub name: &'static str,
    pub duration_s: f64,
    /// Host time from which errors count.
    pub scored_from_s: f64,
    /// Additional delay towards the brick.
    pub extra_forward_delay_s: f64,
    /// Gain of the clock over the host's, after a host time in seconds.
    pub drift_s: fn(f64) -> f64,
    /// Host time at which the clock restarts at zero.
    pub restart_at_s: Option<f64>,
}

const CRYSTAL_CASE: ClockCase = ClockCase {
    name: "50ppm",
    duration_s: 180.0,
    scored_from_s: 100.0,
    extra_forward_delay_s: 0.0,
    drift_s: |host_s| 50e-6 * host_s,
    restart_at_s: None,
};

pub const CLOCK_CASES: &[ClockCase] = &[
    CRYSTAL_CASE,
    ClockCase {
        name: "2021ppm",
        // A ceramic resonator.
        drift_s: |host_s| 2_021e-6 * host_s,
        ..CRYSTAL_CASE
    },
    ClockCase { name: "asymmetric", extra_forward_delay_s: 0.015, ..CRYSTAL_CASE },
    ClockCase {
        name: "drift",
        // From 50 to 60 ppm within ten minutes.
        duration_s: 600.0,
        drift_s: |host_s| 50e-6 * host_s + 10e-6 * host_s * host_s / 1_200.0,
        ..CRYSTAL_CASE
    },
    ClockCase { name: "reboot", restart_at_s: Some(120.0), ..CRYSTAL_CASE },
];

#[derive(Clone, Copy, Debug, PartialEq)]
struct SimulatedExchange {
    exchange: ClockExchange,
    answered_s: f64,
}

impl ClockCase {
    fn remote_time_s(&self, host_s: f64) -> f64 {
        let exact_s = match self.restart_at_s {
            Some(restart_s) if host_s >= restart_s => {
                host_s - restart_s + (self.drift_s)(host_s) - (self.drift_s)(restart_s)
            }
            _ => START_S + host_s + (self.drift_s)(host_s),
        };
        (exact_s * 1e6).floor() * 1e-6
    }

    fn exchanges(&self, seed: u64) -> Vec<SimulatedExchange> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let (mut answered_s, mut received_s) = (0.0_f64, 0.0_f64);
        let count = (self.duration_s / PERIOD_S).round() as u32;
        let exchanges = (0..count).map(|k| {
            let sent_s = f64::from(k) * PERIOD_S;
            answered_s = answered_s.max(sent_s + self.extra_forward_delay_s + draw_delay_s(&mut rng));
            received_s = received_s.max(answered_s + draw_delay_s(&mut rng));
            SimulatedExchange {
                exchange: ClockExchange { sent_s, remote_s: self.remote_time_s(answered_s), received_s },
                answered_s,
            }
        });
        exchanges.collect()
    }
}

fn draw_delay_s(rng: &mut Pcg64) -> f64 {
    let jitter_s = -JITTER_S * (1.0 - rng.random::<f64>()).ln();
    let stall_s = if rng.random::<f64>() < STALL_PROBABILITY { rng.random_range(STALL_S) } else { 0.0 };
    BASE_DELAY_S + jitter_s + stall_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_overtakes_and_nothing_is_quicker_than_the_link() {
        for case in CLOCK_CASES {
            let exchanges = case.exchanges(3);
            for pair in exchanges.windows(2) {
                assert!(pair[0].answered_s <= pair[1].answered_s, "{}", case.name);
                assert!(pair[0].exchange.received_s <= pair[1].exchange.received_s);
            }
            for known in &exchanges {
                let forth_s = known.answered_s - known.exchange.sent_s;
                assert!(forth_s >= BASE_DELAY_S + case.extra_forward_delay_s - 1e-9);
                assert!(known.exchange.received_s - known.answered_s >= BASE_DELAY_S - 1e-9);
            }
        }
    }

    #[test]
    fn a_restarted_clock_begins_at_zero() {
        let reboot = CLOCK_CASES.iter().find(|case| case.restart_at_s.is_some());
        let reboot = reboot.unwrap();
        assert_eq!(reboot.remote_time_s(120.0), 0.0);
        assert!((reboot.remote_time_s(130.0) - 10.0005).abs() < 1e-6);
        assert!((reboot.remote_time_s(100.0) - 1_334.505).abs() < 1e-6);
    }
}

//! Simulated links and clocks with known truth.
//!
//! The link is that of a Bluetooth serial port: about 30 ms for the radio's turn-around, jitter, and stalls as reported by users.
//! Messages keep their order, as on a serial port.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::ClockExchange;

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

/// A clock behind a link.
#[derive(Clone, Copy, Debug)]
pub struct ClockCase {
    pub name: &'static str,
    pub summary: &'static str,
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

/// 50 ppm: a good crystal.
const CRYSTAL_CASE: ClockCase = ClockCase {
    name: "50ppm",
    summary: "a crystal that is 50 ppm fast",
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
        summary: "a ceramic resonator that is 2021 ppm fast",
        drift_s: |host_s| 2_021e-6 * host_s,
        ..CRYSTAL_CASE
    },
    ClockCase {
        name: "asymmetric",
        summary: "50 ppm, and 15 ms more to the brick than back",
        extra_forward_delay_s: 0.015,
        ..CRYSTAL_CASE
    },
    ClockCase {
        name: "drift",
        summary: "from 50 to 60 ppm within ten minutes",
        duration_s: 600.0,
        drift_s: |host_s| 50e-6 * host_s + 10e-6 * host_s * host_s / 1_200.0,
        ..CRYSTAL_CASE
    },
    ClockCase {
        name: "reboot",
        summary: "50 ppm, and begins at zero again after 120 s",
        restart_at_s: Some(120.0),
        ..CRYSTAL_CASE
    },
];

/// An exchange with its truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SimulatedExchange {
    pub(super) exchange: ClockExchange,
    pub(super) answered_s: f64,
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

    pub(super) fn exchanges(&self, seed: u64) -> Vec<SimulatedExchange> {
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

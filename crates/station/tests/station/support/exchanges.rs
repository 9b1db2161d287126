//! Exchanges of time over a link with delays, in order, and a remote clock whose rate may change.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Requests per second.
pub(crate) const RATE_HZ: f64 = 10.0;
/// Step in which a changing rate is integrated, s.
const GRID_S: f64 = 0.1;

/// A remote clock: what it shows at host instants.
pub(crate) struct RemoteTime {
    start_s: f64,
    /// What it has gained on the host at each step of the grid, s.
    gained_s: Vec<f64>,
}

impl RemoteTime {
    /// A clock that showed `start_s` at host zero and runs by `1 + skew(t)`.
    pub(crate) fn new(start_s: f64, duration_s: f64, mut skew: impl FnMut(f64) -> f64) -> Self {
        let mut gained_s = vec![0.0];
        while GRID_S * (gained_s.len() as f64) < duration_s + 2.0 {
            let t_s = GRID_S * gained_s.len() as f64;
            let last_s = gained_s[gained_s.len() - 1];
            gained_s.push(last_s + GRID_S * skew(t_s));
        }
        Self { start_s, gained_s }
    }

    pub(crate) fn at(&self, host_s: f64) -> f64 {
        let grid_position = (host_s / GRID_S).max(0.0);
        let k = (grid_position as usize).min(self.gained_s.len() - 2);
        let (before_s, after_s) = (self.gained_s[k], self.gained_s[k + 1]);
        self.start_s + host_s + before_s + (grid_position - k as f64) * (after_s - before_s)
    }
}

/// A link: each way a smallest delay and an exponential one, now and then a stall; nothing overtakes.
#[derive(Clone, Copy)]
pub(crate) struct Path {
    pub(crate) seed: u64,
    pub(crate) forth_s: f64,
    pub(crate) back_s: f64,
    pub(crate) jitter_s: f64,
    pub(crate) stalls: f64,
}

/// A Bluetooth serial link: 15 ms and 8 ms each way, one in a hundred stalls for 50 to 500 ms.
pub(crate) fn bluetooth(seed: u64) -> Path {
    Path { seed, forth_s: 0.015, back_s: 0.015, jitter_s: 0.008, stalls: 0.01 }
}

/// When a request left, was answered and came back, by the host's clock.
#[derive(Clone, Copy)]
#[expect(clippy::struct_field_names, reason = "the unit is part of every name of a bare number")]
pub(crate) struct RoundTrip {
    pub(crate) sent_s: f64,
    pub(crate) answered_s: f64,
    pub(crate) received_s: f64,
}

impl Path {
    /// What happens to the requests of so many seconds.
    pub(crate) fn round_trips(&self, duration_s: f64) -> Vec<RoundTrip> {
        let mut rng = Pcg64::seed_from_u64(self.seed);
        let mut delay = |base_s: f64| {
            let jitter_s = -self.jitter_s * (1.0 - rng.random::<f64>()).ln();
            let is_stalled = rng.random::<f64>() < self.stalls;
            let stall_s = rng.random_range(0.05..0.5);
            base_s + jitter_s + if is_stalled { stall_s } else { 0.0 }
        };
        let (mut answered_s, mut received_s) = (0.0_f64, 0.0_f64);
        let count = (duration_s * RATE_HZ) as u32;
        let round_trips = (0..count).map(|k| {
            let sent_s = f64::from(k) / RATE_HZ;
            answered_s = answered_s.max(sent_s + delay(self.forth_s));
            received_s = received_s.max(answered_s + delay(self.back_s));
            RoundTrip { sent_s, answered_s, received_s }
        });
        round_trips.collect()
    }
}

//! Back-off: the delays before a lost link is opened again.
//!
//! The delays double from a quarter of a second to less than a second, with a little jitter, so that the links of a class
//! that lost the same access point do not all reconnect at the same instant. Those links belong to many processes and
//! have the same numbers, so the seed includes the process and its start time. A replay has no links and needs no
//! reproducible jitter.

use posebridge_telemetry::{LinkId, TimeDelta};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::host_timer::HostTimer;
use crate::transport::Transport;

/// Largest relative deviation from the nominal wait.
const JITTER: f64 = 0.1;

/// The seed of this session's jitter: the process, and the microsecond of its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SessionSeed(u64);

impl SessionSeed {
    pub(crate) fn from_timer(timer: &HostTimer) -> Self {
        Self::from_parts(std::process::id(), timer.utc_start())
    }

    const fn from_parts(process: u32, utc_start_micros: u64) -> Self {
        // Both change fastest in their lowest bits; apart they cannot cancel out.
        Self((process as u64).rotate_right(16) ^ utc_start_micros)
    }
}

/// After a loss; hides a loose contact.
const INITIAL_DELAY: TimeDelta = TimeDelta::from_millis(250);
/// Doubling ends here, so that a device is opened within a second of being there, jitter included.
const MAX_DELAY: TimeDelta = TimeDelta::from_millis(900);
/// The same for Bluetooth: while the radio calls a device that is not there, it has little time for those that are.
const MAX_RADIO_DELAY: TimeDelta = TimeDelta::from_millis(5_000);

#[derive(Clone, Debug)]
pub(crate) struct Backoff {
    nominal: TimeDelta,
    longest: TimeDelta,
    jitter: Pcg32,
}

impl Backoff {
    pub(crate) fn new(id: LinkId, transport: Transport, session: SessionSeed) -> Self {
        // Every number selects a sequence of its own.
        let seed = Pcg32::seed_from_u64(session.0).random::<u64>() ^ u64::from(id.0);
        let longest = if transport == Transport::Bluetooth { MAX_RADIO_DELAY } else { MAX_DELAY };
        Self { nominal: INITIAL_DELAY, longest, jitter: Pcg32::seed_from_u64(seed) }
    }

    /// The next delay; each is nominally twice as long as the one before, up to the longest.
    pub(crate) fn next_delay(&mut self) -> TimeDelta {
        let factor = 1.0 + self.jitter.random_range(-JITTER..=JITTER);
        let wait = TimeDelta::from_secs_f64(self.nominal.as_secs_f64() * factor);
        self.nominal = (self.nominal + self.nominal).min(self.longest);
        wait
    }

    /// Starts again from the shortest delay, after the link was up for a while.
    pub(crate) fn reset(&mut self) {
        self.nominal = INITIAL_DELAY;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 15 June 2025, in microseconds since 1970.
    const START: u64 = 1_750_000_000_000_000;

    fn waits_of(transport: Transport, id: u16, process: u32, start: u64) -> Vec<f64> {
        let session = SessionSeed::from_parts(process, start);
        let mut backoff = Backoff::new(LinkId(id), transport, session);
        (0..8).map(|_| backoff.next_delay().as_secs_f64()).collect()
    }

    fn waits(id: u16, process: u32, start: u64) -> Vec<f64> {
        waits_of(Transport::Serial, id, process, start)
    }

    #[test]
    fn waits_double_up_to_less_than_a_second_and_stray_by_a_tenth() {
        for (transport, nominal) in [
            (Transport::Serial, [0.25, 0.5, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9]),
            (Transport::Bluetooth, [0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 5.0, 5.0]),
        ] {
            for id in 0..50 {
                for (wait, nominal) in waits_of(transport, id, 1, START).into_iter().zip(nominal) {
                    assert!((wait / nominal - 1.0).abs() <= JITTER + 1e-9, "{wait} for {nominal}");
                }
            }
        }
    }

    #[test]
    fn no_two_of_a_class_wait_alike() {
        // One computer that starts thirty stations at once, thirty computers that are switched on together, and the links
        // of one station.
        let mut first = Vec::new();
        for step in 0..30 {
            first.push(waits(0, 4_000 + step, START)[0]);
            first.push(waits(0, 4_000, START + 1 + u64::from(step))[0]);
            first.push(waits(1 + step as u16, 4_000, START)[0]);
        }
        let (least, most) = (0.25 * (1.0 - JITTER), 0.25 * (1.0 + JITTER));
        for quarter in 0..4 {
            let from = least + (most - least) * f64::from(quarter) / 4.0;
            let within = |wait: &&f64| (from..from + (most - least) / 4.0).contains(*wait);
            let count = first.iter().filter(within).count();
            // Binomial: mean 22.5, sigma 4.1.
            assert!((9..=36).contains(&count), "{count} of 90 from {from}");
        }
        first.sort_by(f64::total_cmp);
        first.dedup();
        assert_eq!(first.len(), 90);
        assert_eq!(waits(3, 1, START), waits(3, 1, START));
    }
}

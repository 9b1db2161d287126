//! How long to wait before a link is opened again.
//!
//! Doubling from a quarter of a second to five seconds, with a little seeded jitter so that the ports of a class that
//! lost the same access point do not all knock in the same instant. It sleeps for nobody: it only says how long.

use posebridge_telemetry::{LinkId, Span};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Largest relative deviation from the nominal wait.
const JITTER: f64 = 0.1;

/// The nominal waits of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waits {
    /// After a loss.
    pub first: Span,
    /// Doubling ends here.
    pub longest: Span,
}

impl Default for Waits {
    /// A quarter of a second is short enough to hide a cable that was bumped, five seconds are what a person who
    /// re-plugs a brick is ready to look at.
    fn default() -> Self {
        Self {
            first: Span::from_millis(250),
            longest: Span::from_millis(5_000),
        }
    }
}

/// The waits of one link, in the order in which they are needed.
#[derive(Clone, Debug)]
pub(crate) struct Backoff {
    waits: Waits,
    nominal: Span,
    jitter: Pcg32,
}

impl Backoff {
    /// The waits of the link `id`; the same link has the same jitter in every session.
    pub(crate) fn new(id: LinkId, waits: Waits) -> Self {
        Self {
            waits,
            nominal: waits.first,
            jitter: Pcg32::seed_from_u64(u64::from(id.0)),
        }
    }

    /// The next wait; each is nominally twice as long as the one before, up to the longest.
    pub(crate) fn next_wait(&mut self) -> Span {
        let factor = 1.0 + self.jitter.random_range(-JITTER..=JITTER);
        let wait = Span::from_secs_f64(self.nominal.as_secs_f64() * factor);
        self.nominal = (self.nominal + self.nominal).min(self.waits.longest);
        wait
    }

    /// Starts again from the shortest wait, after the link was up for a while.
    pub(crate) fn reset(&mut self) {
        self.nominal = self.waits.first;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waits(id: u16, count: usize) -> Vec<f64> {
        let mut backoff = Backoff::new(LinkId(id), Waits::default());
        (0..count)
            .map(|_| backoff.next_wait().as_secs_f64())
            .collect()
    }

    #[test]
    fn waits_double_up_to_five_seconds_and_stray_by_a_tenth() {
        let nominal = [0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 5.0, 5.0];
        for id in 0..50 {
            for (wait, nominal) in waits(id, nominal.len()).into_iter().zip(nominal) {
                assert!(
                    (wait / nominal - 1.0).abs() <= JITTER + 1e-9,
                    "{wait} for {nominal}"
                );
            }
        }
    }

    #[test]
    fn the_jitter_belongs_to_the_link() {
        assert_eq!(waits(3, 6), waits(3, 6));
        assert_ne!(waits(3, 6), waits(4, 6));
    }

    #[test]
    fn a_reset_starts_from_the_shortest_wait() {
        let mut backoff = Backoff::new(LinkId(1), Waits::default());
        for _ in 0..6 {
            assert!(backoff.next_wait() > Span::ZERO);
        }
        backoff.reset();
        assert!(backoff.next_wait().as_secs_f64() < 0.3);
    }
}

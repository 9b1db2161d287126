//! How long an estimate takes inside the station.

use std::collections::VecDeque;

use posebridge_telemetry::Span;

use crate::model::LatencyRow;

/// Percentiles are over so many estimates: twenty seconds of a usual brick.
const KEPT: usize = 2_048;
/// Upper ends of the buckets in `/metrics`, in microseconds, in steps of about three; a quiet station needs some ten.
pub(crate) const BUCKETS_MICROS: [i64; 11] =
    [10, 30, 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000];

/// Latencies.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latency {
    last: VecDeque<Span>,
    buckets: [u64; BUCKETS_MICROS.len()],
    pub(crate) count: u64,
    pub(crate) sum: Span,
}

impl Latency {
    /// Takes one.
    pub(crate) fn take(&mut self, took: Span) {
        if self.last.len() >= KEPT {
            self.last.pop_front();
        }
        self.last.push_back(took);
        self.count += 1;
        self.sum += took;
        for (bucket, end) in self.buckets.iter_mut().zip(BUCKETS_MICROS) {
            *bucket += u64::from(took <= Span::from_micros(end));
        }
    }

    /// Upper end of each bucket, in microseconds, and how many are at most so long.
    pub(crate) fn buckets(&self) -> impl Iterator<Item = (i64, u64)> {
        BUCKETS_MICROS.into_iter().zip(self.buckets)
    }

    /// Percentiles of the last ones.
    pub(crate) fn row(&self) -> LatencyRow {
        let mut sorted: Vec<Span> = self.last.iter().copied().collect();
        sorted.sort_unstable();
        let at = |percent: usize| {
            let rank = sorted.len().saturating_sub(1) * percent / 100;
            sorted.get(rank).map_or(f64::NAN, |span| span.as_millis_f64())
        };
        LatencyRow { estimates: sorted.len() as u64, p50_ms: at(50).into(), p99_ms: at(99).into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_and_buckets_of_known_latencies() {
        let mut latency = Latency::default();
        for micros in (1..=101).rev() {
            latency.take(Span::from_micros(micros));
        }
        let row = latency.row();
        assert_eq!((row.p50_ms, row.p99_ms), (0.051.into(), 0.1.into()));
        let counts: Vec<u64> = latency.buckets().map(|(_, count)| count).collect();
        assert_eq!(counts[..4], [10, 30, 100, 101]);
        assert_eq!(latency.sum, Span::from_micros(101 * 51));
        assert_eq!(Latency::default().row().p50_ms, f64::NAN.into());
    }

    #[test]
    fn only_the_last_ones_are_kept() {
        let mut latency = Latency::default();
        for _ in 0..3 * KEPT {
            latency.take(Span::from_millis(9));
        }
        for _ in 0..KEPT {
            latency.take(Span::from_millis(1));
        }
        assert_eq!(latency.last.len(), KEPT);
        assert_eq!(latency.row().p99_ms, 1.0.into());
        assert_eq!(latency.count, 4 * KEPT as u64);
    }
}

//! The latency of estimates inside the station.

use std::collections::VecDeque;

use posebridge_telemetry::TimeDelta;

use crate::model::LatencyRow;

/// Number of estimates for percentiles: twenty seconds of a usual brick.
const MAX_SAMPLES: usize = 2_048;
/// Upper bounds of the buckets in `/metrics`, in microseconds, in steps of about three; a quiet station needs some
/// ten.
pub(crate) const BUCKETS_MICROS: [i64; 11] =
    [10, 30, 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000];

#[derive(Clone, Debug, Default)]
pub(crate) struct LatencyHistogram {
    last: VecDeque<TimeDelta>,
    buckets: [u64; BUCKETS_MICROS.len()],
    pub(crate) count: u64,
    pub(crate) sum: TimeDelta,
}

impl LatencyHistogram {
    pub(crate) fn record(&mut self, took: TimeDelta) {
        if self.last.len() >= MAX_SAMPLES {
            self.last.pop_front();
        }
        self.last.push_back(took);
        self.count += 1;
        self.sum += took;
        for (bucket, end) in self.buckets.iter_mut().zip(BUCKETS_MICROS) {
            *bucket += u64::from(took <= TimeDelta::from_micros(end));
        }
    }

    /// Upper bound in microseconds and cumulative count.
    pub(crate) fn buckets(&self) -> impl Iterator<Item = (i64, u64)> {
        BUCKETS_MICROS.into_iter().zip(self.buckets)
    }

    pub(crate) fn row(&self) -> LatencyRow {
        let mut sorted: Vec<TimeDelta> = self.last.iter().copied().collect();
        sorted.sort_unstable();
        let at = |percent: usize| {
            let rank = sorted.len().saturating_sub(1) * percent / 100;
            sorted.get(rank).map_or(f64::NAN, |delay| delay.as_millis_f64())
        };
        LatencyRow { estimates: sorted.len() as u64, p50_ms: at(50).into(), p99_ms: at(99).into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_and_buckets_of_known_latencies() {
        let mut latency = LatencyHistogram::default();
        for micros in (1..=101).rev() {
            latency.record(TimeDelta::from_micros(micros));
        }
        let row = latency.row();
        assert_eq!((row.p50_ms, row.p99_ms), (0.051.into(), 0.1.into()));
        let counts: Vec<u64> = latency.buckets().map(|(_, count)| count).collect();
        assert_eq!(counts[..4], [10, 30, 100, 101]);
        assert_eq!(latency.sum, TimeDelta::from_micros(101 * 51));
        assert_eq!(LatencyHistogram::default().row().p50_ms, f64::NAN.into());
    }

    #[test]
    fn only_the_last_ones_are_kept() {
        let mut latency = LatencyHistogram::default();
        for _ in 0..3 * MAX_SAMPLES {
            latency.record(TimeDelta::from_millis(9));
        }
        for _ in 0..MAX_SAMPLES {
            latency.record(TimeDelta::from_millis(1));
        }
        assert_eq!(latency.last.len(), MAX_SAMPLES);
        assert_eq!(latency.row().p99_ms, 1.0.into());
        assert_eq!(latency.count, 4 * MAX_SAMPLES as u64);
    }
}

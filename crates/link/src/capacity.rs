//! The throughput of a link, in bytes per second, measured while frames wait for it.
//!
//! ```text
//! busy         time during which at least one frame waits, and the gaps between two such times that are short enough
//! sample       bytes taken while busy / busy, for each second of it
//! capacity     first sample, then capacity + (sample - capacity) / 2
//! ```
//!
//! A link without a queue shows only the load, not its capacity. So only busy time counts, and bytes accepted at the
//! moment when it begins do not. A system that accepts bytes in large blocks empties our queue with each block and is
//! full again a moment later; such a gap is part of the busy time, because during it the link sends what it has
//! accepted. Halving the difference with each second follows a fading radio within a few seconds.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

/// Longest gap of a stream whose system accepts bytes in blocks of unknown size: our TCP sockets accept 1 KiB at a time, and a
/// 4000 byte/s link has sent that after this time.
pub(crate) const COARSE_WRITE_GAP: TimeDelta = TimeDelta::from_millis(250);
const FIRST_WINDOW: TimeDelta = TimeDelta::from_millis(500);
/// Busy time of every later sample: the period of the station's link health events.
const WINDOW: TimeDelta = TimeDelta::from_millis(1_000);
/// How long a measurement stays valid after the last frame waited: long enough to be seen, and short enough that a sender
/// which reduced its rate tries again.
const MEASUREMENT_LIFETIME: TimeDelta = TimeDelta::from_millis(5_000);

/// Whether a link keeps up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backlog {
    Empty,
    Pending,
}

/// The measurement of one peer or one link.
#[derive(Clone, Debug, Default)]
pub struct CapacityMeter {
    longest_gap: TimeDelta,
    /// The last record, if frames waited then.
    backlogged_since: Option<Timestamp<HostClock>>,
    /// When the last waiting frame was accepted, and the bytes accepted since.
    idle_gap: Option<(Timestamp<HostClock>, u64)>,
    last_backlogged: Option<Timestamp<HostClock>>,
    /// Busy time and bytes of the current sample.
    backlogged_time: TimeDelta,
    written_bytes: u64,
    bytes_per_s: Option<f64>,
}

impl CapacityMeter {
    /// A meter that counts gaps of up to `longest_gap` as busy.
    pub fn with_longest_gap(longest_gap: TimeDelta) -> Self {
        Self { longest_gap, ..Self::default() }
    }

    /// Records that the link has accepted `taken_bytes` since the last record, and whether frames wait after that. A timestamp
    /// before the last one adds bytes but no time.
    pub fn record_write(&mut self, now: Timestamp<HostClock>, taken_bytes: usize, backlog: Backlog) {
        let taken_bytes = taken_bytes as u64;
        if let Some(since) = self.backlogged_since {
            self.accumulate((now - since).max(TimeDelta::ZERO), taken_bytes);
        } else if let Some((begun, bytes)) = self.idle_gap {
            let bytes = bytes + taken_bytes;
            self.idle_gap = Some((begun, bytes));
            if backlog == Backlog::Pending && now - begun <= self.longest_gap {
                self.accumulate((now - begun).max(TimeDelta::ZERO), bytes);
            }
        }
        match backlog {
            Backlog::Empty => {
                let ended = self.backlogged_since.take().map(|since| since.max(now));
                let may_join = |gap: &(Timestamp<HostClock>, u64)| now - gap.0 <= self.longest_gap;
                self.idle_gap = ended.map(|at| (at, 0)).or(self.idle_gap.filter(may_join));
            }
            Backlog::Pending => {
                let latest = self.backlogged_since.map_or(now, |since| since.max(now));
                self.idle_gap = None;
                self.last_backlogged = Some(latest);
                self.backlogged_since = Some(latest);
            }
        }
    }

    /// As [`Self::record_write`], for writers that seldom lag: reads `now` only if the record would change something.
    pub(crate) fn record_write_if_busy(
        &mut self,
        now: impl FnOnce() -> Timestamp<HostClock>,
        taken_bytes: usize,
        backlog: Backlog,
    ) {
        if backlog == Backlog::Pending || self.is_busy() {
            self.record_write(now(), taken_bytes, backlog);
        }
    }

    fn accumulate(&mut self, duration: TimeDelta, taken_bytes: u64) {
        self.backlogged_time += duration;
        self.written_bytes += taken_bytes;
        self.update_estimate();
    }

    /// Whether frames waited at the last record or shortly before.
    pub const fn is_busy(&self) -> bool {
        self.backlogged_since.is_some() || self.idle_gap.is_some()
    }

    fn update_estimate(&mut self) {
        let window = if self.bytes_per_s.is_some() { WINDOW } else { FIRST_WINDOW };
        if self.backlogged_time < window {
            return;
        }
        let sample = self.written_bytes as f64 / self.backlogged_time.as_secs_f64();
        self.bytes_per_s = Some(match self.bytes_per_s {
            Some(before) => before + (sample - before) / 2.0,
            None => sample,
        });
        self.backlogged_time = TimeDelta::ZERO;
        self.written_bytes = 0;
    }

    /// The throughput in bytes per second; `None` before the first sample, and when the link has kept up for five seconds.
    pub fn bytes_per_s(&self, now: Timestamp<HostClock>) -> Option<f64> {
        let last_waited = self.last_backlogged?;
        let is_recent = self.backlogged_since.is_some() || now - last_waited <= MEASUREMENT_LIFETIME;
        self.bytes_per_s.filter(|_| is_recent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link that accepts `bytes` every `period_ms` while frames wait.
    fn run(meter: &mut CapacityMeter, from_ms: i64, to_ms: i64, bytes: usize, period_ms: i64) {
        let mut at = from_ms;
        while at <= to_ms {
            let taken = if at == from_ms { 0 } else { bytes };
            meter.record_write(Timestamp::from_millis(at), taken, Backlog::Pending);
            at += period_ms;
        }
    }

    fn capacity(meter: &CapacityMeter, ms: i64) -> Option<f64> {
        meter.bytes_per_s(Timestamp::from_millis(ms))
    }

    #[test]
    fn a_link_that_keeps_up_has_no_capacity() {
        let mut meter = CapacityMeter::default();
        for ms in 0..3_000 {
            meter.record_write(Timestamp::from_millis(ms), 100, Backlog::Empty);
        }
        assert_eq!(capacity(&meter, 3_000), None);
    }

    #[test]
    fn what_is_taken_while_frames_wait_is_the_capacity() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 490, 100, 10);
        assert_eq!(capacity(&meter, 490), None, "too early to tell");
        run(&mut meter, 490, 500, 100, 10);
        assert_eq!(capacity(&meter, 500), Some(10_000.0));
    }

    #[test]
    fn short_pieces_of_waiting_are_joined_and_the_pauses_left_out() {
        let mut meter = CapacityMeter::default();
        for piece in 0..10 {
            let start = piece * 1_000;
            run(&mut meter, start, start + 40, 20, 10);
            meter.record_write(Timestamp::from_millis(start + 50), 20, Backlog::Empty);
            // Taken without waiting: no measure of anything.
            meter.record_write(Timestamp::from_millis(start + 500), 5_000, Backlog::Empty);
        }
        assert_eq!(capacity(&meter, 9_100), Some(2_000.0));
    }

    #[test]
    fn a_link_that_takes_lumps_is_measured_from_lump_to_lump() {
        let (mut joining, mut strict) =
            (CapacityMeter::with_longest_gap(COARSE_WRITE_GAP), CapacityMeter::with_longest_gap(TimeDelta::ZERO));
        // Every 100 ms there is room for 1000 bytes: 40 of them were waiting, the rest is given 20 ms later.
        for lump in 0..20 {
            for (ms, bytes, backlog) in [
                (0, 0, Backlog::Pending),
                (80, 40, Backlog::Empty),
                (90, 400, Backlog::Empty),
                (100, 560, Backlog::Pending),
            ] {
                let at = Timestamp::from_millis(100 * lump + ms);
                joining.record_write(at, bytes, backlog);
                strict.record_write(at, bytes, backlog);
            }
        }
        assert_eq!(capacity(&joining, 2_000), Some(10_000.0));
        assert_eq!(capacity(&strict, 2_000), Some(500.0));
    }

    #[test]
    fn a_link_that_becomes_slower_is_followed_within_seconds() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 2_500, 100, 10);
        assert_eq!(capacity(&meter, 2_500), Some(10_000.0));
        run(&mut meter, 2_500, 6_500, 10, 10);
        let slower = capacity(&meter, 6_500).expect("measured");
        assert!((1_000.0..1_700.0).contains(&slower), "{slower}");
    }

    #[test]
    fn a_link_that_takes_nothing_has_capacity_zero() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 600, 0, 100);
        assert_eq!(capacity(&meter, 600), Some(0.0));
    }

    #[test]
    fn a_measurement_is_forgotten_when_the_link_has_kept_up() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 1_000, 100, 10);
        meter.record_write(Timestamp::from_millis(1_010), 0, Backlog::Empty);
        assert!(capacity(&meter, 6_000).is_some());
        assert_eq!(capacity(&meter, 6_001), None);
    }

    #[test]
    fn time_that_runs_backwards_is_no_time() {
        let mut meter = CapacityMeter::default();
        meter.record_write(Timestamp::from_millis(1_000), 0, Backlog::Pending);
        meter.record_write(Timestamp::from_millis(400), 100, Backlog::Pending);
        meter.record_write(Timestamp::from_millis(1_500), 900, Backlog::Pending);
        assert_eq!(capacity(&meter, 1_500), Some(2_000.0));
    }
}

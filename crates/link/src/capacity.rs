//! What a link takes, in bytes per second, measured while frames wait for it.
//!
//! ```text
//! busy         time during which at least one frame waits, and the gaps between two such times that are short enough
//! sample       bytes taken while busy / busy, for each second of it
//! capacity     first sample, then capacity + (sample - capacity) / 2
//! ```
//!
//! A link on which nothing waits takes whatever it is given, which says nothing about what it could take; so only busy
//! time counts, and what is taken at the moment at which it begins does not. A system that takes its bytes in lumps empties
//! our queue with each of them and is full again a moment later; from one such moment to the next it has taken what it
//! has sent, so these gaps are part of the busy time. Halving the distance with each second follows a radio that fades
//! within a few seconds. It reads no clock.

use posebridge_telemetry::{HostClock, Span, Stamp};

/// Longest gap of a stream whose system takes bytes in lumps of unknown size: our TCP sockets take 1 KiB at a time, and a
/// 4000 byte/s link has sent that after this time.
pub(crate) const LUMPY_GAP: Span = Span::from_millis(250);
/// Waiting that makes the first sample.
const FIRST_WINDOW: Span = Span::from_millis(500);
/// Waiting that makes every later sample: as often as the station tells of its links.
const WINDOW: Span = Span::from_millis(1_000);
/// How long a measurement is told after the last frame waited: long enough to be seen, and short enough that whoever
/// sends less because of it tries again.
const KEPT_FOR: Span = Span::from_millis(5_000);

/// Whether a link keeps up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backlog {
    /// Everything that was given has been taken.
    Empty,
    /// At least one frame waits.
    Waiting,
}

/// The measurement of one peer or one link.
#[derive(Clone, Debug, Default)]
pub struct CapacityMeter {
    longest_gap: Span,
    /// The last look, while frames waited at it.
    waiting_since: Option<Stamp<HostClock>>,
    /// When the last frame that waited was taken, and what has been taken since.
    gap: Option<(Stamp<HostClock>, u64)>,
    last_waited: Option<Stamp<HostClock>>,
    /// Waiting and bytes of the sample that is being collected.
    waited: Span,
    taken_bytes: u64,
    bytes_per_s: Option<f64>,
}

impl CapacityMeter {
    /// A meter that counts gaps of up to `longest_gap` as busy.
    #[must_use]
    pub fn joining(longest_gap: Span) -> Self {
        Self { longest_gap, ..Self::default() }
    }

    /// Notes that the link has taken `taken_bytes` since the last note, and whether frames wait after that. A stamp
    /// before the last one adds bytes but no time.
    pub fn note(&mut self, now: Stamp<HostClock>, taken_bytes: usize, backlog: Backlog) {
        let taken_bytes = taken_bytes as u64;
        if let Some(since) = self.waiting_since {
            self.count((now - since).max(Span::ZERO), taken_bytes);
        } else if let Some((begun, bytes)) = self.gap {
            let bytes = bytes + taken_bytes;
            self.gap = Some((begun, bytes));
            if backlog == Backlog::Waiting && now - begun <= self.longest_gap {
                self.count((now - begun).max(Span::ZERO), bytes);
            }
        }
        match backlog {
            Backlog::Empty => {
                let ended = self.waiting_since.take().map(|since| since.max(now));
                let may_join = |gap: &(Stamp<HostClock>, u64)| now - gap.0 <= self.longest_gap;
                self.gap = ended.map(|at| (at, 0)).or(self.gap.filter(may_join));
            }
            Backlog::Waiting => {
                let latest = self.waiting_since.map_or(now, |since| since.max(now));
                self.gap = None;
                self.last_waited = Some(latest);
                self.waiting_since = Some(latest);
            }
        }
    }

    /// As [`Self::note`], for writers that are seldom behind: `now` is asked only where the note would change something.
    pub(crate) fn note_if_busy(
        &mut self,
        now: impl FnOnce() -> Stamp<HostClock>,
        taken_bytes: usize,
        backlog: Backlog,
    ) {
        if backlog == Backlog::Waiting || self.is_busy() {
            self.note(now(), taken_bytes, backlog);
        }
    }

    fn count(&mut self, span: Span, taken_bytes: u64) {
        self.waited += span;
        self.taken_bytes += taken_bytes;
        self.sample();
    }

    /// True if what the link takes is of interest: frames waited at the last note, or shortly before.
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.waiting_since.is_some() || self.gap.is_some()
    }

    fn sample(&mut self) {
        let window = if self.bytes_per_s.is_some() { WINDOW } else { FIRST_WINDOW };
        if self.waited < window {
            return;
        }
        let sample = self.taken_bytes as f64 / self.waited.as_secs_f64();
        self.bytes_per_s = Some(match self.bytes_per_s {
            Some(before) => before + (sample - before) / 2.0,
            None => sample,
        });
        self.waited = Span::ZERO;
        self.taken_bytes = 0;
    }

    /// What the link takes, bytes per second; `None` until it has been measured, and when the link has kept up for five
    /// seconds.
    #[must_use]
    pub fn bytes_per_s(&self, now: Stamp<HostClock>) -> Option<f64> {
        let last_waited = self.last_waited?;
        let is_recent = self.waiting_since.is_some() || now - last_waited <= KEPT_FOR;
        self.bytes_per_s.filter(|_| is_recent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link that takes `bytes` every `period_ms` while frames wait.
    fn run(meter: &mut CapacityMeter, from_ms: i64, to_ms: i64, (bytes, period_ms): (usize, i64)) {
        let mut at = from_ms;
        while at <= to_ms {
            let taken = if at == from_ms { 0 } else { bytes };
            meter.note(Stamp::from_millis(at), taken, Backlog::Waiting);
            at += period_ms;
        }
    }

    fn capacity(meter: &CapacityMeter, ms: i64) -> Option<f64> {
        meter.bytes_per_s(Stamp::from_millis(ms))
    }

    #[test]
    fn a_link_that_keeps_up_has_no_capacity() {
        let mut meter = CapacityMeter::default();
        for ms in 0..3_000 {
            meter.note(Stamp::from_millis(ms), 100, Backlog::Empty);
        }
        assert_eq!(capacity(&meter, 3_000), None);
    }

    #[test]
    fn what_is_taken_while_frames_wait_is_the_capacity() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 490, (100, 10));
        assert_eq!(capacity(&meter, 490), None, "too early to tell");
        run(&mut meter, 490, 500, (100, 10));
        assert_eq!(capacity(&meter, 500), Some(10_000.0));
    }

    #[test]
    fn short_pieces_of_waiting_are_joined_and_the_pauses_left_out() {
        let mut meter = CapacityMeter::default();
        for piece in 0..10 {
            let start = piece * 1_000;
            run(&mut meter, start, start + 40, (20, 10));
            meter.note(Stamp::from_millis(start + 50), 20, Backlog::Empty);
            // Taken without waiting: no measure of anything.
            meter.note(Stamp::from_millis(start + 500), 5_000, Backlog::Empty);
        }
        assert_eq!(capacity(&meter, 9_100), Some(2_000.0));
    }

    #[test]
    fn a_link_that_takes_lumps_is_measured_from_lump_to_lump() {
        let (mut joining, mut strict) = (CapacityMeter::joining(LUMPY_GAP), CapacityMeter::joining(Span::ZERO));
        // Every 100 ms there is room for 1000 bytes: 40 of them were waiting, the rest is given 20 ms later.
        for lump in 0..20 {
            for (ms, bytes, backlog) in [
                (0, 0, Backlog::Waiting),
                (80, 40, Backlog::Empty),
                (90, 400, Backlog::Empty),
                (100, 560, Backlog::Waiting),
            ] {
                let at = Stamp::from_millis(100 * lump + ms);
                joining.note(at, bytes, backlog);
                strict.note(at, bytes, backlog);
            }
        }
        assert_eq!(capacity(&joining, 2_000), Some(10_000.0));
        assert_eq!(capacity(&strict, 2_000), Some(500.0));
    }

    #[test]
    fn a_link_that_becomes_slower_is_followed_within_seconds() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 2_500, (100, 10));
        assert_eq!(capacity(&meter, 2_500), Some(10_000.0));
        run(&mut meter, 2_500, 6_500, (10, 10));
        let slower = capacity(&meter, 6_500).expect("measured");
        assert!((1_000.0..1_700.0).contains(&slower), "{slower}");
    }

    #[test]
    fn a_link_that_takes_nothing_has_capacity_zero() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 600, (0, 100));
        assert_eq!(capacity(&meter, 600), Some(0.0));
    }

    #[test]
    fn a_measurement_is_forgotten_when_the_link_has_kept_up() {
        let mut meter = CapacityMeter::default();
        run(&mut meter, 0, 1_000, (100, 10));
        meter.note(Stamp::from_millis(1_010), 0, Backlog::Empty);
        assert!(capacity(&meter, 6_000).is_some());
        assert_eq!(capacity(&meter, 6_001), None);
    }

    #[test]
    fn time_that_runs_backwards_is_no_time() {
        let mut meter = CapacityMeter::default();
        meter.note(Stamp::from_millis(1_000), 0, Backlog::Waiting);
        meter.note(Stamp::from_millis(400), 100, Backlog::Waiting);
        meter.note(Stamp::from_millis(1_500), 900, Backlog::Waiting);
        assert_eq!(capacity(&meter, 1_500), Some(2_000.0));
    }
}

//! The stages of one direction: line, delay and slots; the random draws of a unit; and the two-state processes of a link.
//!
//! # Model
//! ```text
//! line      P     the instant up to which the line is busy               R bytes per second     B bytes of burst
//!           P' = max(P, now - B / R) + n / R        n bytes have left at max(now, P')        (a token bucket of depth B)
//!           waiting = max(0, P - now) R             what does not fit into the buffer is dropped, the newest first
//! delay     base + Exp(jitter mean) + sum over the kinds of stall: U(from, to) with probability p
//!           arrival = max(departure + delay, arrival of the unit before)        order is kept
//! slots     t' = phase + ceil((t - phase) / period) period        phase ~ U(0, period), drawn once
//! errors    bits, bytes until the next error ~ Geometric(bit error rate), until the next one is missing ~ Geometric(byte loss)
//! datagrams held back by U(from, to) with probability p, those behind do not wait; a copy right behind it with probability q
//! bursts    good -> bad after Exp(mean_good), bad -> good after Exp(mean_bad), lost with probability loss_good or loss_bad
//!           share of loss = (mean_good loss_good + mean_bad loss_bad) / (mean_good + mean_bad)
//! outages   up for Exp(mean_up), down for U(down_from, down_to)
//! ```
//! A stream departs in chunks, so that its first bytes do not wait for its last, but has one delay for each unit. The states change with
//! time, so that the length of a burst does not depend on the traffic. Every stage draws for every offered unit and byte before its outcome
//! is known, lost ones too: two links of one seed that differ in one stage differ only in the effect of that stage.
//!
//! # Sources
//! The token bucket: ITU-T Recommendation I.371, annex A (generic cell rate algorithm, virtual scheduling). The delays: docs/impairment.md,
//! section 2; the shape of the jitter is our choice. Bursts: Gilbert, Capacity of a Burst-Noise Channel, Bell System Technical Journal 39
//! (1960); Elliott, Estimates of Error Rates for Codes on Burst-Noise Channels, the same 42 (1963), in continuous time.

use std::ops::Range;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::profile::{BurstLoss, DirectionProfile, Disconnects, LinkKind, RandomDelay, Rate};
use crate::random::RandomStream;

/// Largest chunk of a stream: the receive FIFO of a 16550 UART.
const CHUNK_BYTES: usize = 16;

/// Bound of the accumulated rounding of half a nanosecond per chunk, in bytes, at any rate of a radio or serial line.
const ROUNDING_BYTES: f64 = 1e-3;

/// A part of a unit and the departure of its last byte.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SentRange {
    pub(super) bytes: Range<usize>,
    pub(super) at: Timestamp<HostClock>,
}

/// A line with a token bucket; without settings infinitely fast.
#[derive(Clone, Debug)]
pub(super) struct RateLimiter {
    rate: Option<Rate>,
    kind: LinkKind,
    busy_until: Timestamp<HostClock>,
}

impl RateLimiter {
    pub(super) const fn new(rate: Option<Rate>, kind: LinkKind) -> Self {
        Self { rate, kind, busy_until: Timestamp::from_nanos(i64::MIN / 2) }
    }

    /// Drops what is queued; the line is free.
    pub(super) fn clear(&mut self, now: Timestamp<HostClock>) {
        self.busy_until = self.busy_until.min(now);
    }

    /// Sends a unit of this length. Returns the parts that depart, in order; bytes missing at the end found the buffer full.
    pub(super) fn send(&mut self, now: Timestamp<HostClock>, length: usize) -> Vec<SentRange> {
        let Some(rate) = self.rate else {
            return vec![SentRange { bytes: 0..length, at: now }];
        };
        let fits = self.free_bytes(now, rate, length);
        let most = match self.kind {
            LinkKind::Stream => CHUNK_BYTES,
            LinkKind::Datagram => length.max(1),
        };
        let burst = transmit_time(rate, f64::from(rate.burst_bytes));
        (0..fits)
            .step_by(most)
            .map(|start| {
                let bytes = start..fits.min(start + most);
                let free = self.busy_until.max(now - burst);
                self.busy_until = free + transmit_time(rate, bytes.len() as f64);
                SentRange { bytes, at: self.busy_until.max(now) }
            })
            .collect()
    }

    fn free_bytes(&self, now: Timestamp<HostClock>, rate: Rate, length: usize) -> usize {
        let waiting = (self.busy_until - now).as_secs_f64().max(0.0) * rate.bytes_per_s;
        // A byte that has begun to leave still waits; stamps of whole nanoseconds must not make a byte more of a whole number.
        let occupied = (waiting - ROUNDING_BYTES).ceil().max(0.0);
        let capacity = (f64::from(rate.buffer_bytes) - occupied).max(0.0) as usize;
        match self.kind {
            LinkKind::Stream => length.min(capacity),
            LinkKind::Datagram if length <= capacity => length,
            LinkKind::Datagram => 0,
        }
    }
}

fn transmit_time(rate: Rate, bytes: f64) -> TimeDelta {
    TimeDelta::from_secs_f64(bytes / rate.bytes_per_s)
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Slots {
    period: TimeDelta,
    phase: TimeDelta,
}

impl Slots {
    pub(super) fn new(period_ms: f64, mut stream: RandomStream) -> Self {
        let period = millis(period_ms);
        Self { period, phase: uniform(&mut stream, TimeDelta::ZERO, period) }
    }

    pub(super) fn next(self, at: Timestamp<HostClock>) -> Timestamp<HostClock> {
        let period = self.period.as_nanos().max(1);
        let past = (at - self.phase).as_nanos().rem_euclid(period);
        if past == 0 { at } else { at + TimeDelta::from_nanos(period - past) }
    }
}

/// `-mean ln(1 - u)`.
pub(super) fn exponential(stream: &mut RandomStream, mean: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(-mean.as_secs_f64() * (1.0 - stream.uniform(0.0, 1.0)).ln())
}

pub(super) fn uniform(stream: &mut RandomStream, from: TimeDelta, to: TimeDelta) -> TimeDelta {
    TimeDelta::from_secs_f64(stream.uniform(from.as_secs_f64(), to.as_secs_f64()))
}

pub(super) fn millis(milliseconds: f64) -> TimeDelta {
    TimeDelta::from_secs_f64(milliseconds * 1e-3)
}

/// The random draws of one unit, made before its outcome is known.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct UnitDraw {
    pub(super) is_lost: bool,
    /// Uniform on [0, 1): one per datagram, or one per byte of a stream. Empty on a link without burst loss.
    pub(super) burst_draws: Vec<f64>,
    pub(super) missing_bytes: Vec<u64>,
    /// Eight times the byte index plus the bit index.
    pub(super) flipped_bits: Vec<u64>,
    pub(super) held_back: Option<TimeDelta>,
    pub(super) is_duplicated: bool,
    /// Stalls included.
    pub(super) delay: TimeDelta,
    pub(super) stalled: TimeDelta,
}

/// Random streams of the stages whose probabilities do not depend on time.
#[derive(Clone, Debug)]
pub(super) struct UnitDraws {
    kind: LinkKind,
    profile: DirectionProfile,
    losing: RandomStream,
    bursts: RandomStream,
    missing_bytes: ErrorGaps,
    bit_errors: ErrorGaps,
    reordering: RandomStream,
    duplicating: RandomStream,
    jitter: RandomStream,
    stalling: RandomStream,
}

impl UnitDraws {
    pub(super) fn new(profile: &DirectionProfile, kind: LinkKind, stream: impl Fn(&str) -> RandomStream) -> Self {
        Self {
            kind,
            profile: profile.clone(),
            losing: stream("loss"),
            bursts: stream("burst loss"),
            missing_bytes: ErrorGaps::new(profile.byte_loss, stream("byte loss")),
            bit_errors: ErrorGaps::new(profile.bit_error_rate, stream("bit errors")),
            reordering: stream("reorder"),
            duplicating: stream("duplicate"),
            jitter: stream("jitter"),
            stalling: stream("stalls"),
        }
    }

    pub(super) fn draw(&mut self, bytes: usize) -> UnitDraw {
        let profile = &self.profile;
        let is_datagram = self.kind == LinkKind::Datagram;
        let trials = if is_datagram { 1 } else { bytes };
        let burst_draws = match profile.burst_loss {
            Some(_) => (0..trials).map(|_| self.bursts.uniform(0.0, 1.0)).collect(),
            None => Vec::new(),
        };
        let reorder = profile.reorder.filter(|_| is_datagram);
        let stalls = profile.stalls.iter().filter_map(|stall| stall.draw(&mut self.stalling));
        let stalled = stalls.fold(TimeDelta::ZERO, |sum, stall| sum + stall);
        let jitter = exponential(&mut self.jitter, millis(profile.delay.jitter_mean_ms));
        UnitDraw {
            is_lost: self.losing.bernoulli(profile.loss),
            burst_draws,
            missing_bytes: self.missing_bytes.hits(bytes as u64),
            flipped_bits: self.bit_errors.hits(8 * bytes as u64),
            held_back: reorder.and_then(|reorder| reorder.draw(&mut self.reordering)),
            is_duplicated: is_datagram && self.duplicating.bernoulli(profile.duplicate),
            delay: millis(profile.delay.base_ms) + jitter + stalled,
            stalled,
        }
    }
}

impl RandomDelay {
    /// Always takes both draws, so that a changed probability shifts nothing else.
    fn draw(&self, stream: &mut RandomStream) -> Option<TimeDelta> {
        let happens = stream.bernoulli(self.probability);
        let length = uniform(stream, millis(self.from_ms), millis(self.to_ms));
        happens.then_some(length)
    }
}

/// Independent events at a rate, drawn as the gaps between them: a rate of 1e-6 costs almost nothing.
#[derive(Clone, Debug)]
struct ErrorGaps {
    probability: f64,
    /// Trials before the next event; drawn at the first trial.
    until_next: Option<u64>,
    stream: RandomStream,
}

impl ErrorGaps {
    const fn new(probability: f64, stream: RandomStream) -> Self {
        Self { probability, until_next: None, stream }
    }

    /// Indices of the events among the next `trials`, in order.
    fn hits(&mut self, trials: u64) -> Vec<u64> {
        let mut hits = Vec::new();
        if self.probability <= 0.0 {
            return hits;
        }
        let mut until_next = match self.until_next {
            Some(until_next) => until_next,
            None => failures_before_success(&mut self.stream, self.probability),
        };
        let mut passed = 0;
        while until_next < trials - passed {
            passed += until_next;
            hits.push(passed);
            passed += 1;
            until_next = failures_before_success(&mut self.stream, self.probability);
        }
        self.until_next = Some(until_next - (trials - passed));
        hits
    }
}

/// Geometric draw: `floor(ln(1 - u) / ln(1 - p))`, p above 0.
fn failures_before_success(stream: &mut RandomStream, probability: f64) -> u64 {
    // ln_1p keeps the digits of rare errors; a certain success divides by minus infinity and gives 0.
    ((-stream.uniform(0.0, 1.0)).ln_1p() / (-probability).ln_1p()) as u64
}

#[derive(Clone, Debug)]
pub(super) struct GilbertElliott {
    settings: BurstLoss,
    is_bad: bool,
    /// `None` before the first unit.
    changes_at: Option<Timestamp<HostClock>>,
    states: RandomStream,
}

impl GilbertElliott {
    /// Draws the first state from the stationary distribution.
    pub(super) fn new(settings: BurstLoss, mut states: RandomStream) -> Self {
        let share_bad = settings.mean_bad_s / (settings.mean_good_s + settings.mean_bad_s);
        Self { is_bad: states.bernoulli(share_bad), settings, changes_at: None, states }
    }

    /// Whether a unit that departs at `at` is lost, given a uniform draw on [0, 1). The instants must not decrease.
    pub(super) fn is_lost(&mut self, at: Timestamp<HostClock>, draw: f64) -> bool {
        self.advance_to(at);
        let loss = if self.is_bad { self.settings.loss_bad } else { self.settings.loss_good };
        draw < loss
    }

    /// Advances the state. The first call starts the first state, so it must come with the first unit, whatever its outcome.
    pub(super) fn advance_to(&mut self, at: Timestamp<HostClock>) {
        // A memoryless state may be looked at first at any instant.
        let mut changes_at = match self.changes_at {
            Some(changes_at) => changes_at,
            None => at + self.draw_dwell_time(),
        };
        while changes_at <= at {
            self.is_bad = !self.is_bad;
            changes_at = changes_at + self.draw_dwell_time();
        }
        self.changes_at = Some(changes_at);
    }

    fn draw_dwell_time(&mut self) -> TimeDelta {
        let mean_s = if self.is_bad { self.settings.mean_bad_s } else { self.settings.mean_good_s };
        exponential(&mut self.states, TimeDelta::from_secs_f64(mean_s)).max(TimeDelta::from_nanos(1))
    }
}

/// When both directions go down and up.
#[derive(Clone, Debug)]
pub(super) struct Outages {
    settings: Disconnects,
    stream: RandomStream,
    is_up: bool,
    pub(super) changes_at: Timestamp<HostClock>,
}

impl Outages {
    pub(super) fn new(settings: Disconnects, stream: RandomStream, now: Timestamp<HostClock>) -> Self {
        let mut outages = Self { settings, stream, is_up: true, changes_at: now };
        outages.changes_at = now + outages.draw_duration();
        outages
    }

    /// Advances to the next change and returns whether the link is up from there on.
    pub(super) fn toggle(&mut self) -> bool {
        self.is_up = !self.is_up;
        self.changes_at = self.changes_at + self.draw_duration();
        self.is_up
    }

    fn draw_duration(&mut self) -> TimeDelta {
        let Disconnects { mean_up_s, down_from_s, down_to_s } = self.settings;
        let stay = if self.is_up {
            exponential(&mut self.stream, TimeDelta::from_secs_f64(mean_up_s))
        } else {
            uniform(&mut self.stream, TimeDelta::from_secs_f64(down_from_s), TimeDelta::from_secs_f64(down_to_s))
        };
        stay.max(TimeDelta::from_nanos(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SLOW: Rate = Rate { bytes_per_s: 1_000.0, buffer_bytes: 100, burst_bytes: 0 };

    fn ms(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn a_stream_trickles_and_loses_its_tail() {
        let mut line = RateLimiter::new(Some(SLOW), LinkKind::Stream);
        let sent = line.send(ms(0), 130);
        assert_eq!(sent.len(), 7);
        assert_eq!(sent[0], SentRange { bytes: 0..16, at: ms(16) });
        assert_eq!(sent[6], SentRange { bytes: 96..100, at: ms(100) });
        assert_eq!(line.send(ms(50), 80).last().unwrap().at, ms(150));
    }

    #[test]
    fn a_datagram_waits_whole_or_is_dropped_whole_and_a_rested_line_passes_its_burst_at_once() {
        // Offered when, how many bytes, sent when. After 60 of 50 tokens were spent, the bucket holds 20 at 30 ms.
        let no_burst = [(0, 60, Some(60)), (0, 41, None), (0, 40, Some(100)), (1_000, 101, None)];
        let burst = [(0, 50, Some(0)), (0, 10, Some(10)), (30, 25, Some(35))];
        for (burst_bytes, cases) in [(0, &no_burst[..]), (50, &burst[..])] {
            let mut line = RateLimiter::new(Some(Rate { burst_bytes, ..SLOW }), LinkKind::Datagram);
            for (at, length, sent_at) in cases {
                let expected = sent_at.map(|sent_at| SentRange { bytes: 0..*length, at: ms(sent_at) });
                assert_eq!(line.send(ms(*at), *length), Vec::from_iter(expected), "{length} bytes at {at} ms");
            }
        }
    }

    #[test]
    fn how_the_trials_are_counted_does_not_change_the_hits() {
        for (probability, hits) in [(0.0, 0), (0.2, 195), (1.0, 1_000)] {
            let gaps = || ErrorGaps::new(probability, RandomStream::new(4, "gaps"));
            let whole = gaps().hits(1_000);
            let mut parts = gaps();
            let mut found = Vec::new();
            let mut start = 0;
            for size in [1, 7, 0, 92, 400, 500] {
                found.extend(parts.hits(size).into_iter().map(|hit| hit + start));
                start += size;
            }
            assert_eq!(found, whole);
            assert!(whole.len().abs_diff(hits) < 50, "{} of {hits}", whole.len());
        }
    }
}

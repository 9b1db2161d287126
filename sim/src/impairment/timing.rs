//! Departure and arrival times of a unit: the line's rate and buffer, delay and stalls, delivery slots.
//!
//! # Model
//! ```text
//! line      P     the instant up to which the line is busy               R bytes per second     B bytes of burst
//!           P' = max(P, now - B / R) + n / R        n bytes have left at max(now, P')        (a token bucket of depth B)
//!           waiting = max(0, P - now) R             what does not fit into the buffer is dropped, the newest first
//! delay     base + Exp(jitter mean) + sum over the kinds of stall: U(from, to) with probability p
//!           arrival = max(departure + delay, arrival of the unit before)        order is kept
//! slots     t' = phase + ceil((t - phase) / period) period        phase ~ U(0, period), drawn once
//! ```
//! A stream departs in chunks, so that its first bytes do not wait for its last. One delay is drawn for each unit, so that a write that
//! the line splits stays together. A lost unit delays the others as if it were not lost, so that a loss changes no other arrival. A
//! radio's connection interval and a USB adapter's latency timer work like the slots.
//!
//! # Sources
//! The virtual scheduling form of the token bucket: ITU-T Recommendation I.371, annex A (generic cell rate algorithm). The
//! delays: docs/impairment.md, section 2; the shape of the jitter is our choice.

use std::ops::Range;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::profile::{DirectionProfile, LinkKind, Rate, Stall};
use super::unit_draws::{exponential, millis, uniform};
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

    /// How many of `length` bytes fit into the buffer.
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DelayDraw {
    pub(super) delay: TimeDelta,
    pub(super) stalled: TimeDelta,
}

#[derive(Clone, Debug)]
pub(super) struct Delays {
    base: TimeDelta,
    jitter_mean: TimeDelta,
    stalls: Vec<Stall>,
    jitter: RandomStream,
    stalling: RandomStream,
    last_arrival: Timestamp<HostClock>,
}

impl Delays {
    pub(super) fn new(profile: &DirectionProfile, jitter: RandomStream, stalling: RandomStream) -> Self {
        Self {
            base: millis(profile.delay.base_ms),
            jitter_mean: millis(profile.delay.jitter_mean_ms),
            stalls: profile.stalls.clone(),
            jitter,
            stalling,
            last_arrival: Timestamp::from_nanos(i64::MIN),
        }
    }

    pub(super) fn draw(&mut self) -> DelayDraw {
        let mut stalled = TimeDelta::ZERO;
        for stall in &self.stalls {
            // Both draws are always taken, so that a changed probability shifts nothing else.
            let happens = self.stalling.bernoulli(stall.probability);
            let length = uniform(&mut self.stalling, millis(stall.from_ms), millis(stall.to_ms));
            if happens {
                stalled += length;
            }
        }
        let jitter = exponential(&mut self.jitter, self.jitter_mean);
        DelayDraw { delay: self.base + jitter + stalled, stalled }
    }

    /// Arrival of a unit that does not overtake.
    pub(super) fn arrival(&mut self, sent: Timestamp<HostClock>, delay: TimeDelta) -> Timestamp<HostClock> {
        self.last_arrival = self.last_arrival.max(sent + delay);
        self.last_arrival
    }

    pub(super) fn clear(&mut self, now: Timestamp<HostClock>) {
        self.last_arrival = self.last_arrival.min(now);
    }
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
}

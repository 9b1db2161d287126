//! The line: bytes leave one after the other, and the number that may wait is limited.
//!
//! # Model
//! ```text
//! P     the instant up to which the line's time is sold        R bytes per second     B bytes of burst
//! P' = max(P, now - B / R) + n / R        n bytes have left at max(now, P')        (a token bucket of depth B)
//! waiting = max(0, P - now) R             what does not fit into the buffer is dropped, the newest first
//! ```
//! A stream is sold in pieces, so that its first bytes do not wait for its last.
//!
//! # Sources
//! The virtual scheduling form of the token bucket: ITU-T Recommendation I.371, annex A (generic cell rate algorithm).

use std::ops::Range;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::settings::{LinkKind, Rate};

/// Most bytes that leave a stream's line as one: what the receive FIFO of a 16550 UART holds.
const CHUNK_BYTES: usize = 16;

/// What half a nanosecond per piece can add up to, in bytes, at any rate of a radio or serial line.
const ROUNDING_BYTES: f64 = 1e-3;

/// A piece of a unit and when its last byte has left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct SentRange {
    /// Which of the unit's bytes.
    pub(super) bytes: Range<usize>,
    /// When the last of them has left.
    pub(super) at: Timestamp<HostClock>,
}

/// A line; without settings it is infinitely fast.
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

    /// What waited is gone and the line is free.
    pub(super) fn clear(&mut self, now: Timestamp<HostClock>) {
        self.busy_until = self.busy_until.min(now);
    }

    /// Sends a unit of this length: the pieces that leave, in their order. What is missing at the end found the buffer full.
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

    /// How many of the bytes find room.
    fn free_bytes(&self, now: Timestamp<HostClock>, rate: Rate, length: usize) -> usize {
        let waiting = (self.busy_until - now).as_secs_f64().max(0.0) * rate.bytes_per_s;
        // A byte that has begun to leave still waits; stamps of whole nanoseconds must not make a byte more of a whole number.
        let occupied = (waiting - ROUNDING_BYTES).ceil().max(0.0);
        let room = (f64::from(rate.buffer_bytes) - occupied).max(0.0) as usize;
        match self.kind {
            LinkKind::Stream => length.min(room),
            LinkKind::Datagram if length <= room => length,
            LinkKind::Datagram => 0,
        }
    }
}

fn transmit_time(rate: Rate, bytes: f64) -> TimeDelta {
    TimeDelta::from_secs_f64(bytes / rate.bytes_per_s)
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
    fn a_datagram_waits_whole_or_is_dropped_whole() {
        let mut line = RateLimiter::new(Some(SLOW), LinkKind::Datagram);
        assert_eq!(line.send(ms(0), 60), [SentRange { bytes: 0..60, at: ms(60) }]);
        assert!(line.send(ms(0), 41).is_empty());
        assert_eq!(line.send(ms(0), 40), [SentRange { bytes: 0..40, at: ms(100) }]);
        assert!(line.send(ms(1_000), 101).is_empty(), "larger than the buffer");
    }

    #[test]
    fn a_rested_line_passes_its_burst_at_once() {
        let rate = Rate { burst_bytes: 50, ..SLOW };
        let mut line = RateLimiter::new(Some(rate), LinkKind::Datagram);
        assert_eq!(line.send(ms(0), 50)[0].at, ms(0));
        assert_eq!(line.send(ms(0), 10)[0].at, ms(10));
        // 60 tokens were spent of 50; 30 ms later the bucket holds 20.
        assert_eq!(line.send(ms(30), 25)[0].at, ms(35));
    }
}

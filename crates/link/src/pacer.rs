//! The `rate` option: a limit in bytes per second for any transport.
//!
//! It is for radios that share the air, and for lines whose buffers cannot be queried (a pseudo-terminal, a modem
//! behind a fast cable). Frames wait in front of the connection by priority, and a new estimate replaces an older one.
//! Sent bytes are counted once for each peer; dropped frames are counted once, because the recipients are known only
//! when a frame is sent. Received bytes are not limited.
//!
//! The limit is a token bucket, which lets single frames pass at once.
//!
//! ```text
//! level' = min(burst, level + rate * dt)      level' = level - bytes, when a frame passes
//! ```
//!
//! The bucket may go into debt: a frame passes completely when the level is not negative, and may take it below zero; the
//! next one waits until the debt is paid. So over any time `t` at most `rate * t + burst + one frame` pass, whatever
//! the size of the frames.

use std::pin::Pin;
use std::task::Context;

use posebridge_telemetry::{HostClock, Recipients, TimeDelta, Timestamp};
use tokio::time::Sleep;

use crate::capacity::CapacityMeter;
use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::transports::QUEUE_BYTES;

pub(crate) struct Pacer {
    timer: HostTimer,
    bucket: TokenBucket,
    queue: SendQueue<Recipients>,
    meter: CapacityMeter,
    wake: Option<Pin<Box<Sleep>>>,
}

impl Pacer {
    pub(crate) fn new(bytes_per_s: u32, timer: HostTimer) -> Self {
        Self {
            timer,
            bucket: TokenBucket::new(bytes_per_s, timer.now()),
            queue: SendQueue::new(QUEUE_BYTES),
            meter: CapacityMeter::default(),
            wake: None,
        }
    }

    pub(crate) fn send(
        &mut self,
        out: &OutgoingFrame<'_>,
        connection: &mut dyn Connection,
        counters: &mut LinkCounters,
    ) {
        let now = self.timer.now();
        if self.queue.is_empty() && self.bucket.time_until_ready(now) == TimeDelta::ZERO {
            self.bucket.consume(transmit_cost(out, connection));
            connection.send(out, counters);
            return;
        }
        if connection.count_recipients(out.to) > 0 {
            counters.drops_out += self.queue.push(out.to, out.priority, out.frame);
        }
        self.meter.record_write(now, 0, self.queue.backlog());
    }

    /// Sends the queued frames that the limit allows; registers the waker for the rest.
    pub(crate) fn poll(&mut self, cx: &mut Context<'_>, connection: &mut dyn Connection, counters: &mut LinkCounters) {
        while let Some((to, priority, frame)) = self.queue.head_unstarted() {
            if let Some(wake) = &mut self.wake {
                if wake.as_mut().poll(cx).is_pending() {
                    return;
                }
                self.wake = None;
            }
            let now = self.timer.now();
            let wait = self.bucket.time_until_ready(now);
            if wait > TimeDelta::ZERO {
                let at = self.timer.instant(now + wait);
                self.wake = Some(Box::pin(tokio::time::sleep_until(at)));
                continue;
            }
            let out = OutgoingFrame { to: *to, priority, frame };
            let bytes = transmit_cost(&out, connection);
            connection.send(&out, counters);
            self.bucket.consume(bytes);
            self.queue.pop_head();
            self.meter.record_write(now, bytes, self.queue.backlog());
        }
    }

    /// The queues of the pacer and the connection. The capacity is the smaller of the limit, which counts all peers, and the
    /// connection's own, which may be that of its fastest peer.
    pub(crate) fn queue_status(&self, below: QueueStatus, now: Timestamp<HostClock>) -> QueueStatus {
        let here = self.meter.bytes_per_s(now);
        let capacity_bytes_per_s = match (here, below.capacity_bytes_per_s) {
            (Some(here), Some(below)) => Some(here.min(below)),
            (here, below) => here.or(below),
        };
        QueueStatus {
            peers: below.peers,
            frames: below.frames + self.queue.len() as u64,
            bytes: below.bytes + self.queue.bytes() as u64,
            capacity_bytes_per_s,
        }
    }
}

fn transmit_cost(out: &OutgoingFrame<'_>, connection: &dyn Connection) -> usize {
    out.frame.len() * connection.count_recipients(out.to) as usize
}

/// The burst after a pause, as a duration at the limit: one period of a display with 20 updates per second.
const BURST: TimeDelta = TimeDelta::from_millis(50);

#[derive(Clone, Debug)]
pub(crate) struct TokenBucket {
    bytes_per_s: f64,
    burst_bytes: f64,
    /// Bytes that may pass; a debt if negative.
    level_bytes: f64,
    filled_at: Timestamp<HostClock>,
}

impl TokenBucket {
    /// A full bucket that lets `bytes_per_s` pass, at least one.
    pub(crate) fn new(bytes_per_s: u32, now: Timestamp<HostClock>) -> Self {
        let bytes_per_s = f64::from(bytes_per_s.max(1));
        let burst_bytes = bytes_per_s * BURST.as_secs_f64();
        Self { bytes_per_s, burst_bytes, level_bytes: burst_bytes, filled_at: now }
    }

    /// Time until the next frame may pass; zero if it may at once. A timestamp before the last one adds nothing.
    pub(crate) fn time_until_ready(&mut self, now: Timestamp<HostClock>) -> TimeDelta {
        if now > self.filled_at {
            let filled = self.bytes_per_s * (now - self.filled_at).as_secs_f64();
            self.level_bytes = (self.level_bytes + filled).min(self.burst_bytes);
            self.filled_at = now;
        }
        if self.level_bytes >= 0.0 {
            return TimeDelta::ZERO;
        }
        // One nanosecond more than computed, so that rounding cannot make a waiter wake a moment too early for ever.
        TimeDelta::from_secs_f64(-self.level_bytes / self.bytes_per_s) + TimeDelta::from_nanos(1)
    }

    pub(crate) fn consume(&mut self, bytes: usize) {
        self.level_bytes -= bytes as f64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Offers a frame whenever the bucket lets one pass and returns the stamps, in nanoseconds.
    fn passes(rate: u32, frame: usize, until_ms: i64) -> Vec<i64> {
        let mut bucket = TokenBucket::new(rate, Timestamp::ZERO);
        let mut now = Timestamp::ZERO;
        let mut stamps = Vec::new();
        while now < Timestamp::from_millis(until_ms) {
            let wait = bucket.time_until_ready(now);
            if wait == TimeDelta::ZERO {
                bucket.consume(frame);
                stamps.push(now.as_nanos());
            } else {
                now = now + wait;
            }
        }
        stamps
    }

    #[test]
    fn the_rate_is_kept_over_every_interval() {
        for (rate, frame) in [(5_760, 64), (100, 280), (1_000_000, 20), (1, 300)] {
            let stamps = passes(rate, frame, 20_000);
            for first in 0..stamps.len() {
                let last = (first + 400).min(stamps.len() - 1);
                let secs = (stamps[last] - stamps[first]) as f64 / 1e9;
                let passed = ((last - first + 1) * frame) as f64;
                let allowed = f64::from(rate) * (secs + BURST.as_secs_f64()) + frame as f64;
                assert!(passed <= allowed + 1e-3, "{passed} of {allowed} at {rate}");
            }
        }
    }

    #[test]
    fn a_pause_saves_up_no_more_than_the_burst() {
        let mut bucket = TokenBucket::new(1_000, Timestamp::ZERO);
        let later = Timestamp::from_millis(3_600_000);
        let mut passed = 0;
        while bucket.time_until_ready(later) == TimeDelta::ZERO {
            bucket.consume(10);
            passed += 10;
        }
        assert_eq!(passed, 60, "50 ms at 1000 bytes/s, and the frame that makes the debt");
    }

    #[test]
    fn time_that_runs_backwards_fills_nothing() {
        let mut bucket = TokenBucket::new(1_000, Timestamp::from_millis(1_000));
        bucket.consume(150);
        let wait = bucket.time_until_ready(Timestamp::from_millis(1_000));
        assert_eq!(bucket.time_until_ready(Timestamp::ZERO), wait);
        assert!((wait.as_secs_f64() - 0.1).abs() < 1e-6, "{wait:?}");
        assert_eq!(bucket.time_until_ready(Timestamp::from_millis(1_101)), TimeDelta::ZERO);
    }
}

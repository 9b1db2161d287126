//! The `rate` option: a limit in bytes per second for any transport.
//!
//! It is for radios that share the air, and for lines whose buffers cannot be queried (a pseudo-terminal, a modem
//! behind a fast cable). Frames wait in front of the connection by priority, and a new estimate replaces an older one.
//! Sent bytes are counted once for each peer; dropped frames are counted once, because the recipients are known only
//! when a frame is sent. Received bytes are not limited.

use std::pin::Pin;
use std::task::Context;

use posebridge_telemetry::{HostClock, Recipients, TimeDelta, Timestamp};
use tokio::time::Sleep;

use crate::capacity::CapacityMeter;
use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::token_bucket::TokenBucket;
use crate::transports::QUEUE_BYTES;

/// The frames that wait for the rate limit.
pub(crate) struct Pacer {
    timer: HostTimer,
    bucket: TokenBucket,
    queue: SendQueue<Recipients>,
    meter: CapacityMeter,
    wake: Option<Pin<Box<Sleep>>>,
}

impl Pacer {
    /// A limit of `bytes_per_s`.
    pub(crate) fn new(bytes_per_s: u32, timer: HostTimer) -> Self {
        Self {
            timer,
            bucket: TokenBucket::new(bytes_per_s, timer.now()),
            queue: SendQueue::new(QUEUE_BYTES),
            meter: CapacityMeter::default(),
            wake: None,
        }
    }

    /// Sends a frame, or queues it.
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

/// The cost of a frame, in bytes of the limit.
fn transmit_cost(out: &OutgoingFrame<'_>, connection: &dyn Connection) -> usize {
    out.frame.len() * connection.count_recipients(out.to) as usize
}

//! The `rate` option: no more bytes per second than somebody has allowed, whatever the transport.
//!
//! For radios that share the air, and for lines whose own buffers cannot be asked (a pseudo-terminal, a modem behind a
//! fast cable). Frames wait in front of the connection, where the worthiest goes first and the newest estimate replaces
//! the one before it. Bytes are counted once per peer that hears them, frames that are dropped here once in all: who would
//! have heard them is known when they leave, not while they wait. It limits only what goes out.

use std::pin::Pin;
use std::task::Context;

use posebridge_telemetry::{Audience, HostClock, Span, Stamp};
use tokio::time::Sleep;

use crate::capacity::CapacityMeter;
use crate::connection::{Connection, Outgoing, Outstanding, PortCounters};
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;
use crate::token_bucket::TokenBucket;
use crate::transports::QUEUE_BYTES;

/// The frames that wait until a link may take them.
pub(crate) struct Pacer {
    timer: HostTimer,
    bucket: TokenBucket,
    queue: SendQueue<Audience>,
    meter: CapacityMeter,
    wake: Option<Pin<Box<Sleep>>>,
}

impl Pacer {
    /// Lets `bytes_per_s` pass.
    pub(crate) fn new(bytes_per_s: u32, timer: HostTimer) -> Self {
        Self {
            timer,
            bucket: TokenBucket::new(bytes_per_s, timer.now()),
            queue: SendQueue::new(QUEUE_BYTES),
            meter: CapacityMeter::default(),
            wake: None,
        }
    }

    /// Passes a frame on, or keeps it until its turn.
    pub(crate) fn give(&mut self, out: &Outgoing<'_>, connection: &mut dyn Connection, counters: &mut PortCounters) {
        let now = self.timer.now();
        if self.queue.is_empty() && self.bucket.wait(now) == Span::ZERO {
            self.bucket.take(cost(out, connection));
            connection.send(out, counters);
            return;
        }
        if connection.reach(out.to) > 0 {
            counters.drops_out += self.queue.push(out.to, out.priority, out.frame);
        }
        self.meter.note(now, 0, self.queue.backlog());
    }

    /// Passes on what may pass; leaves the waker for the rest.
    pub(crate) fn poll(&mut self, cx: &mut Context<'_>, connection: &mut dyn Connection, counters: &mut PortCounters) {
        while let Some((to, priority, frame)) = self.queue.first() {
            if let Some(wake) = &mut self.wake {
                if wake.as_mut().poll(cx).is_pending() {
                    return;
                }
                self.wake = None;
            }
            let now = self.timer.now();
            let wait = self.bucket.wait(now);
            if wait > Span::ZERO {
                let at = self.timer.instant(now + wait);
                self.wake = Some(Box::pin(tokio::time::sleep_until(at)));
                continue;
            }
            let out = Outgoing { to: *to, priority, frame };
            let bytes = cost(&out, connection);
            connection.send(&out, counters);
            self.bucket.take(bytes);
            self.queue.drop_head();
            self.meter.note(now, bytes, self.queue.backlog());
        }
    }

    /// What waits here and in the connection. The allowed rate, which counts all peers together, is the capacity where it is
    /// smaller than what the connection says, which may be about its fastest peer alone.
    pub(crate) fn outstanding(&self, below: Outstanding, now: Stamp<HostClock>) -> Outstanding {
        let here = self.meter.bytes_per_s(now);
        let capacity_bytes_per_s = match (here, below.capacity_bytes_per_s) {
            (Some(here), Some(below)) => Some(here.min(below)),
            (here, below) => here.or(below),
        };
        Outstanding {
            peers: below.peers,
            frames: below.frames + self.queue.len() as u64,
            bytes: below.bytes + self.queue.bytes() as u64,
            capacity_bytes_per_s,
        }
    }
}

/// What a frame takes of the allowed rate.
fn cost(out: &Outgoing<'_>, connection: &dyn Connection) -> usize {
    out.frame.len() * connection.reach(out.to) as usize
}

//! A byte stream with one peer as a [`Connection`]: serial port, pseudo-terminal or TCP.
//!
//! The end of the stream, and any error, is a loss: a tty that is hung up answers every read at once with no bytes, for
//! ever, and reading on would be a busy loop. It writes complete frames and does not interpret them.
//!
//! The system's buffers are first in, first out: nothing in them can be replaced or overtaken. Where their fill level
//! can be queried, at most a fiftieth of a second of line time is left in them, and the rest waits in our queue, where
//! the newest estimate and the next command go first.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll, Waker, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use posebridge_telemetry::{HostClock, PeerId, Recipients, TimeDelta, Timestamp};
use tokio::time::Sleep;

use crate::capacity::{COARSE_WRITE_GAP, CapacityMeter};
use crate::connection::{Connection, LinkCounters, OutgoingFrame, QueueStatus, ReceivedBytes};
use crate::error::LinkError;
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;

#[cfg(test)]
mod tests;

/// Most bytes of one read: some twenty frames. What a stalled line held back comes at once; in one piece it would keep the other links
/// waiting, and its events would fill a megabyte for a moment.
const READ_BYTES: usize = 1_024;

/// Smallest allowed fill level of the system's buffer, in bytes: a fifth of the longest frame, so that the line never idles.
const MIN_KERNEL_BYTES: usize = 64;
/// Allowed fill level of the system's buffer, as line time: one period of a 50 Hz telemetry stream.
const KERNEL_BUFFER_TIME: TimeDelta = TimeDelta::from_millis(20);
/// Longest wait before the fill level is queried again. Some USB drivers count each pending transfer as a whole kilobyte (Linux,
/// `acm_tty_chars_in_buffer`), so a wait computed from their figure is too long.
const MAX_RECHECK: TimeDelta = TimeDelta::from_millis(5);
/// Shortest wait: the runtime's timers are no finer.
const MIN_RECHECK: TimeDelta = TimeDelta::from_millis(1);

/// A byte stream whose system buffer may be queried.
pub(crate) trait ByteStream: AsyncRead + AsyncWrite + Unpin + Send {
    /// Bytes that the system has accepted and not sent yet; `None` if unknown.
    fn kernel_queued_bytes(&self) -> Option<usize> {
        None
    }
}

impl ByteStream for tokio::net::TcpStream {}

#[derive(Clone, Debug)]
pub(crate) struct StreamLabel {
    pub(crate) detail: String,
    pub(crate) local_address: Option<SocketAddr>,
    pub(crate) stable_path: Option<PathBuf>,
    pub(crate) peer: PeerId,
}

impl StreamLabel {
    /// A stream with one peer and no socket address.
    pub(crate) const fn new(detail: String) -> Self {
        Self { detail, local_address: None, stable_path: None, peer: PeerId(0) }
    }
}

/// The limit of the system's buffer for a line, and when to query it again.
struct KernelQueueLimit {
    limit_bytes: usize,
    bytes_per_s: f64,
    recheck_timer: Option<Pin<Box<Sleep>>>,
}

impl KernelQueueLimit {
    fn new(bytes_per_s: f64) -> Self {
        let limit_bytes = (bytes_per_s * KERNEL_BUFFER_TIME.as_secs_f64()) as usize;
        Self { limit_bytes: limit_bytes.max(MIN_KERNEL_BYTES), bytes_per_s, recheck_timer: None }
    }

    /// Time until the system's buffer is below the limit; `None` if it is.
    fn time_until_below(&self, system_bytes: usize) -> Option<TimeDelta> {
        let excess = system_bytes.checked_sub(self.limit_bytes + 1)? + 1;
        let wait = TimeDelta::from_secs_f64(excess as f64 / self.bytes_per_s);
        Some(wait.clamp(MIN_RECHECK, MAX_RECHECK))
    }
}

/// A byte stream with the frames that wait to be written to it.
pub(crate) struct StreamConnection<S> {
    stream: S,
    label: StreamLabel,
    timer: HostTimer,
    queue: SendQueue<()>,
    kernel_limit: Option<KernelQueueLimit>,
    meter: CapacityMeter,
    /// Reported only after everything that the peer sent before has been read.
    write_failure: Option<std::io::Error>,
    buffer: Box<[u8]>,
    /// Fields are dropped in order: this one after the stream is closed.
    pub(crate) on_close: Option<Box<dyn Send>>,
}

impl<S: ByteStream> StreamConnection<S> {
    /// A connection over an open stream. At most `queue_bytes` of complete frames wait to be written, besides commands.
    pub(crate) fn new(stream: S, label: StreamLabel, timer: HostTimer, queue_bytes: usize) -> Self {
        Self {
            stream,
            label,
            timer,
            queue: SendQueue::new(queue_bytes),
            kernel_limit: None,
            meter: CapacityMeter::with_longest_gap(COARSE_WRITE_GAP),
            write_failure: None,
            buffer: vec![0; READ_BYTES].into_boxed_slice(),
            on_close: None,
        }
    }

    /// Limits the system's buffer to what a line of `bytes_per_s` sends in a fiftieth of a second.
    pub(crate) fn with_line_rate(mut self, bytes_per_s: f64) -> Self {
        self.kernel_limit = Some(KernelQueueLimit::new(bytes_per_s));
        self.meter = CapacityMeter::default();
        self
    }

    /// Ready when the system's buffer is below its limit.
    fn poll_kernel_space(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        let Some(bound) = &mut self.kernel_limit else {
            return Poll::Ready(());
        };
        loop {
            if let Some(recheck) = &mut bound.recheck_timer {
                ready!(recheck.as_mut().poll(cx));
                bound.recheck_timer = None;
            }
            let system_bytes = self.stream.kernel_queued_bytes().unwrap_or(0);
            let Some(wait) = bound.time_until_below(system_bytes) else {
                return Poll::Ready(());
            };
            let at = self.timer.instant(self.timer.now() + wait);
            bound.recheck_timer = Some(Box::pin(tokio::time::sleep_until(at)));
        }
    }

    /// Writes what the system accepts at once.
    fn poll_write(&mut self, cx: &mut Context<'_>, frame: &[u8]) -> Poll<std::io::Result<usize>> {
        ready!(self.poll_kernel_space(cx));
        Pin::new(&mut self.stream).poll_write(cx, frame)
    }

    /// Writes queued frames until the system accepts no more.
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut LinkCounters) {
        let mut taken = 0;
        while !self.queue.is_empty()
            && self.poll_kernel_space(cx).is_ready()
            && let Some(((), rest)) = self.queue.head()
        {
            match Pin::new(&mut self.stream).poll_write(cx, rest) {
                Poll::Pending => break,
                Poll::Ready(Ok(0)) => {
                    return self.record_write_failure(std::io::ErrorKind::WriteZero.into(), counters);
                }
                Poll::Ready(Ok(count)) => {
                    taken += count;
                    counters.bytes_out += count as u64;
                    self.queue.advance(count);
                }
                Poll::Ready(Err(error)) => return self.record_write_failure(error, counters),
            }
        }
        self.record_write(taken);
    }

    /// Records what the system accepted while frames waited.
    fn record_write(&mut self, taken: usize) {
        self.meter.record_write_if_busy(|| self.timer.now(), taken, self.queue.backlog());
    }

    fn record_write_failure(&mut self, error: std::io::Error, counters: &mut LinkCounters) {
        counters.drops_out += self.queue.clear();
        self.write_failure = Some(error);
    }
}

impl<S: ByteStream> Connection for StreamConnection<S> {
    fn detail(&self) -> String {
        self.label.detail.clone()
    }

    fn local_address(&self) -> Option<SocketAddr> {
        self.label.local_address
    }

    fn stable_path(&self) -> Option<&Path> {
        self.label.stable_path.as_deref()
    }

    fn count_recipients(&self, to: Recipients) -> u32 {
        u32::from(to.includes(self.label.peer))
    }

    fn send(&mut self, out: &OutgoingFrame<'_>, counters: &mut LinkCounters) {
        let frame = out.frame;
        if !out.to.includes(self.label.peer) || frame.is_empty() {
            return;
        }
        if self.write_failure.is_some() {
            counters.drops_out += 1;
            return;
        }
        if !self.queue.is_empty() {
            counters.drops_out += self.queue.push((), out.priority, frame);
            return self.record_write(0);
        }
        // No task has to be woken: what is left over is written by the next `poll`, which leaves its own waker.
        let mut cx = Context::from_waker(Waker::noop());
        let mut taken = 0;
        match self.poll_write(&mut cx, frame) {
            Poll::Ready(Ok(count)) if count > 0 => {
                taken = count;
                counters.bytes_out += count as u64;
                if let Some(rest) = frame.get(count..).filter(|rest| !rest.is_empty()) {
                    self.queue.push_partial((), rest);
                }
            }
            Poll::Pending => counters.drops_out += self.queue.push((), out.priority, frame),
            Poll::Ready(result) => {
                counters.drops_out += 1;
                let error = result.err().unwrap_or(std::io::ErrorKind::WriteZero.into());
                self.record_write_failure(error, counters);
            }
        }
        self.record_write(taken);
    }

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut LinkCounters,
    ) -> Poll<Result<Option<ReceivedBytes>, LinkError>> {
        self.flush(cx, counters);
        let mut buffer = ReadBuf::new(&mut self.buffer);
        match Pin::new(&mut self.stream).poll_read(cx, &mut buffer) {
            Poll::Ready(Ok(())) if buffer.filled().is_empty() => Poll::Ready(Err(LinkError::HungUp)),
            Poll::Ready(Ok(())) => Poll::Ready(Ok(Some(ReceivedBytes {
                peer: self.label.peer,
                arrival: self.timer.now(),
                bytes: buffer.filled().to_vec(),
            }))),
            Poll::Ready(Err(error)) => Poll::Ready(Err(error.into())),
            Poll::Pending => match self.write_failure.take() {
                Some(error) => Poll::Ready(Err(error.into())),
                None => Poll::Pending,
            },
        }
    }

    fn queue_status(&self, now: Timestamp<HostClock>) -> QueueStatus {
        QueueStatus {
            peers: 1,
            frames: self.queue.len() as u64,
            bytes: self.queue.bytes() as u64,
            capacity_bytes_per_s: self.meter.bytes_per_s(now),
        }
    }
}

//! A byte stream with one peer as a [`Connection`]: serial port, pseudo-terminal or TCP.
//!
//! Any end of the stream, and any error of it, is a loss: a tty that is hung up answers every read at once with
//! nothing, for ever, and to read on would be a busy loop. It knows nothing of frames beyond not tearing them.
//!
//! The system's own buffers are first in, first out: what lies in them can be neither replaced nor overtaken. Where the
//! system can be asked how much that is, no more than a fiftieth of a second of the line is left there, and the rest
//! waits in our queue, where the newest estimate and the next command go first.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll, Waker, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use posebridge_telemetry::{Audience, HostClock, PeerId, Span, Stamp};
use tokio::time::Sleep;

use crate::capacity::{CapacityMeter, LUMPY_GAP};
use crate::connection::{Connection, Incoming, Outgoing, Outstanding, PortCounters};
use crate::error::LinkLoss;
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;

#[cfg(test)]
mod tests;

/// Most bytes of one read: more than a tenth of a second of the fastest usual serial line (921600 baud).
const READ_BYTES: usize = 16 * 1024;

/// Least that may lie in the system, in bytes: a fifth of the longest frame, so that a line never runs dry over it.
const LEAST_SYSTEM_BYTES: usize = 64;
/// What may lie in the system, as time of the line: one turn of a 50 Hz telemetry stream.
const SYSTEM_TIME: Span = Span::from_millis(20);
/// Longest wait before the system is asked again. Some USB drivers report a whole transfer of a kilobyte for each that is
/// under way (Linux, `acm_tty_chars_in_buffer`), so what is computed from their figure is too long.
const LONGEST_RECHECK: Span = Span::from_millis(5);
/// Shortest wait: the runtime's timers are no finer.
const SHORTEST_RECHECK: Span = Span::from_millis(1);

/// A byte stream that may know what the system still holds of it.
pub(crate) trait ByteStream: AsyncRead + AsyncWrite + Unpin + Send {
    /// Bytes that the system has taken and not sent yet; `None` where it cannot be asked.
    fn system_bytes(&self) -> Option<usize> {
        None
    }
}

impl ByteStream for tokio::net::TcpStream {}

/// What is said about a stream and to whom it belongs.
#[derive(Clone, Debug)]
pub(crate) struct StreamLabel {
    /// See [`Connection::detail`].
    pub(crate) detail: String,
    /// See [`Connection::local_address`].
    pub(crate) local_address: Option<SocketAddr>,
    /// See [`Connection::stable_path`].
    pub(crate) stable_path: Option<PathBuf>,
    /// Who is at the other end.
    pub(crate) peer: PeerId,
}

impl StreamLabel {
    /// A stream with one peer and no socket address.
    pub(crate) const fn new(detail: String) -> Self {
        Self { detail, local_address: None, stable_path: None, peer: PeerId(0) }
    }
}

/// How much of a line's bytes may lie in the system, and when to ask again.
struct SystemBound {
    limit_bytes: usize,
    bytes_per_s: f64,
    recheck: Option<Pin<Box<Sleep>>>,
}

impl SystemBound {
    fn new(bytes_per_s: f64) -> Self {
        let limit_bytes = (bytes_per_s * SYSTEM_TIME.as_secs_f64()) as usize;
        Self { limit_bytes: limit_bytes.max(LEAST_SYSTEM_BYTES), bytes_per_s, recheck: None }
    }

    /// How long it takes until the system holds no more than it may; `None` if that is so.
    fn wait(&self, system_bytes: usize) -> Option<Span> {
        let excess = system_bytes.checked_sub(self.limit_bytes + 1)? + 1;
        let wait = Span::from_secs_f64(excess as f64 / self.bytes_per_s);
        Some(wait.clamp(SHORTEST_RECHECK, LONGEST_RECHECK))
    }
}

/// A byte stream with the frames that wait to be written to it.
pub(crate) struct StreamConnection<S> {
    stream: S,
    label: StreamLabel,
    timer: HostTimer,
    queue: SendQueue<()>,
    bound: Option<SystemBound>,
    meter: CapacityMeter,
    /// Told only after everything that the peer sent before has been read.
    write_failure: Option<std::io::Error>,
    buffer: Box<[u8]>,
    /// Fields are dropped in their order: this one when the stream is closed.
    closing: Option<Box<dyn Send>>,
}

impl<S: ByteStream> StreamConnection<S> {
    /// Takes over an open stream; at most `queue_bytes` of whole frames wait to be written, and commands beside them.
    pub(crate) fn new(stream: S, label: StreamLabel, timer: HostTimer, queue_bytes: usize) -> Self {
        Self {
            stream,
            label,
            timer,
            queue: SendQueue::new(queue_bytes),
            bound: None,
            meter: CapacityMeter::joining(LUMPY_GAP),
            write_failure: None,
            buffer: vec![0; READ_BYTES].into_boxed_slice(),
            closing: None,
        }
    }

    /// Drops `closing` when the stream has been closed.
    pub(crate) fn closing_with(mut self, closing: Box<dyn Send>) -> Self {
        self.closing = Some(closing);
        self
    }

    /// Leaves no more in the system than a line of `bytes_per_s` sends in a fiftieth of a second.
    pub(crate) fn with_line_rate(mut self, bytes_per_s: f64) -> Self {
        self.bound = Some(SystemBound::new(bytes_per_s));
        self.meter = CapacityMeter::default();
        self
    }

    /// Ready when the system holds so little that it may be given more.
    fn poll_room(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        let Some(bound) = &mut self.bound else {
            return Poll::Ready(());
        };
        loop {
            if let Some(recheck) = &mut bound.recheck {
                ready!(recheck.as_mut().poll(cx));
                bound.recheck = None;
            }
            let system_bytes = self.stream.system_bytes().unwrap_or(0);
            let Some(wait) = bound.wait(system_bytes) else {
                return Poll::Ready(());
            };
            let at = self.timer.instant(self.timer.now() + wait);
            bound.recheck = Some(Box::pin(tokio::time::sleep_until(at)));
        }
    }

    /// Writes what the system takes at once.
    fn poll_write(&mut self, cx: &mut Context<'_>, frame: &[u8]) -> Poll<std::io::Result<usize>> {
        ready!(self.poll_room(cx));
        Pin::new(&mut self.stream).poll_write(cx, frame)
    }

    /// Writes what waits until the system takes no more.
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) {
        let mut taken = 0;
        while !self.queue.is_empty()
            && self.poll_room(cx).is_ready()
            && let Some(((), rest)) = self.queue.head()
        {
            match Pin::new(&mut self.stream).poll_write(cx, rest) {
                Poll::Pending => break,
                Poll::Ready(Ok(0)) => {
                    return self.fail(std::io::ErrorKind::WriteZero.into(), counters);
                }
                Poll::Ready(Ok(count)) => {
                    taken += count;
                    counters.bytes_out += count as u64;
                    self.queue.advance(count);
                }
                Poll::Ready(Err(error)) => return self.fail(error, counters),
            }
        }
        self.measure(taken);
    }

    /// Notes what the system took while frames waited.
    fn measure(&mut self, taken: usize) {
        self.meter.note_if_busy(|| self.timer.now(), taken, self.queue.backlog());
    }

    fn fail(&mut self, error: std::io::Error, counters: &mut PortCounters) {
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

    fn reach(&self, to: Audience) -> u32 {
        u32::from(to.includes(self.label.peer))
    }

    fn send(&mut self, out: &Outgoing<'_>, counters: &mut PortCounters) {
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
            return self.measure(0);
        }
        // Nobody has to be woken: what is left over is written by the next `poll`, which leaves its own waker.
        let mut cx = Context::from_waker(Waker::noop());
        let mut taken = 0;
        match self.poll_write(&mut cx, frame) {
            Poll::Ready(Ok(count)) if count > 0 => {
                taken = count;
                counters.bytes_out += count as u64;
                if let Some(rest) = frame.get(count..).filter(|rest| !rest.is_empty()) {
                    self.queue.push_rest((), rest);
                }
            }
            Poll::Pending => counters.drops_out += self.queue.push((), out.priority, frame),
            Poll::Ready(result) => {
                counters.drops_out += 1;
                let error = result.err().unwrap_or(std::io::ErrorKind::WriteZero.into());
                self.fail(error, counters);
            }
        }
        self.measure(taken);
    }

    fn poll(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) -> Poll<Result<Incoming, LinkLoss>> {
        self.flush(cx, counters);
        let mut buffer = ReadBuf::new(&mut self.buffer);
        match Pin::new(&mut self.stream).poll_read(cx, &mut buffer) {
            Poll::Ready(Ok(())) if buffer.filled().is_empty() => Poll::Ready(Err(LinkLoss::HungUp)),
            Poll::Ready(Ok(())) => Poll::Ready(Ok(Incoming::Bytes {
                peer: self.label.peer,
                arrival: self.timer.now(),
                bytes: buffer.filled().to_vec(),
            })),
            Poll::Ready(Err(error)) => Poll::Ready(Err(error.into())),
            Poll::Pending => match self.write_failure.take() {
                Some(error) => Poll::Ready(Err(error.into())),
                None => Poll::Pending,
            },
        }
    }

    fn outstanding(&self, now: Stamp<HostClock>) -> Outstanding {
        Outstanding {
            peers: 1,
            frames: self.queue.len() as u64,
            bytes: self.queue.bytes() as u64,
            capacity_bytes_per_s: self.meter.bytes_per_s(now),
        }
    }
}

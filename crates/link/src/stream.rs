//! A byte stream with one peer as a [`Connection`]: serial port, pseudo-terminal or TCP.
//!
//! Any end of the stream, and any error of it, is a loss: a tty that is hung up answers every read at once with
//! nothing, for ever, and to read on would be a busy loop. It knows nothing of frames beyond not tearing them.

use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use posebridge_telemetry::PeerId;

use crate::connection::{Connection, Incoming, Outgoing, PortCounters};
use crate::error::LinkLoss;
use crate::host_timer::HostTimer;
use crate::send_queue::SendQueue;

/// Most bytes of one read: more than a tenth of a second of the fastest usual serial line (921600 baud).
const READ_BYTES: usize = 16 * 1024;

/// What is said about a stream and to whom it belongs.
#[derive(Clone, Debug)]
pub(crate) struct StreamLabel {
    /// See [`Connection::detail`].
    pub(crate) detail: String,
    /// See [`Connection::local_address`].
    pub(crate) local_address: Option<SocketAddr>,
    /// Who is at the other end.
    pub(crate) peer: PeerId,
}

impl StreamLabel {
    /// A stream with one peer and no socket address.
    pub(crate) const fn new(detail: String) -> Self {
        Self {
            detail,
            local_address: None,
            peer: PeerId(0),
        }
    }
}

/// A byte stream with the frames that wait to be written to it.
pub(crate) struct StreamConnection<S> {
    stream: S,
    label: StreamLabel,
    timer: HostTimer,
    queue: SendQueue<()>,
    /// Told only after everything that the peer sent before has been read.
    write_failure: Option<std::io::Error>,
    buffer: Box<[u8]>,
}

impl<S: AsyncRead + AsyncWrite + Unpin + Send> StreamConnection<S> {
    /// Takes over an open stream; at most `queue_bytes` of whole frames wait to be written.
    pub(crate) fn new(stream: S, label: StreamLabel, timer: HostTimer, queue_bytes: usize) -> Self {
        Self {
            stream,
            label,
            timer,
            queue: SendQueue::new(queue_bytes),
            write_failure: None,
            buffer: vec![0; READ_BYTES].into_boxed_slice(),
        }
    }

    /// Writes what waits until the system takes no more.
    fn flush(&mut self, cx: &mut Context<'_>, counters: &mut PortCounters) {
        while let Some(((), rest)) = self.queue.head() {
            match Pin::new(&mut self.stream).poll_write(cx, rest) {
                Poll::Pending => return,
                Poll::Ready(Ok(0)) => {
                    return self.fail(std::io::ErrorKind::WriteZero.into(), counters);
                }
                Poll::Ready(Ok(count)) => {
                    counters.bytes_out += count as u64;
                    self.queue.advance(count);
                }
                Poll::Ready(Err(error)) => return self.fail(error, counters),
            }
        }
    }

    fn fail(&mut self, error: std::io::Error, counters: &mut PortCounters) {
        counters.drops_out += self.unsent_frames();
        while !self.queue.is_empty() {
            self.queue.drop_head();
        }
        self.write_failure = Some(error);
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin + Send> Connection for StreamConnection<S> {
    fn detail(&self) -> String {
        self.label.detail.clone()
    }

    fn local_address(&self) -> Option<SocketAddr> {
        self.label.local_address
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
            counters.drops_out += self.queue.push((), frame);
            return;
        }
        // Nobody has to be woken: what is left over is written by the next `poll`, which leaves its own waker.
        let mut cx = Context::from_waker(Waker::noop());
        match Pin::new(&mut self.stream).poll_write(&mut cx, frame) {
            Poll::Ready(Ok(count)) if count > 0 => {
                counters.bytes_out += count as u64;
                if let Some(rest) = frame.get(count..).filter(|rest| !rest.is_empty()) {
                    self.queue.push_rest((), rest);
                }
            }
            Poll::Pending => counters.drops_out += self.queue.push((), frame),
            Poll::Ready(result) => {
                counters.drops_out += 1;
                let error = result.err().unwrap_or(std::io::ErrorKind::WriteZero.into());
                self.fail(error, counters);
            }
        }
    }

    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        counters: &mut PortCounters,
    ) -> Poll<Result<Incoming, LinkLoss>> {
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

    fn unsent_frames(&self) -> u64 {
        self.queue.len() as u64
    }
}

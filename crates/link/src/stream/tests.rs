//! A serial line in virtual time, whose driver reports its fill level.

use std::sync::{Arc, Mutex};

use tokio::io::ReadBuf;

use super::*;
use crate::traffic::{FRAME_BYTES, ReceivedFrames, TrafficSource};

/// 57600 baud, the usual speed of a telemetry radio.
const BYTES_PER_S: f64 = 5_760.0;
/// What the driver of a UART holds: one page (Linux, SERIAL_XMIT_SIZE).
const DRIVER_BYTES: usize = 4_096;

/// What was given to the line: sends `BYTES_PER_S`, in the order in which it was written.
#[derive(Default)]
struct SimulatedLine {
    /// Bytes and when the last of them has left the line.
    written: Vec<u8>,
    /// When everything that was written will have left, in seconds.
    idle_at: f64,
    /// Each byte's departure, in seconds.
    left_at: Vec<f64>,
}

#[derive(Clone)]
struct LineHandle {
    line: Arc<Mutex<SimulatedLine>>,
    timer: HostTimer,
}

impl LineHandle {
    fn held(&self, line: &SimulatedLine) -> usize {
        let ahead = (line.idle_at - self.timer.now().as_secs_f64()).max(0.0);
        (ahead * BYTES_PER_S).ceil() as usize
    }
}

impl ByteStream for LineHandle {
    fn kernel_queued_bytes(&self) -> Option<usize> {
        Some(self.held(&self.line.lock().expect("one thread")))
    }
}

impl AsyncWrite for LineHandle {
    fn poll_write(self: Pin<&mut Self>, _cx: &mut Context<'_>, bytes: &[u8]) -> Poll<std::io::Result<usize>> {
        let mut line = self.line.lock().expect("one thread");
        let count = bytes.len().min(DRIVER_BYTES.saturating_sub(self.held(&line)));
        if count == 0 {
            return Poll::Pending;
        }
        let mut at = line.idle_at.max(self.timer.now().as_secs_f64());
        for byte in &bytes[..count] {
            at += 1.0 / BYTES_PER_S;
            line.written.push(*byte);
            line.left_at.push(at);
        }
        line.idle_at = at;
        Poll::Ready(Ok(count))
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

impl AsyncRead for LineHandle {
    fn poll_read(self: Pin<&mut Self>, _cx: &mut Context<'_>, _buffer: &mut ReadBuf<'_>) -> Poll<std::io::Result<()>> {
        Poll::Pending
    }
}

/// Twenty virtual seconds of an overloaded line: the load, what came off the line, and the connection's queue status.
async fn overload() -> (TrafficSource, ReceivedFrames, QueueStatus) {
    let timer = HostTimer::start();
    let line = Arc::new(Mutex::new(SimulatedLine::default()));
    let fake = LineHandle { line: Arc::clone(&line), timer };
    let label = StreamLabel::new(String::new());
    let mut connection = StreamConnection::new(fake, label, timer, 65_536).with_line_rate(BYTES_PER_S);
    let mut counters = LinkCounters::default();
    let mut source = TrafficSource::new(BYTES_PER_S as u32);
    for _ in 0..2_000 {
        source.tick(timer.now(), |priority, frame| {
            connection.send(&OutgoingFrame { to: Recipients::All, priority, frame }, &mut counters);
        });
        for _ in 0..10 {
            tokio::time::advance(std::time::Duration::from_millis(1)).await;
            let mut cx = Context::from_waker(Waker::noop());
            assert!(connection.poll(&mut cx, &mut counters).is_pending());
        }
    }
    let status = connection.queue_status(timer.now());
    let line = line.lock().expect("one thread");
    let mut received = ReceivedFrames::default();
    for (byte, left_at) in line.written.iter().zip(&line.left_at) {
        received.push(&[*byte], Timestamp::from_secs_f64(*left_at));
    }
    (source, received, status)
}

#[tokio::test(start_paused = true)]
async fn on_an_overloaded_line_estimates_are_young_and_commands_overtake() {
    let (source, received, status) = overload().await;
    // In front of an estimate may lie 20 ms of the line, the frame that was begun there, the other stream's estimate and a
    // command; and a timer is a millisecond or two late.
    let bound = TimeDelta::from_secs_f64(0.020 + 4.0 * FRAME_BYTES as f64 / BYTES_PER_S + 0.002);
    assert!(received.oldest_estimate <= bound, "{:?} of {bound:?}", received.oldest_estimate);
    assert!(received.oldest_command <= bound, "{:?} of {bound:?}", received.oldest_command);
    let commands = received.commands.len() as u32;
    assert!(received.commands.iter().copied().eq(0..commands));
    assert!(source.commands - commands <= 1, "{commands} of {}", source.commands);
    // The line never ran dry: 20 s of it are 2400 frames.
    let frames = received.commands.len() + received.estimates.iter().map(Vec::len).sum::<usize>();
    assert!(frames >= 2_380, "{frames} frames");
    let capacity = status.capacity_bytes_per_s.expect("frames wait");
    assert!((capacity / BYTES_PER_S - 1.0).abs() < 0.05, "{capacity}");
}

//! A serial line in virtual time, whose driver reports its fill level.

use std::sync::{Arc, Mutex};

use posebridge_telemetry::Priority;
use tokio::io::ReadBuf;

use super::*;

/// 57600 baud, the usual speed of a telemetry radio.
const BYTES_PER_S: f64 = 5_760.0;
/// What the driver of a UART holds: one page (Linux, SERIAL_XMIT_SIZE).
const DRIVER_BYTES: usize = 4_096;
const FRAME_BYTES: usize = 48;
const COMMAND: u8 = 9;

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

/// What came off the line: the oldest estimate and the oldest command when their last bytes left, in seconds, and the
/// commands' numbers.
struct DepartureSummary {
    oldest_estimate: f64,
    oldest_command: f64,
    commands: Vec<u32>,
    frames: usize,
}

fn departures(line: &SimulatedLine) -> DepartureSummary {
    let mut departures =
        DepartureSummary { oldest_estimate: 0.0, oldest_command: 0.0, commands: Vec::new(), frames: 0 };
    let ends = line.left_at.chunks_exact(FRAME_BYTES);
    for (frame, ends) in line.written.chunks_exact(FRAME_BYTES).zip(ends) {
        assert!(frame[12..].iter().all(|byte| *byte == frame[12]), "torn: {frame:?}");
        let number = u32::from_be_bytes(frame[..4].try_into().expect("four bytes"));
        let sent = f64::from_be_bytes(frame[4..12].try_into().expect("eight bytes"));
        let age = ends[FRAME_BYTES - 1] - sent;
        departures.frames += 1;
        if frame[12] == COMMAND {
            departures.commands.push(number);
            departures.oldest_command = departures.oldest_command.max(age);
        } else {
            departures.oldest_estimate = departures.oldest_estimate.max(age);
        }
    }
    departures
}

fn frame(kind: u8, number: u32, timer: HostTimer) -> [u8; FRAME_BYTES] {
    let mut frame = [kind; FRAME_BYTES];
    frame[..4].copy_from_slice(&number.to_be_bytes());
    frame[4..12].copy_from_slice(&timer.now().as_secs_f64().to_be_bytes());
    frame
}

/// Offers two streams of 600 estimates per second, ten times what the line takes, and five commands per second, for 20
/// virtual seconds. Returns what arrived, how many commands were offered, and the connection's queue status.
async fn overload() -> (DepartureSummary, u32, QueueStatus) {
    let timer = HostTimer::start();
    let line = Arc::new(Mutex::new(SimulatedLine::default()));
    let fake = LineHandle { line: Arc::clone(&line), timer };
    let label = StreamLabel::new(String::new());
    let mut connection = StreamConnection::new(fake, label, timer, 65_536).with_line_rate(BYTES_PER_S);
    let mut counters = LinkCounters::default();
    let mut commands = 0;
    for tick in 0..2_000_u32 {
        let mut send_frame = |priority, frame: [u8; FRAME_BYTES]| {
            let out = OutgoingFrame { to: Recipients::All, priority, frame: &frame };
            connection.send(&out, &mut counters);
        };
        for number in 0..6 {
            let stream = number % 2;
            let estimate = frame(stream as u8, tick, timer);
            send_frame(Priority::Estimate { stream }, estimate);
        }
        if tick.is_multiple_of(20) {
            send_frame(Priority::Command, frame(COMMAND, commands, timer));
            commands += 1;
        }
        for _ in 0..10 {
            tokio::time::advance(std::time::Duration::from_millis(1)).await;
            let mut cx = Context::from_waker(Waker::noop());
            assert!(connection.poll(&mut cx, &mut counters).is_pending());
        }
    }
    let status = connection.queue_status(timer.now());
    let line = line.lock().expect("one thread");
    (departures(&line), commands, status)
}

#[tokio::test(start_paused = true)]
async fn on_an_overloaded_line_estimates_are_young_and_commands_overtake() {
    let (departures, offered, status) = overload().await;
    // In front of an estimate may lie 20 ms of the line, the frame that was begun there, the other stream's estimate and a
    // command; and a timer is a millisecond or two late.
    let bound = 0.020 + 4.0 * FRAME_BYTES as f64 / BYTES_PER_S + 0.002;
    assert!(departures.oldest_estimate <= bound, "{} of {bound}", departures.oldest_estimate);
    assert!(departures.oldest_command <= bound, "{} of {bound}", departures.oldest_command);
    let received = departures.commands.len() as u32;
    assert!(departures.commands.iter().copied().eq(0..received));
    assert!(offered - received <= 1, "{received} of {offered}");
    // The line never ran dry: 20 s of it are 2400 frames.
    assert!(departures.frames >= 2_380, "{} frames", departures.frames);
    let capacity = status.capacity_bytes_per_s.expect("frames wait");
    assert!((capacity / BYTES_PER_S - 1.0).abs() < 0.05, "{capacity}");
}

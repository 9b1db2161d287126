//! The thread that writes messages and the status block to stderr while a station runs.
//!
//! A terminal may stop taking bytes: Ctrl-S, a full pipe, an ssh that hangs. Only this thread waits for it. Its queue is bounded; what does
//! not fit is dropped, counted, and told when the terminal takes bytes again.

use std::io::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Queued messages: some screens full.
const QUEUE_ITEMS: usize = 1_024;
const BAR_STEPS: u64 = 1_000;
/// How long the end of a station waits for the terminal to take what is queued.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);

static WRITER: Mutex<Option<StderrWriter>> = Mutex::new(None);

/// The text at the bottom of the terminal while a station runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StatusBlock {
    pub text: String,
    /// Share of the run that is over, 0 to 1; `None` without an end.
    pub progress: Option<f64>,
}

enum Item {
    Line(String),
    Status(StatusBlock),
    ClearStatus,
    /// Answered when all before it is written.
    Flush(Sender<()>),
}

#[derive(Clone)]
struct StderrWriter {
    items: Sender<Item>,
    dropped: Arc<AtomicU64>,
}

impl StderrWriter {
    fn start(stderr: impl Stderr + 'static) -> std::io::Result<Self> {
        let (items, queue) = bounded(QUEUE_ITEMS);
        let dropped = Arc::new(AtomicU64::new(0));
        let counter = Arc::clone(&dropped);
        std::thread::Builder::new().name("stderr".to_owned()).spawn(move || write(&queue, &counter, stderr))?;
        Ok(Self { items, dropped })
    }

    fn push_line(&self, line: &str) {
        if self.items.try_send(Item::Line(line.to_owned())).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Waits until everything queued is written; false if that takes too long.
    fn flush(&self, timeout: Duration) -> bool {
        let (done, is_done) = bounded(1);
        let is_queued = self.items.send_timeout(Item::Flush(done), timeout).is_ok();
        is_queued && is_done.recv_timeout(timeout).is_ok()
    }
}

/// While it lives, no caller of the functions below waits for stderr. When it is dropped, what is queued is written first, unless the
/// terminal does not take it within a second; then messages stay queued.
pub struct BackgroundStderr(());

impl BackgroundStderr {
    pub fn start() -> std::io::Result<Self> {
        let mut writer = WRITER.lock().unwrap_or_else(PoisonError::into_inner);
        if writer.is_none() {
            *writer = Some(StderrWriter::start(Terminal::default())?);
        }
        Ok(Self(()))
    }
}

impl Drop for BackgroundStderr {
    fn drop(&mut self) {
        if flush() {
            WRITER.lock().unwrap_or_else(PoisonError::into_inner).take();
        }
    }
}

fn writer() -> Option<StderrWriter> {
    WRITER.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Writes a line to stderr; while a [`BackgroundStderr`] lives, without waiting.
pub(crate) fn write_line(line: &str) {
    match writer() {
        Some(writer) => writer.push_line(line),
        // There is nowhere left to report it.
        None => drop(writeln!(std::io::stderr().lock(), "{line}")),
    }
}

/// Waits until queued messages are written, for a second at most; false if they are not. Keeps their order with what is written to stdout.
pub(crate) fn flush() -> bool {
    writer().is_none_or(|writer| writer.flush(FLUSH_TIMEOUT))
}

/// Whether stderr is a terminal that can show a [`StatusBlock`].
pub fn shows_status() -> bool {
    !ProgressBar::with_draw_target(Some(BAR_STEPS), ProgressDrawTarget::stderr()).is_hidden()
}

/// Replaces the status block. A terminal that is behind misses it; the next one is newer.
pub fn show_status(status: StatusBlock) {
    if let Some(writer) = writer() {
        drop(writer.items.try_send(Item::Status(status)));
    }
}

pub fn clear_status() {
    if let Some(writer) = writer() {
        drop(writer.items.try_send(Item::ClearStatus));
    }
}

/// What the thread writes to.
trait Stderr: Send {
    fn write_line(&mut self, line: &str) -> std::io::Result<()>;
    fn show(&mut self, status: &StatusBlock);
    fn clear(&mut self);
}

fn write(queue: &Receiver<Item>, dropped: &AtomicU64, mut stderr: impl Stderr) {
    for item in queue {
        match item {
            Item::Line(line) => {
                if stderr.write_line(&line).is_err() {
                    dropped.fetch_add(1, Ordering::Relaxed);
                    continue;
                }
            }
            Item::Status(status) => stderr.show(&status),
            Item::ClearStatus => stderr.clear(),
            Item::Flush(done) => drop(done.try_send(())),
        }
        // The queue was full and flows again.
        if queue.len() < QUEUE_ITEMS / 2 {
            let lost = dropped.swap(0, Ordering::Relaxed);
            let notice = format!("{lost} messages are missing here: this terminal took none for a while");
            if lost > 0 && stderr.write_line(&notice).is_err() {
                dropped.fetch_add(lost, Ordering::Relaxed);
            }
        }
    }
}

/// The process's own stderr, with the block at its bottom where that is a terminal.
#[derive(Default)]
struct Terminal {
    block: Option<ProgressBar>,
}

impl Terminal {
    fn start_block(status: &StatusBlock) -> ProgressBar {
        let bar = ProgressBar::with_draw_target(Some(BAR_STEPS), ProgressDrawTarget::stderr());
        let template = if status.progress.is_some() { "{msg}\n  {wide_bar} {percent:>3} %" } else { "{msg}" };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar
    }
}

impl Stderr for Terminal {
    fn write_line(&mut self, line: &str) -> std::io::Result<()> {
        match &self.block {
            Some(block) => {
                block.println(line);
                Ok(())
            }
            None => writeln!(std::io::stderr().lock(), "{line}"),
        }
    }

    fn show(&mut self, status: &StatusBlock) {
        let block = self.block.get_or_insert_with(|| Self::start_block(status));
        if let Some(share) = status.progress {
            block.set_position((share.clamp(0.0, 1.0) * BAR_STEPS as f64) as u64);
        }
        block.set_message(status.text.clone());
    }

    fn clear(&mut self) {
        if let Some(block) = self.block.take() {
            block.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A terminal that takes a line only when the test lets it.
    struct StoppedTerminal {
        permits: Receiver<()>,
        written: Sender<String>,
    }

    impl Stderr for StoppedTerminal {
        fn write_line(&mut self, line: &str) -> std::io::Result<()> {
            // All go once the test has dropped its end.
            let _is_held = self.permits.recv();
            self.written.send(line.to_owned()).map_err(std::io::Error::other)
        }
        fn show(&mut self, _: &StatusBlock) {}
        fn clear(&mut self) {}
    }

    #[test]
    fn a_stopped_terminal_stops_nobody_and_what_it_missed_is_told_when_it_goes_on() {
        let (go, permits) = bounded(1);
        let (written, lines) = bounded(2 * QUEUE_ITEMS);
        let writer = StderrWriter::start(StoppedTerminal { permits, written }).unwrap();
        // One of them is in the thread's hands, or not yet.
        let sent = QUEUE_ITEMS + 10;
        for number in 0..sent {
            writer.push_line(&number.to_string());
        }
        let dropped = writer.dropped.load(Ordering::Relaxed);
        assert!((9..=10).contains(&dropped), "{dropped}");
        assert!(!writer.flush(Duration::ZERO), "it is stopped");
        drop(go);
        assert!(writer.flush(Duration::from_mins(1)));
        let lines: Vec<String> = lines.try_iter().collect();
        let notice = format!("{dropped} messages are missing here: this terminal took none for a while");
        assert_eq!(lines.iter().filter(|line| **line == notice).count(), 1, "{lines:?}");
        assert_eq!(lines.len() as u64, sent as u64 - dropped + 1);
        assert_eq!(lines[0], "0");
    }
}

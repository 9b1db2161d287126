//! Console output: messages on stderr, results on stdout, progress bars.
//!
//! Errors of writing to stderr are ignored, and while a station runs nobody waits for it ([`crate::stderr_writer`]). While the
//! terminal view owns the screen, messages go to its event panel ([`redirect_stderr`]). They are also retained and printed when the
//! screen is restored, so that no message is lost with it.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, OnceLock, PoisonError, TryLockError};

use clap::ColorChoice;
use indicatif::{ProgressBar, ProgressStyle};
use posebridge_report::colour::Colour;
use posebridge_telemetry::is_printable;

use crate::stderr_writer;

/// Bound of the messages for the terminal view, which polls twenty times a second; further ones are only retained.
const QUEUE_LINES: usize = 256;
/// Bound of the retained messages; the oldest are dropped and counted.
const MAX_RETAINED_LINES: usize = 200;

static REDIRECTION: Mutex<Option<Redirection>> = Mutex::new(None);

struct Redirection {
    lines: SyncSender<String>,
    retained: VecDeque<String>,
    dropped: u64,
    route: RedirectMode,
}

/// Whether stderr is the terminal of the view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum RedirectMode {
    /// It is: messages are retained until the view ends.
    Replace,
    /// It is a file or pipe, which also gets every message.
    Tee,
}

pub fn print_line(line: &str) {
    let line = &*without_controls(line);
    if capture(line) == Some(RedirectMode::Replace) {
        return;
    }
    stderr_writer::write_line(line);
}

pub fn print_lines(lines: &[String]) {
    for line in lines {
        print_line(line);
    }
}

/// The text without what a file or a sender could steer a terminal by: only lines, tabs and the colours of ECMA-48 (SGR) stay, a question
/// mark stands for the rest.
fn without_controls(text: &str) -> Cow<'_, str> {
    let is_kept = |letter| is_printable(letter) || matches!(letter, '\n' | '\t');
    if text.chars().all(is_kept) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(letter) = rest.chars().next() {
        let kept = colour_length(rest).unwrap_or(letter.len_utf8());
        let (head, tail) = rest.split_at(kept);
        shown.push_str(if is_kept(letter) || kept > 1 && letter == '\u{1b}' { head } else { "?" });
        rest = tail;
    }
    Cow::Owned(shown)
}

/// The length of the colour sequence at the start of a text.
fn colour_length(text: &str) -> Option<usize> {
    let parameters = text.strip_prefix("\u{1b}[")?;
    let end = parameters.find(|letter: char| !letter.is_ascii_digit() && letter != ';')?;
    parameters[end..].starts_with('m').then_some("\u{1b}[".len() + end + "m".len())
}

/// Writes log entries as console messages. Each write is one entry.
#[derive(Clone, Copy, Debug, Default)]
pub struct LogWriter;

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        print_line(String::from_utf8_lossy(bytes).trim_end());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Redirects messages to a receiver until [`restore_stderr`].
pub fn redirect_stderr() -> Receiver<String> {
    let route = if std::io::stderr().is_terminal() { RedirectMode::Replace } else { RedirectMode::Tee };
    let (sender, receiver) = sync_channel(QUEUE_LINES);
    let mut redirection = REDIRECTION.lock().unwrap_or_else(PoisonError::into_inner);
    *redirection = Some(Redirection { lines: sender, retained: VecDeque::new(), dropped: 0, route });
    receiver
}

/// Prints the retained messages to stderr and ends the redirection. Never waits for a thread that is printing: it may be the one that
/// panics.
pub fn restore_stderr() {
    let ended = match REDIRECTION.try_lock() {
        Ok(mut redirection) => redirection.take(),
        Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().take(),
        Err(TryLockError::WouldBlock) => None,
    };
    let Some(ended) = ended else {
        return;
    };
    if ended.dropped > 0 {
        print_line(&format!("({} earlier lines are left out)", ended.dropped));
    }
    for line in &ended.retained {
        print_line(line);
    }
}

/// Sends a line to the receiver; `None` without a redirection.
fn capture(line: &str) -> Option<RedirectMode> {
    let mut redirection = REDIRECTION.lock().unwrap_or_else(PoisonError::into_inner);
    let redirection = redirection.as_mut()?;
    // A view that hangs shows less; what it misses is kept below.
    drop(redirection.lines.try_send(line.to_owned()));
    if redirection.route == RedirectMode::Replace {
        if redirection.retained.len() >= MAX_RETAINED_LINES {
            redirection.retained.pop_front();
            redirection.dropped += 1;
        }
        redirection.retained.push_back(line.to_owned());
    }
    Some(redirection.route)
}

static COLOUR_CHOICE: OnceLock<ColorChoice> = OnceLock::new();

/// Sets `--color` for the rest of the program.
pub fn set_colour(choice: ColorChoice) {
    // The command line is parsed once.
    let _is_first = COLOUR_CHOICE.set(choice).is_ok();
}

/// Colours of results on stdout: by default on a terminal, unless NO_COLOR is set to anything (no-color.org).
pub fn colour() -> Colour {
    let is_wanted = match COLOUR_CHOICE.get().copied().unwrap_or_default() {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => {
            let is_refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
            std::io::stdout().is_terminal() && !is_refused
        }
    };
    if is_wanted { Colour::Ansi } else { Colour::Plain }
}

/// Prints a result on stdout, after the messages before it. A broken pipe is not an error.
pub fn print_result(text: &str) -> std::io::Result<()> {
    stderr_writer::flush();
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(without_controls(text).as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// Progress bar over `count` of `units` (runs, laps); drawn on stderr only if that is a terminal.
pub fn progress_bar(count: u64, units: &str) -> anyhow::Result<ProgressBar> {
    let template = format!("{{bar:40}} {{pos}}/{{len}} {units}, {{eta}} left");
    Ok(ProgressBar::new(count).with_style(ProgressStyle::with_template(&template)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_escape_sequences_only_colours_reach_a_terminal() {
        let coloured = "\u{1b}[1;31mred\u{1b}[0m\n\tä\n";
        assert_eq!(without_controls(coloured), coloured);
        assert_eq!(without_controls("\u{1b}[2J\u{1b}]0;t\u{7}\u{9b}mä\r\u{1b}[1"), "?[2J?]0;t??mä??[1");
    }

    #[test]
    fn while_lines_are_diverted_the_receiver_has_them_and_afterwards_nobody_waits() {
        let lines = redirect_stderr();
        print_line("one");
        LogWriter.write_all(b" WARN two\n").unwrap();
        let received: Vec<String> = lines.try_iter().collect();
        assert!(received.contains(&"one".to_owned()), "{received:?}");
        assert!(received.contains(&" WARN two".to_owned()), "{received:?}");
        for line in 0..2 * QUEUE_LINES {
            print_line(&format!("{line}"));
        }
        assert_eq!(lines.try_iter().count(), QUEUE_LINES);
        restore_stderr();
        print_line("three");
        assert_eq!(lines.try_iter().count(), 0);
    }
}

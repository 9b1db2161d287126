//! Talk to the person who runs the program. A stderr that cannot be written is no reason to stop.
//!
//! While the terminal view has the screen, lines go to its panel of events and not across the screen ([`divert`]). They are kept as well,
//! and written when the screen is given back, so that nothing that was said is lost with it.

use std::collections::VecDeque;
use std::io::{IsTerminal, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError, TryLockError};

/// So many lines wait for the terminal view, which looks twenty times a second; then they are only kept.
const WAITING: usize = 256;
/// So many lines are kept to be written afterwards; of more, the first go and are counted.
const KEPT: usize = 200;

/// Where lines go, if not to stderr.
static DIVERSION: Mutex<Option<Diversion>> = Mutex::new(None);

struct Diversion {
    lines: SyncSender<String>,
    kept: VecDeque<String>,
    gone: u64,
    route: Route,
}

/// Whether stderr is the screen that the view has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Route {
    /// It is: lines wait until the view is gone.
    Instead,
    /// It is a file or another program, which gets them as ever.
    Beside,
}

/// Says a line.
pub fn say(line: &str) {
    if take_aside(line) == Some(Route::Instead) {
        return;
    }
    // There is nobody left to tell.
    drop(writeln!(std::io::stderr().lock(), "{line}"));
}

/// Where the log is written to: the same way as everything else that is said. Each write is one entry.
#[derive(Clone, Copy, Debug, Default)]
pub struct LogWriter;

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        say(String::from_utf8_lossy(bytes).trim_end());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Lets lines go to a receiver instead, until [`give_back`].
#[must_use]
pub fn divert() -> Receiver<String> {
    let route = if std::io::stderr().is_terminal() { Route::Instead } else { Route::Beside };
    let (sender, receiver) = sync_channel(WAITING);
    let mut diversion = DIVERSION.lock().unwrap_or_else(PoisonError::into_inner);
    *diversion = Some(Diversion { lines: sender, kept: VecDeque::new(), gone: 0, route });
    receiver
}

/// Writes what was kept, and everything from here on, to stderr. Never waits for who is saying something at this moment: it may be
/// the thread that panics.
pub fn give_back() {
    let ended = match DIVERSION.try_lock() {
        Ok(mut diversion) => diversion.take(),
        Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner().take(),
        Err(TryLockError::WouldBlock) => None,
    };
    let Some(ended) = ended else {
        return;
    };
    if ended.gone > 0 {
        say(&format!("({} earlier lines are left out)", ended.gone));
    }
    for line in &ended.kept {
        say(line);
    }
}

/// Hands a line to the receiver; the way it takes, if there is one.
fn take_aside(line: &str) -> Option<Route> {
    let mut diversion = DIVERSION.lock().unwrap_or_else(PoisonError::into_inner);
    let diversion = diversion.as_mut()?;
    // A view that hangs shows less; what it misses is kept below.
    drop(diversion.lines.try_send(line.to_owned()));
    if diversion.route == Route::Instead {
        if diversion.kept.len() >= KEPT {
            diversion.kept.pop_front();
            diversion.gone += 1;
        }
        diversion.kept.push_back(line.to_owned());
    }
    Some(diversion.route)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn while_lines_are_diverted_the_receiver_has_them_and_afterwards_nobody_waits() {
        let lines = divert();
        say("one");
        LogWriter.write_all(b" WARN two\n").unwrap();
        let heard: Vec<String> = lines.try_iter().collect();
        assert!(heard.contains(&"one".to_owned()), "{heard:?}");
        assert!(heard.contains(&" WARN two".to_owned()), "{heard:?}");
        for line in 0..2 * WAITING {
            say(&format!("{line}"));
        }
        assert_eq!(lines.try_iter().count(), WAITING);
        give_back();
        say("three");
        assert_eq!(lines.try_iter().count(), 0);
    }
}

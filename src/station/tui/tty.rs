//! The user's terminal: non-blocking output, and restoration of its modes.
//!
//! It is opened again instead of using standard output, so that only this program's descriptor becomes non-blocking: a terminal that
//! hangs (a frozen ssh, a stopped tmux) then fills `Tty::pending`, nothing is drawn until that is empty, and the view still receives
//! its messages. Source of the modes: termios(3), `cfmakeraw`.

use std::fs::{File, OpenOptions};
use std::io::{self, IsTerminal, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use anyhow::{Context, Result, ensure};
use nix::errno::Errno;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::termios::{SetArg, Termios, cfmakeraw, tcgetattr, tcsetattr};
use ratatui::crossterm::cursor::{Hide, Show};
use ratatui::crossterm::queue;
use ratatui::crossterm::style::ResetColor;
use ratatui::crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen};
use ratatui::layout::Rect;

/// Timeout of each final write before the rest is dropped.
const WRITE_TIMEOUT_MILLIS: u16 = 500;
/// Bytes read at a time; keystrokes are far fewer, and pasted text waits.
const MAX_INPUT_BYTES: usize = 1_024;
const MAX_CELLS: u16 = 1_000;
/// Cancels an incomplete escape sequence (ECMA-48, CAN).
const CANCEL: u8 = 0x18;

/// A terminal in raw mode; restored at the latest when dropped.
pub struct Tty {
    file: File,
    saved_settings: Mutex<Termios>,
    /// Drawn bytes that are not yet written: one frame at most, because the next is drawn when this is empty.
    pending: Mutex<Vec<u8>>,
    is_taken: AtomicBool,
}

/// Fails unless input and output are terminals.
pub fn ensure_terminal() -> Result<()> {
    ensure!(io::stdout().is_terminal(), "--tui: standard output is no terminal; run it in one, or without --tui");
    ensure!(
        io::stdin().is_terminal(),
        "--tui: standard input is no terminal, so no key could be heard; run it in one, or without --tui"
    );
    ensure!(
        std::env::var_os("TERM").is_none_or(|term| term != "dumb"),
        "--tui: the terminal calls itself `dumb` (TERM) and cannot show more than lines; run it without --tui"
    );
    Ok(())
}

impl Tty {
    /// The terminal of standard output.
    pub fn open() -> Result<Arc<Self>> {
        let name = nix::unistd::ttyname(io::stdout()).context("--tui: the terminal has no name")?;
        // That of another user, as after `su`, may be opened by the name that every process has for its own.
        Self::open_at(&name).or_else(|error| Self::open_at(Path::new("/dev/tty")).map_err(|_neither| error))
    }

    pub fn open_at(name: &Path) -> Result<Arc<Self>> {
        let flags = OFlag::O_NONBLOCK | OFlag::O_NOCTTY;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(flags.bits())
            .open(name)
            .with_context(|| format!("--tui: opening the terminal `{}`", name.display()))?;
        let before = tcgetattr(&file).context("--tui: asking the terminal for its modes")?;
        let mut raw = before.clone();
        cfmakeraw(&mut raw);
        tcsetattr(&file, SetArg::TCSANOW, &raw).context("--tui: setting the terminal's modes")?;
        let mut begin = Vec::new();
        queue!(begin, EnterAlternateScreen, Hide)?;
        Ok(Arc::new(Self {
            file,
            saved_settings: Mutex::new(before),
            pending: Mutex::new(begin),
            is_taken: AtomicBool::new(true),
        }))
    }

    /// Writes what the terminal accepts without blocking; returns whether nothing is left.
    pub fn drain(&self) -> io::Result<bool> {
        let mut pending = self.pending();
        while !pending.is_empty() {
            match (&self.file).write(&pending) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => drop(pending.drain(..written)),
                Err(error) if is_would_block(&error) => return Ok(false),
                Err(error) => return Err(error),
            }
        }
        Ok(true)
    }

    /// Typed bytes; waits at most `within_millis`.
    pub fn read(&self, within_millis: u16) -> io::Result<Vec<u8>> {
        let mut poll_fds = [PollFd::new(self.file.as_fd(), PollFlags::POLLIN)];
        match poll(&mut poll_fds, PollTimeout::from(within_millis)) {
            Ok(0) | Err(Errno::EINTR) => return Ok(Vec::new()),
            Ok(_) => {}
            Err(error) => return Err(error.into()),
        }
        let mut typed = vec![0; MAX_INPUT_BYTES];
        match (&self.file).read(&mut typed) {
            // A hang-up reads as the end of the input.
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(read) => {
                typed.truncate(read);
                Ok(typed)
            }
            Err(error) if is_would_block(&error) => Ok(Vec::new()),
            Err(error) => Err(error),
        }
    }

    /// Size of the terminal; 80 columns and 24 lines if it is unknown.
    pub fn area(&self) -> io::Result<Rect> {
        let size = rustix::termios::tcgetwinsize(&self.file)?;
        Ok(match (size.ws_col, size.ws_row) {
            (0, _) | (_, 0) => Rect::new(0, 0, 80, 24),
            (columns, rows) => Rect::new(0, 0, columns.min(MAX_CELLS), rows.min(MAX_CELLS)),
        })
    }

    /// Restores the terminal. Output that it does not accept within half a second is dropped; its modes are restored in any case.
    pub fn restore(&self) {
        if !self.is_taken.swap(false, Ordering::SeqCst) {
            return;
        }
        // The thread that panics may hold it.
        let mut rest = match self.pending.try_lock() {
            Ok(mut pending) => std::mem::take(&mut *pending),
            Err(TryLockError::Poisoned(poisoned)) => std::mem::take(&mut *poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => Vec::new(),
        };
        self.write_with_timeout(&mut rest);
        let mut end = if rest.is_empty() { Vec::new() } else { vec![CANCEL] };
        // Writing to a vector cannot fail.
        drop(queue!(end, ResetColor, Show, LeaveAlternateScreen));
        self.write_with_timeout(&mut end);
        let before = self.saved_settings.lock().unwrap_or_else(PoisonError::into_inner);
        // A terminal that is gone has no modes any more.
        let _ = tcsetattr(&self.file, SetArg::TCSANOW, &before);
    }

    /// Number of drawn bytes that are not yet written.
    #[cfg(test)]
    pub(super) fn waiting(&self) -> usize {
        self.pending().len()
    }

    fn write_with_timeout(&self, bytes: &mut Vec<u8>) {
        while !bytes.is_empty() {
            let mut poll_fds = [PollFd::new(self.file.as_fd(), PollFlags::POLLOUT)];
            if !matches!(poll(&mut poll_fds, PollTimeout::from(WRITE_TIMEOUT_MILLIS)), Ok(1)) {
                return;
            }
            match (&self.file).write(bytes) {
                Ok(0) | Err(_) => return,
                Ok(written) => drop(bytes.drain(..written)),
            }
        }
    }

    fn pending(&self) -> MutexGuard<'_, Vec<u8>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Tty {
    fn drop(&mut self) {
        self.restore();
    }
}

fn is_would_block(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

/// Collects drawn bytes; [`Tty::drain`] writes them.
pub struct TerminalWriter(pub Arc<Tty>);

impl Write for TerminalWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.0.is_taken.load(Ordering::SeqCst) {
            self.0.pending().extend_from_slice(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

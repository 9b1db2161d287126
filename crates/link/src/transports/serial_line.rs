//! Settings of an open serial line beyond its speed: DTR on close, and the adapter's latency timer.
//!
//! Arduino-class boards wire DTR to their reset: its rising edge restarts the sketch, which takes two seconds. Linux
//! raises DTR whenever a port is opened, which is no edge if it is still up, and lowers it when the port is closed,
//! unless HUPCL is cleared (termios(3)). So HUPCL is always cleared: the first open after plugging in resets the board
//! once, and later ones, by any program, do not.
//!
//! A program that only listens for a moment restores the settings that it found: [`LineSettingsGuard`].
//!
//! FTDI adapters collect received bytes for up to 16 ms; their driver offers that time as a file. The other way to set
//! it, ASYNC_LOW_LATENCY by TIOCSSERIAL, has no safe interface and the same effect on these adapters.

use std::fs;
use std::io;
use std::os::fd::OwnedFd;
use std::path::Path;

use nix::fcntl::OFlag;
use nix::sys::stat::Mode;
use nix::sys::termios::{ControlFlags, SetArg, tcgetattr, tcsetattr};
use rustix::termios::{OptionalActions, Termios};

/// The adapter's latency timer, in milliseconds: its smallest value (FTDI application note AN232B-04, section 3.3).
const LATENCY_MS: &str = "1";

/// A second descriptor of the line, through which its settings are reached. It has to be opened before the line is
/// locked, and is of no use for reading.
///
/// # Errors
/// As open(2); EBUSY if another program holds the line.
pub(super) fn open_settings(device: &Path) -> nix::Result<OwnedFd> {
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
    nix::fcntl::open(device, flags, Mode::empty())
}

/// Keeps DTR unchanged when any program closes the line.
pub(super) fn keep_dtr_on_close(line: &OwnedFd) -> nix::Result<()> {
    let mut settings = tcgetattr(line)?;
    settings.control_flags.remove(ControlFlags::HUPCL);
    tcsetattr(line, SetArg::TCSANOW, &settings)
}

/// The original settings of a line, restored on drop.
///
/// Read and written with their speed as a number (Linux, TCGETS2): termios(3) of the C library has names for the usual
/// speeds only, and serialport sets every speed as a number.
pub(super) struct LineSettingsGuard {
    line: OwnedFd,
    original: Termios,
}

impl LineSettingsGuard {
    /// Stores the settings of a line; `line` is a separate descriptor of it.
    pub(super) fn new(line: OwnedFd) -> io::Result<Self> {
        let found = rustix::termios::tcgetattr(&line)?;
        Ok(Self { line, original: found })
    }
}

impl Drop for LineSettingsGuard {
    fn drop(&mut self) {
        let put_back = rustix::termios::tcsetattr(&self.line, OptionalActions::Now, &self.original);
        if let Err(error) = put_back {
            // A device that was pulled has nothing to put back.
            tracing::debug!(%error, "the settings of a line were not put back");
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum LatencyTimer {
    /// The driver has no such setting.
    Absent,
    Shortened,
    /// It is not writable: the file's path and its current value.
    Unchanged {
        file: String,
        ms: String,
    },
}

pub(super) fn shorten_latency_timer(device: &Path, directory: &Path) -> LatencyTimer {
    let Some(name) = device.file_name() else {
        return LatencyTimer::Absent;
    };
    let file = directory.join(name).join("latency_timer");
    let Ok(before) = fs::read_to_string(&file) else {
        return LatencyTimer::Absent;
    };
    if before.trim() == LATENCY_MS || fs::write(&file, LATENCY_MS).is_ok() {
        return LatencyTimer::Shortened;
    }
    LatencyTimer::Unchanged { file: file.display().to_string(), ms: before.trim().to_owned() }
}

impl LatencyTimer {
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Absent => String::new(),
            Self::Shortened => ", latency timer 1 ms".to_owned(),
            Self::Unchanged { file, ms } => {
                format!(", latency timer {ms} ms: run `echo {LATENCY_MS} | sudo tee {file}` to shorten it")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_timer_that_may_not_be_written_is_reported_with_the_remedy() {
        let latency = LatencyTimer::Unchanged { file: "/sys/x/latency_timer".to_owned(), ms: "16".to_owned() };
        assert_eq!(
            latency.describe(),
            ", latency timer 16 ms: run `echo 1 | sudo tee /sys/x/latency_timer` to shorten it"
        );
    }
}

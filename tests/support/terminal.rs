//! A pseudo-terminal of a test's own: the test is the device, the program under test opens it like a serial port.

#![allow(dead_code, reason = "each test file uses its own part of this")]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

use std::fs::File;
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};

/// A device that is plugged in until this value is dropped.
pub(crate) struct PseudoTerminal {
    /// The device's own side.
    pub(crate) wire: File,
    /// Kept open: without any reader the terminal would be hung up.
    _station_side: OwnedFd,
    device: PathBuf,
    name: Option<PathBuf>,
}

impl PseudoTerminal {
    /// A device without echo and without any meaning in its bytes.
    pub(crate) fn open() -> Self {
        let pty = nix::pty::openpty(None, None).expect("a pseudo-terminal");
        let mut settings = tcgetattr(&pty.slave).expect("it has settings");
        cfmakeraw(&mut settings);
        tcsetattr(&pty.slave, SetArg::TCSANOW, &settings).expect("they can be set");
        for side in [&pty.master, &pty.slave] {
            // A program that is started meanwhile would hold the device open, and nobody could unplug it.
            fcntl(side, FcntlArg::F_SETFD(FdFlag::FD_CLOEXEC)).expect("it is open");
        }
        Self {
            device: nix::unistd::ttyname(&pty.slave).expect("it has a name"),
            wire: File::from(pty.master),
            _station_side: pty.slave,
            name: None,
        }
    }

    /// The same under a name that is the same after every plugging.
    pub(crate) fn open_as(name: &Path) -> Self {
        let mut terminal = Self::open();
        symlink(&terminal.device, name).expect("the name is free");
        terminal.name = Some(name.to_owned());
        terminal
    }

    /// Where a station opens it.
    pub(crate) fn device(&self) -> &Path {
        &self.device
    }
}

impl Drop for PseudoTerminal {
    fn drop(&mut self) {
        // The name goes before the device, as when a cable is pulled.
        if let Some(name) = &self.name {
            drop(std::fs::remove_file(name));
        }
    }
}

//! Pseudo-terminals that this program creates, so that the simulated brick looks like a serial port.
//!
//! The terminal's device number changes with every run, so a symbolic link gives it a fixed name. We keep the slave
//! side open: otherwise every moment without a reader would look like a hang-up. The buffer then fills when there is no reader,
//! so frames that do not fit are dropped and counted instead of queued, except commands. Readers that come late find up to 16 KiB
//! of old bytes; our own serial transport discards them. The fill level cannot be queried (Linux answers 0), so a pseudo-terminal
//! that imitates a slow line needs the `rate` option.

use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use nix::fcntl::OFlag;
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::stat::Mode;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::connection::Connection;
use crate::error::OpenError;
use crate::stream::{ByteStream, StreamConnection, StreamLabel};
use crate::transports::device_symlink::{DeviceSymlink, lock_terminal};
use crate::transports::open_request::OpenRequest;

/// Most bytes that wait for a reader, without commands: none, because they would be out of date when the reader comes.
const QUEUE_BYTES: usize = 0;

pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let path = request.url.path();
    let failed = |source| OpenError::Io { what: format!("a pseudo-terminal at {}", path.display()), source };
    let (master, slave, device) = open_terminal().map_err(failed)?;
    let link = DeviceSymlink::new(path, Path::new(&device))?;
    let stream = PtyStream { _link: link, master: register(master).map_err(failed)?, _slave: slave };
    // The reactor learns that the terminal takes data; without it the very first frame would be dropped.
    drop(stream.master.writable().await.map_err(failed)?);
    let detail = format!("{} is {device}", path.display());
    Ok(Box::new(StreamConnection::new(stream, StreamLabel::new(detail), request.timer, QUEUE_BYTES)))
}

/// The master side, with the values that must live as long.
struct PtyStream {
    // Dropped first, so that the name is removed before the device.
    _link: DeviceSymlink,
    master: AsyncFd<PtyMaster>,
    // Keeps the line up and raw while no other program has it open, and holds the lock that marks the name as in use.
    _slave: OwnedFd,
}

/// Both sides of a fresh terminal and the slave's device.
fn open_terminal() -> io::Result<(PtyMaster, OwnedFd, String)> {
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC;
    let master = posix_openpt(flags | OFlag::O_NONBLOCK)?;
    grantpt(&master)?;
    unlockpt(&master)?;
    let device = ptsname_r(&master)?;
    let slave = nix::fcntl::open(Path::new(&device), flags, Mode::empty())?;
    // A fresh terminal echoes, translates line ends and acts on Ctrl-C bytes.
    let mut settings = tcgetattr(&slave)?;
    cfmakeraw(&mut settings);
    tcsetattr(&slave, SetArg::TCSANOW, &settings)?;
    lock_terminal(&slave)?;
    Ok((master, slave, device))
}

#[expect(
    deprecated,
    reason = "the replacement is unsafe because of types that close or swap their descriptor; `PtyMaster` does neither, \
              and posebridge has no unsafe code"
)]
fn register(master: PtyMaster) -> io::Result<AsyncFd<PtyMaster>> {
    AsyncFd::new(master)
}

impl ByteStream for PtyStream {}

impl AsyncRead for PtyStream {
    fn poll_read(self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        loop {
            let mut guard = ready!(self.master.poll_read_ready(cx))?;
            let unfilled = buffer.initialize_unfilled();
            if let Ok(result) = guard.try_io(|master| master.get_ref().read(unfilled)) {
                return Poll::Ready(result.map(|count| buffer.advance(count)));
            }
        }
    }
}

impl AsyncWrite for PtyStream {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        loop {
            let mut guard = ready!(self.master.poll_write_ready(cx))?;
            if let Ok(result) = guard.try_io(|master| master.get_ref().write(bytes)) {
                return Poll::Ready(result);
            }
        }
    }

    fn poll_flush(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

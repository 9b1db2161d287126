//! Pseudo-terminals that this program creates, so that the simulated brick looks like a serial port.
//!
//! The terminal's device number changes with every run, so a symbolic link gives it a fixed name. We keep the slave
//! side open: otherwise every moment without a reader would look like a hang-up. The buffer then fills when there is no reader,
//! so frames that do not fit are dropped and counted instead of queued, except commands. Readers that come late find up to 16 KiB
//! of old bytes; our own serial transport discards them. The fill level cannot be queried (Linux answers 0), so a pseudo-terminal
//! that imitates a slow line needs the `rate` option.
//!
//! # The name
//! Two programs must not take a name from each other, but a link that a killed program left behind must not block the
//! name. The device number behind such a link proves nothing: the system reuses it for the next terminal. So the maker
//! of a terminal locks the slave side, and the kernel drops the lock with the last descriptor, however the maker ends.
//! It is a lock of the open file description, which does not collide with the `flock` of a serial port's user. Links of
//! foreign programs, which set no such lock, are not protected.

use std::fs::Metadata;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::libc;
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::stat::Mode;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::connection::Connection;
use crate::error::{FileKind, OpenError};
use crate::stream::{ByteStream, StreamConnection, StreamLabel};
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

/// Where Linux keeps the devices of pseudo-terminals.
pub(super) const PTS_DIRECTORY: &str = "/dev/pts";

/// The symbolic link to a terminal, removed on drop if it is still ours.
struct DeviceSymlink {
    path: PathBuf,
    device: PathBuf,
}

impl DeviceSymlink {
    /// Names `device`, whose slave side is [marked](lock_terminal), `path`.
    ///
    /// # Errors
    /// There is no such directory, or `path` exists and must not be replaced.
    fn new(path: &Path, device: &Path) -> Result<Self, OpenError> {
        check_directory(path)?;
        // A free name is taken in one step, so of two programs that start together only one gets it.
        let made = match symlink(device, path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                check_replaceable(path, device)?;
                replace_symlink(path, device)
            }
            made => made,
        };
        made.map_err(|source| OpenError::Io { what: format!("a pseudo-terminal at {}", path.display()), source })?;
        Ok(Self { path: path.to_owned(), device: device.to_owned() })
    }
}

impl Drop for DeviceSymlink {
    fn drop(&mut self) {
        if std::fs::read_link(&self.path).is_ok_and(|target| target == self.device) {
            // A drop cannot report; the next run replaces a link that stays behind.
            drop(std::fs::remove_file(&self.path));
        }
    }
}

/// Marks this terminal as in use for other programs, until `slave` is closed.
fn lock_terminal(slave: &OwnedFd) -> io::Result<()> {
    fcntl(slave.as_fd(), FcntlArg::F_OFD_SETLK(&entire_file_lock()))?;
    Ok(())
}

/// True if the terminal at `path` is in use, or if that cannot be determined.
fn is_terminal_locked(path: &Path) -> bool {
    let flags = OFlag::O_RDONLY | OFlag::O_NOCTTY | OFlag::O_NONBLOCK | OFlag::O_CLOEXEC;
    match nix::fcntl::open(path, flags, Mode::empty()) {
        Ok(terminal) => {
            let mut found = entire_file_lock();
            let lock_query = fcntl(terminal.as_fd(), FcntlArg::F_OFD_GETLK(&mut found));
            lock_query.is_err() || found.l_type != libc::F_UNLCK as libc::c_short
        }
        // The device is closed, or only its master is.
        Err(error) => ![Errno::ENOENT, Errno::EIO, Errno::ENXIO].contains(&error),
    }
}

/// A write lock from the first byte to the last.
const fn entire_file_lock() -> libc::flock {
    libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: 0,
        l_len: 0,
        l_pid: 0,
    }
}

fn check_directory(path: &Path) -> Result<(), OpenError> {
    let directory = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    if directory.is_dir() {
        return Ok(());
    }
    Err(OpenError::FileNotFound { path: directory.to_owned(), advice: "create the directory first" })
}

/// Refuses to replace anything but a stale link to a pseudo-terminal.
fn check_replaceable(path: &Path, device: &Path) -> Result<(), OpenError> {
    let Ok(metadata) = path.symlink_metadata() else {
        return Ok(());
    };
    let target = std::fs::read_link(path).unwrap_or_default();
    let names_terminal = target.starts_with(PTS_DIRECTORY);
    // The number of a dead terminal may have come to us, or to another living brick after the link was made.
    let is_stale = target == device || is_newer_than_link(&target, &metadata);
    if names_terminal && !is_stale && is_terminal_locked(path) {
        return Err(OpenError::PtyInUse { path: path.to_owned() });
    }
    if names_terminal || (metadata.is_symlink() && !path.exists()) {
        return Ok(());
    }
    Err(OpenError::WrongFileKind {
        path: path.to_owned(),
        found: FileKind::from(metadata.file_type()),
        expected: "a link that may be replaced",
    })
}

/// True if the terminal is newer than the link that names it: then the device number has been reused.
fn is_newer_than_link(terminal: &Path, link: &Metadata) -> bool {
    let made = |metadata: &Metadata| (metadata.ctime(), metadata.ctime_nsec());
    std::fs::metadata(terminal).is_ok_and(|terminal| made(&terminal) > made(link))
}

/// Makes the link under another name first and renames it, so that the path always exists.
fn replace_symlink(path: &Path, device: &Path) -> io::Result<()> {
    let mut draft = path.as_os_str().to_owned();
    draft.push(format!(".{}.new", std::process::id()));
    let draft = PathBuf::from(draft);
    symlink(device, &draft)?;
    std::fs::rename(&draft, path).inspect_err(|_error| {
        // The rename's error is the one to report; a draft that stays behind does no harm.
        drop(std::fs::remove_file(&draft));
    })
}

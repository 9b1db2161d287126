//! Pseudo-terminals of our own making: how the simulated brick looks like a serial port.
//!
//! The terminal's device has a number that changes with every run, so a symbolic link gives it a name. We keep the
//! slave side open ourselves: otherwise every moment without a reader would look like a hang-up. Since the buffer then
//! fills when nobody reads, frames that do not fit are dropped and counted instead of queued. Readers that come late
//! find up to 16 KiB of old bytes; our own serial transport discards them.

use std::io::{self, Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use nix::fcntl::OFlag;
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::stat::Mode;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::connection::Connection;
use crate::error::{FileKind, OpenError};
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::{OpenFuture, OpenRequest, Transport};
use crate::url::TargetKind;

/// Where Linux keeps the devices of pseudo-terminals.
const PTS_DIRECTORY: &str = "/dev/pts";

/// Whole frames that wait for a reader: none, because what waits here is out of date when the reader comes.
const QUEUE_BYTES: usize = 0;

/// See the module.
pub(crate) struct Pty;

impl Transport for Pty {
    fn scheme(&self) -> &'static str {
        "pty"
    }
    fn summary(&self) -> &'static str {
        "a pseudo-terminal that we make: others open the path like a serial port"
    }
    fn example(&self) -> &'static str {
        "pty:brick.tty"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Path
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(async move { open(&request).await })
    }
}

async fn open(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let path = request.url.path();
    check_link(path)?;
    let failed = |source| OpenError::Io {
        what: format!("a pseudo-terminal at {}", path.display()),
        source,
    };
    let (stream, device) = PtyStream::new(path).map_err(failed)?;
    // The reactor learns that the terminal takes data; without it the very first frame would be dropped.
    drop(stream.master.writable().await.map_err(failed)?);
    let detail = format!("{} is {device}", path.display());
    Ok(Box::new(StreamConnection::new(
        stream,
        StreamLabel::new(detail),
        request.timer,
        QUEUE_BYTES,
    )))
}

/// Refuses to replace anything but a link that a pseudo-terminal has left behind.
fn check_link(path: &Path) -> Result<(), OpenError> {
    let directory = match path.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    if !directory.is_dir() {
        return Err(OpenError::NoSuchFile {
            path: directory.to_owned(),
            advice: "create the directory first",
        });
    }
    let Ok(metadata) = path.symlink_metadata() else {
        return Ok(());
    };
    let is_ours = std::fs::read_link(path)
        .is_ok_and(|target| target.starts_with(PTS_DIRECTORY) || !path.exists());
    if is_ours {
        return Ok(());
    }
    Err(OpenError::WrongKind {
        path: path.to_owned(),
        found: FileKind::from(metadata.file_type()),
        wanted: "a link that may be replaced",
    })
}

/// The master side, with everything that has to live as long as it does.
struct PtyStream {
    // Dropped first, so that the name is gone before the device.
    _link: DeviceLink,
    master: AsyncFd<PtyMaster>,
    // Keeps the line up and its raw mode alive while nobody else has it open.
    _slave: OwnedFd,
}

impl PtyStream {
    fn new(path: &Path) -> io::Result<(Self, String)> {
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
        let stream = Self {
            _link: DeviceLink::new(path, Path::new(&device))?,
            master: register(master)?,
            _slave: slave,
        };
        Ok((stream, device))
    }
}

#[expect(
    deprecated,
    reason = "the replacement is unsafe because of types that close or swap their descriptor; `PtyMaster` does neither, \
              and this house has no unsafe code"
)]
fn register(master: PtyMaster) -> io::Result<AsyncFd<PtyMaster>> {
    AsyncFd::new(master)
}

impl AsyncRead for PtyStream {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
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
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
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

/// The name of the terminal, removed on drop if it is still ours.
struct DeviceLink {
    path: PathBuf,
    device: PathBuf,
}

impl DeviceLink {
    /// Makes the link under another name first and renames it, so that nobody ever finds the path missing.
    fn new(path: &Path, device: &Path) -> io::Result<Self> {
        let mut draft = path.as_os_str().to_owned();
        draft.push(format!(".{}.new", std::process::id()));
        let draft = PathBuf::from(draft);
        symlink(device, &draft)?;
        if let Err(error) = std::fs::rename(&draft, path) {
            // The rename's error is the one to tell; a draft that stays behind harms nobody.
            drop(std::fs::remove_file(&draft));
            return Err(error);
        }
        Ok(Self {
            path: path.to_owned(),
            device: device.to_owned(),
        })
    }
}

impl Drop for DeviceLink {
    fn drop(&mut self) {
        if std::fs::read_link(&self.path).is_ok_and(|target| target == self.device) {
            // A drop cannot report; the next run replaces a link that stays behind.
            drop(std::fs::remove_file(&self.path));
        }
    }
}

//! The symbolic link that names a pseudo-terminal of ours.
//!
//! Two programs must not take a name from each other, but a link that a killed program left behind must not block the
//! name. The device number behind such a link proves nothing: the system reuses it for the next terminal. So the maker
//! of a terminal locks the slave side, and the kernel drops the lock with the last descriptor, however the maker ends.
//! It is a lock of the open file description, which does not collide with the `flock` of a serial port's user. Links of
//! foreign programs, which set no such lock, are not protected.

use std::fs::Metadata;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::libc;
use nix::sys::stat::Mode;

use crate::error::{FileKind, OpenError};

/// Where Linux keeps the devices of pseudo-terminals.
const PTS_DIRECTORY: &str = "/dev/pts";

/// The symbolic link to a terminal, removed on drop if it is still ours.
pub(super) struct DeviceSymlink {
    path: PathBuf,
    device: PathBuf,
}

impl DeviceSymlink {
    /// Names `device`, whose slave side is [marked](mark_held), `path`.
    ///
    /// # Errors
    /// There is no such directory, or `path` exists and must not be replaced.
    pub(super) fn new(path: &Path, device: &Path) -> Result<Self, OpenError> {
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
pub(super) fn lock_terminal(slave: &OwnedFd) -> io::Result<()> {
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

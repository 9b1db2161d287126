//! Why a link did not open, and why it was lost.
//!
//! The messages name the fault, the path or address, and what to do about it.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use thiserror::Error;

/// Why a link did not open.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OpenError {
    #[error("permission denied on {what}: {advice}")]
    PermissionDenied {
        /// The path or the address.
        what: String,
        advice: String,
    },
    #[error("port {} is in use by another program: close it there (`fuser -v {}` names it)", .path.display(), .path.display())]
    PortInUse { path: PathBuf },
    #[error("address {address} is already in use: stop the program that listens there or choose another port")]
    AddressInUse { address: SocketAddr },
    #[error("address {address} belongs to no interface of this computer: 0.0.0.0 (or [::]) listens on all of them")]
    AddressNotAvailable { address: SocketAddr },
    #[error("{url} names no host to dial: put one before the port")]
    NoHost { url: String },
    #[error(
        "{url} names no serial number: add `?serial=` and the twelve digits that stand on the brick under Brick Info"
    )]
    NoSerialNumber { url: String },
    #[error(
        "{peer} does not accept the serial number {serial_number}: compare it with what stands on the brick under Brick Info"
    )]
    SerialNumberRejected {
        /// Host and port.
        peer: String,
        serial_number: String,
    },
    #[error(
        "{} is the pseudo-terminal of another program that is still running: stop that program (`fuser -v {}` names it) or choose another path",
        .path.display(),
        .path.display()
    )]
    PtyInUse { path: PathBuf },
    #[error("{} is {found}, not {expected}", .path.display())]
    WrongFileKind {
        path: PathBuf,
        found: FileKind,
        /// What the transport needs.
        expected: &'static str,
    },
    #[error("{} does not exist: {advice}", .path.display())]
    FileNotFound { path: PathBuf, advice: &'static str },
    #[error("{} is not there: plug the device in or check the name", .path.display())]
    DeviceMissing { path: PathBuf },
    #[error("host `{host}` has no address: {source}")]
    UnknownHost { host: String, source: io::Error },
    #[error("no connection to {peer}: {source}")]
    Unreachable {
        /// Host and port.
        peer: String,
        source: io::Error,
    },
    #[error("{url}: {reason}")]
    CameraRefused { url: String, reason: String },
    #[error("{what} did not open within {limit_secs} s")]
    TimedOut { what: String, limit_secs: u64 },
    #[error("{what} is not built into this program: {advice}")]
    TransportNotBuilt {
        what: &'static str,
        /// How to get it, and what to use without it.
        advice: &'static str,
    },
    #[error("cannot open {what}: {source}")]
    Io {
        /// The path or the address.
        what: String,
        source: io::Error,
    },
}

impl OpenError {
    /// True if waiting may help: a device that is not plugged in yet, a server that is not started yet. False if a
    /// person has to change something first.
    pub const fn is_transient(&self) -> bool {
        match self {
            Self::PermissionDenied { .. }
            | Self::AddressInUse { .. }
            | Self::AddressNotAvailable { .. }
            | Self::NoHost { .. }
            | Self::NoSerialNumber { .. }
            | Self::PtyInUse { .. }
            | Self::WrongFileKind { .. }
            | Self::TransportNotBuilt { .. }
            | Self::CameraRefused { .. }
            | Self::FileNotFound { .. } => false,
            Self::PortInUse { .. }
            | Self::DeviceMissing { .. }
            | Self::UnknownHost { .. }
            | Self::Unreachable { .. }
            | Self::SerialNumberRejected { .. }
            | Self::TimedOut { .. }
            | Self::Io { .. } => true,
        }
    }

    /// True if the program should not start: the error is permanent, or another program uses the serial port. At the start that
    /// is a mistake; later the other program may only probe a device that has just been plugged in again, and the link waits.
    pub const fn prevents_start(&self) -> bool {
        matches!(self, Self::PortInUse { .. }) || !self.is_transient()
    }
}

/// The kind of a file that exists already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    Directory,
    RegularFile,
    /// A symbolic link that must not be replaced.
    SymbolicLink,
    /// A socket, a pipe, a block device or a character device.
    Special,
}

impl From<std::fs::FileType> for FileKind {
    fn from(file_type: std::fs::FileType) -> Self {
        if file_type.is_dir() {
            Self::Directory
        } else if file_type.is_file() {
            Self::RegularFile
        } else if file_type.is_symlink() {
            Self::SymbolicLink
        } else {
            Self::Special
        }
    }
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Directory => "a directory",
            Self::RegularFile => "a regular file",
            Self::SymbolicLink => "a symbolic link to something else",
            Self::Special => "a device, a pipe or a socket",
        })
    }
}

/// Why an open link was lost.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum LinkError {
    #[error("the other end is gone (unplugged, switched off or closed)")]
    HungUp,
    #[error("{host} is no longer {from}, and is silent there")]
    HostMoved { host: String, from: SocketAddr },
    #[error("the camera's pictures have ended: {0}")]
    Camera(String),
    #[error("reading or writing failed: {0}")]
    Io(#[from] io::Error),
}

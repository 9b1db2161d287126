//! What every transport's `open` shares: the request, the deadline, host names and errors.

use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use crate::error::OpenError;
use crate::host_timer::HostTimer;
use crate::url::LinkUrl;

/// How long one attempt to open may take before the link is reported down, in seconds: about the default page time-out of the
/// Bluetooth Core Specification, 5.12 s.
pub(crate) const OPEN_DEADLINE_SECS: u64 = 5;

/// Most bytes in the queue of a slow link, without commands: more than five seconds of a 115200 baud line. Forwarded frames
/// may wait for that long; estimates do not, because a new one replaces the one that waits.
pub(crate) const QUEUE_BYTES: usize = 64 * 1024;

/// Linux's directories of devices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceDirectories {
    /// udev's links to serial ports, named by vendor, model and serial number.
    pub serial_by_id: PathBuf,
    /// udev's links to serial ports, named by the socket in which they are plugged.
    pub serial_by_path: PathBuf,
    /// The terminals of the system, a directory for each.
    pub tty_class: PathBuf,
    /// The settings of USB serial adapters, a directory for each.
    pub usb_serial: PathBuf,
}

impl Default for DeviceDirectories {
    fn default() -> Self {
        Self {
            serial_by_id: "/dev/serial/by-id".into(),
            serial_by_path: "/dev/serial/by-path".into(),
            tty_class: "/sys/class/tty".into(),
            usb_serial: "/sys/bus/usb-serial/devices".into(),
        }
    }
}

/// What happens to the settings of a serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LineSettingsPolicy {
    /// Set for a station and left so: the adapter's latency is shortened, and closing does not drop DTR.
    #[default]
    Keep,
    /// Only what reading needs is set, and all settings are restored when the link is closed.
    Restore,
}

/// What a UDP peer is before [`crate::Link::admit`] names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FirstContact {
    /// Trusted like all others, for programs that do not understand what they receive.
    #[default]
    Admitted,
    /// Given little, served last and forgotten first.
    Stranger,
}

/// Settings that tests and unusual systems change.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LinkTuning {
    pub device_directories: DeviceDirectories,
    pub line_settings: LineSettingsPolicy,
    pub first_contact: FirstContact,
}

/// Which end opens the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConnectRole {
    Dial,
    /// Waits for peers at the target. Devices and files are the same in both roles.
    Listen,
}

impl fmt::Display for ConnectRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dial => "dial",
            Self::Listen => "listen",
        })
    }
}

/// One attempt to open a link.
#[derive(Clone, Debug)]
pub(crate) struct OpenRequest {
    pub(crate) url: LinkUrl,
    pub(crate) role: ConnectRole,
    /// The clock of the arrival times.
    pub(crate) timer: HostTimer,
    pub(crate) tuning: LinkTuning,
    /// The [`Connection::stable_path`](crate::Connection::stable_path) of the last connection.
    pub(crate) stable_path: Option<PathBuf>,
}

/// Classifies the error of a socket that could not be bound to `address`.
pub(super) fn bind_error(address: SocketAddr, source: io::Error) -> OpenError {
    let kind = source.kind();
    if kind == io::ErrorKind::AddrInUse {
        OpenError::AddressInUse { address }
    } else if kind == io::ErrorKind::AddrNotAvailable {
        OpenError::AddressNotAvailable { address }
    } else if kind == io::ErrorKind::PermissionDenied {
        OpenError::PermissionDenied {
            what: format!("port {}", address.port()),
            advice: "ports below 1024 are reserved: choose a higher one".to_owned(),
        }
    } else {
        OpenError::Io { what: address.to_string(), source }
    }
}

/// The addresses of `host`. Without a host the loopback only, so that an omission does not open the link to the network.
pub(super) async fn resolve(host: &str, port: u16) -> Result<Vec<SocketAddr>, OpenError> {
    if host.is_empty() {
        return Ok(vec![SocketAddr::from((Ipv4Addr::LOCALHOST, port))]);
    }
    let unknown = |source| OpenError::UnknownHost { host: host.to_owned(), source };
    let addresses: Vec<_> = tokio::net::lookup_host((host, port)).await.map_err(unknown)?.collect();
    if addresses.is_empty() { Err(no_address(host)) } else { Ok(addresses) }
}

pub(super) fn no_address(host: &str) -> OpenError {
    OpenError::UnknownHost { host: host.to_owned(), source: io::ErrorKind::NotFound.into() }
}

/// The host and port of a link that dials.
pub(super) fn dialled_host(url: &LinkUrl) -> Result<(&str, u16), OpenError> {
    match url.host_and_port() {
        ("", _) => Err(OpenError::NoHost { url: url.to_string() }),
        host_and_port => Ok(host_and_port),
    }
}

pub(super) fn listening_detail(url: &LinkUrl, address: SocketAddr) -> String {
    let (host, _) = url.host_and_port();
    if host.is_empty() {
        format!(
            "listening on {address}, for this computer only: {}://0.0.0.0:{} lets others in",
            url.transport().scheme(),
            address.port()
        )
    } else {
        format!("listening on {address}")
    }
}

/// Cancels an attempt after [`OPEN_DEADLINE_SECS`].
pub(super) async fn with_deadline<T>(
    url: &LinkUrl,
    attempt: impl Future<Output = Result<T, OpenError>>,
) -> Result<T, OpenError> {
    let limit = std::time::Duration::from_secs(OPEN_DEADLINE_SECS);
    tokio::time::timeout(limit, attempt).await.unwrap_or_else(|_elapsed| Err(timeout_error(url)))
}

/// The error of an attempt that takes longer than [`OPEN_DEADLINE_SECS`].
pub(crate) fn timeout_error(url: &LinkUrl) -> OpenError {
    OpenError::TimedOut { what: url.to_string(), limit_secs: OPEN_DEADLINE_SECS }
}

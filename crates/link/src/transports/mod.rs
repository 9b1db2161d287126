//! Every way to reach a robot: the trait and the table.
//!
//! Help texts, the URL parser and the conformance tests read the table, so a transport is added by one file and one
//! line here. A transport only opens; keeping the link alive is the business of [`crate::Port`].

mod bluetooth;
mod device_link;
mod ev3;
mod file;
mod pty;
mod serial;
mod serial_device;
mod serial_line;
mod tcp;
mod tcp_server;
mod udp;
mod udp_peers;
mod udp_socket;

use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::pin::Pin;

use crate::connection::Connection;
use crate::error::OpenError;
use crate::host_timer::HostTimer;
use crate::url::{LinkUrl, OptionHelp, OptionKind, TargetKind};
pub use udp_socket::RECEIVE_BUFFER_BYTES as UDP_RECEIVE_BUFFER_BYTES;

/// Every transport. Adding one: a file in `transports/` and a line here.
pub const TRANSPORTS: &[&dyn Transport] =
    &[SERIAL, &bluetooth::Bluetooth, PTY, &tcp::Tcp, &udp::Udp, &ev3::Ev3, &file::File];

/// Serial ports, for links that are made from a path.
pub(crate) const SERIAL: &dyn Transport = &serial::Serial;
/// Pseudo-terminals of our own, for links that are made from a path.
pub(crate) const PTY: &dyn Transport = &pty::Pty;

/// How long one attempt to open may take before the link is told to be down, in seconds: about one Bluetooth page (the
/// Bluetooth Core Specification's default page time-out is 5.12 s).
pub const OPEN_DEADLINE_SECS: u64 = 5;

/// Frames that wait for a slow link, in bytes, commands aside: more than five seconds of a 115200 baud line. What is
/// passed on may wait for that long; estimates do not, since a new one replaces the one that waits.
pub(crate) const QUEUE_BYTES: usize = 64 * 1024;

/// The option that every transport has: the port keeps it, not the transport.
pub(crate) const RATE: OptionHelp = OptionHelp {
    name: "rate",
    kind: OptionKind::Integer { min: 0, max: 1_000_000_000, default: 0 },
    help: "most bytes per second that are sent, counted once per peer; 0 is no limit",
};

/// Where Linux tells of its devices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeviceDirectories {
    /// udev's links to serial ports, named by vendor, model and serial number.
    pub serial_by_id: PathBuf,
    /// udev's links to serial ports, named by the socket in which they are plugged.
    pub serial_by_path: PathBuf,
    /// The terminals of the system, a directory for each, with what is behind it.
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

/// What becomes of the settings of a serial line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LineSettings {
    /// They are made fit for a station, and stay so: the adapter's latency is shortened, and closing does not drop DTR.
    #[default]
    Keep,
    /// Only what reading needs is set, and everything is put back when the link is closed.
    PutBack,
}

/// Who calls whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Connects to the target.
    Dial,
    /// Waits for peers at the target. Devices and files are the same in both roles.
    Listen,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Dial => "dial",
            Self::Listen => "listen",
        })
    }
}

/// What is to be opened.
#[derive(Clone, Debug)]
pub struct OpenRequest {
    /// The link.
    pub url: LinkUrl,
    /// Who calls whom.
    pub role: Role,
    /// Stamps the arrivals.
    pub timer: HostTimer,
    /// Where the system tells of its devices.
    pub directories: DeviceDirectories,
    /// What becomes of the settings of a serial line.
    pub line_settings: LineSettings,
    /// What the last connection said of itself: [`Connection::stable_path`].
    pub stable_path: Option<PathBuf>,
}

/// An attempt to open a link. Dropping it gives the attempt up.
pub type OpenFuture = Pin<Box<dyn Future<Output = Result<Box<dyn Connection>, OpenError>> + Send + 'static>>;

/// One way to reach a robot.
pub trait Transport: Sync {
    /// The word before the colon.
    fn scheme(&self) -> &'static str;
    /// What it is for, one line.
    fn summary(&self) -> &'static str;
    /// A link of this kind as somebody would write it.
    fn example(&self) -> &'static str;
    /// Whether its target is a path or a network address.
    fn target_kind(&self) -> TargetKind;
    /// The options that may follow the question mark; `rate` is among them, because the port keeps it for every
    /// transport.
    fn options(&self) -> &'static [OptionHelp] {
        &[RATE]
    }
    /// True if each delivered chunk is one datagram, so that no frame crosses two of them.
    fn is_datagram(&self) -> bool {
        false
    }
    /// Starts to open a link. Needs a runtime with IO and time enabled when polled.
    fn open(&self, request: OpenRequest) -> OpenFuture;
}

impl fmt::Debug for dyn Transport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.scheme())
    }
}

/// Says why a socket could not be bound to `address`.
fn bind_error(address: SocketAddr, source: io::Error) -> OpenError {
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

/// The addresses of `host`; without one this computer alone, so that nobody lets the network in by leaving something
/// out.
async fn resolve(host: &str, port: u16) -> Result<Vec<SocketAddr>, OpenError> {
    if host.is_empty() {
        return Ok(vec![SocketAddr::from((Ipv4Addr::LOCALHOST, port))]);
    }
    let unknown = |source| OpenError::UnknownHost { host: host.to_owned(), source };
    let addresses: Vec<_> = tokio::net::lookup_host((host, port)).await.map_err(unknown)?.collect();
    if addresses.is_empty() {
        return Err(unknown(io::ErrorKind::NotFound.into()));
    }
    Ok(addresses)
}

/// What is said about an address on which a link listens.
fn listening_detail(url: &LinkUrl, address: SocketAddr) -> String {
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

/// Gives an attempt up after [`OPEN_DEADLINE_SECS`].
async fn with_deadline<T>(url: &LinkUrl, attempt: impl Future<Output = Result<T, OpenError>>) -> Result<T, OpenError> {
    let limit = std::time::Duration::from_secs(OPEN_DEADLINE_SECS);
    tokio::time::timeout(limit, attempt).await.unwrap_or_else(|_elapsed| Err(timed_out(url)))
}

/// What is said about an attempt that takes longer than [`OPEN_DEADLINE_SECS`].
pub(crate) fn timed_out(url: &LinkUrl) -> OpenError {
    OpenError::TimedOut { what: url.to_string(), limit_secs: OPEN_DEADLINE_SECS }
}

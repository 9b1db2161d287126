//! Opening links: one file for each transport. [`crate::Link`] keeps the opened connection alive.

mod bluetooth;
mod ev3;
mod file;
mod host_name;
mod open_request;
mod pty;
mod serial;
mod serial_device;
mod tcp;
mod udp;
mod udp_peers;
mod udp_socket;

use std::pin::Pin;

use crate::connection::Connection;
use crate::error::OpenError;
use crate::transport::Transport;
pub use open_request::{ConnectRole, DeviceDirectories, FirstContact, LineSettingsPolicy, LinkTuning};
pub(crate) use open_request::{OPEN_DEADLINE_SECS, OpenRequest, QUEUE_BYTES, timeout_error};
pub use udp_socket::RECEIVE_BUFFER_BYTES as UDP_RECEIVE_BUFFER_BYTES;

/// An attempt to open a link. Dropping it cancels the attempt.
pub type OpenFuture = Pin<Box<dyn Future<Output = Result<Box<dyn Connection>, OpenError>> + Send + 'static>>;

/// Starts to open a link. Needs a runtime with IO and time enabled when polled.
pub(crate) fn open(request: OpenRequest) -> OpenFuture {
    match request.url.transport() {
        Transport::Serial => Box::pin(serial::open(request)),
        Transport::Bluetooth => Box::pin(bluetooth::open(request)),
        Transport::Pty => Box::pin(pty::open(request)),
        Transport::Tcp => Box::pin(tcp::open(request)),
        Transport::Udp => Box::pin(udp::open(request)),
        Transport::Ev3 => Box::pin(ev3::open(request)),
        // Regular files on a local disk answer without delay, so this needs no thread of its own.
        Transport::File => Box::pin(std::future::ready(file::open(&request))),
        Transport::Camera => Box::pin(std::future::ready(Err(OpenError::TransportNotBuilt {
            what: "a camera",
            advice: "only `posebridge run` of a build with the feature `camera` takes its pictures",
        }))),
    }
}

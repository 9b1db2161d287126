//! Bluetooth Classic serial ports (RFCOMM), opened by the device's address, without binding a `/dev/rfcomm0` first.
//!
//! LEGO's NXT and EV3 and the HC-05 modules of Arduino-class boards use it. Pairing is done by the desktop: a device
//! refuses an address with which it was never paired. Only built with the cargo feature `bluetooth`; it needs Linux's
//! Bluetooth sockets and no D-Bus. Without the feature the URL still parses, and the error tells how to build with it.

use crate::error::OpenError;
use crate::transports::open_request::OpenRequest;

pub(super) use radio::open;

#[cfg(not(feature = "bluetooth"))]
mod radio {
    use super::{OpenError, OpenRequest};
    use crate::connection::Connection;

    pub(in crate::transports) fn open(
        _request: OpenRequest,
    ) -> std::future::Ready<Result<Box<dyn Connection>, OpenError>> {
        std::future::ready(Err(OpenError::TransportNotBuilt {
            what: "Bluetooth",
            advice: "build it with the feature `bluetooth`, or bind the device with \
                     `sudo rfcomm bind 0 ADDRESS` and use serial:///dev/rfcomm0",
        }))
    }
}

#[cfg(feature = "bluetooth")]
mod radio {
    use std::io;

    use bluer::Address;
    use bluer::rfcomm::{SocketAddr, Stream};

    use super::{OpenError, OpenRequest};
    use crate::connection::Connection;
    use crate::stream::{ByteStream, StreamConnection, StreamLabel};
    use crate::transport::CHANNEL;
    use crate::transports::open_request::{QUEUE_BYTES, with_deadline};
    use crate::url::{BluetoothAddress, Target};

    // The fill level of these sockets is not used, because older kernels report the *free* space instead (bt_sock_ioctl,
    // TIOCOUTQ); `rate` bounds it.
    impl ByteStream for Stream {}

    pub(in crate::transports) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
        let address = match request.url.target() {
            Target::Bluetooth(address) => *address,
            Target::Path(_) | Target::Host { .. } => BluetoothAddress([0; 6]),
        };
        let channel = request.url.integer(&CHANNEL);
        let socket = SocketAddr {
            addr: Address(address.0),
            // The table allows 1 to 30.
            channel: channel as u8,
        };
        let attempt = async {
            let connected = Stream::connect(socket).await;
            connected.map_err(|error| name_error(address, error))
        };
        let stream = with_deadline(&request.url, attempt).await?;
        let detail = format!("connected to {address}, channel {channel}");
        Ok(Box::new(StreamConnection::new(stream, StreamLabel::new(detail), request.timer, QUEUE_BYTES)))
    }

    /// Classifies an error. All of them may go away: a radio is plugged in, a brick is switched on or paired.
    fn name_error(address: BluetoothAddress, source: io::Error) -> OpenError {
        // The standard library has no kinds for these two.
        let lacks_radio = [nix::libc::EAFNOSUPPORT, nix::libc::ENODEV];
        if source.raw_os_error().is_some_and(|code| lacks_radio.contains(&code)) {
            return OpenError::Io {
                what: format!("{address}: this computer has no Bluetooth radio that is switched on"),
                source,
            };
        }
        OpenError::Unreachable { peer: address.to_string(), source }
    }
}

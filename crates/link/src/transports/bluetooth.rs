//! Bluetooth Classic serial ports (RFCOMM), dialled by address, without a `/dev/rfcomm0` that somebody has to bind first.
//!
//! LEGO's NXT and EV3 and the HC-05 modules of Arduino-class boards speak it. Pairing is the desktop's business: an
//! address that has never been paired is refused by the device. Only built with the cargo feature `bluetooth`; it needs
//! Linux's own Bluetooth sockets and no D-Bus. Without the feature the scheme is still known, and says how to get it.

use crate::error::OpenError;
use crate::transports::{OpenFuture, OpenRequest, RATE, Transport};
use crate::url::{OptionHelp, OptionKind, TargetKind};

/// The RFCOMM channel. RFCOMM has the channels 1 to 30 (Bluetooth RFCOMM specification, section 5.4); NXT, EV3 and HC-05
/// listen on the first.
const CHANNEL: OptionHelp = OptionHelp {
    name: "channel",
    kind: OptionKind::Integer { min: 1, max: 30, default: 1 },
    help: "RFCOMM channel of the device",
};

/// See the module.
pub(crate) struct Bluetooth;

impl Transport for Bluetooth {
    fn scheme(&self) -> &'static str {
        "bluetooth"
    }
    fn summary(&self) -> &'static str {
        "a paired Bluetooth device by its address; needs a program built with `--features bluetooth`"
    }
    fn example(&self) -> &'static str {
        "bluetooth://00:16:53:AA:BB:CC?channel=1"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Bluetooth
    }
    fn options(&self) -> &'static [OptionHelp] {
        &[CHANNEL, RATE]
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(radio::open(request))
    }
}

#[cfg(not(feature = "bluetooth"))]
mod radio {
    use super::{OpenError, OpenRequest};
    use crate::connection::Connection;

    pub(super) fn open(_request: OpenRequest) -> std::future::Ready<Result<Box<dyn Connection>, OpenError>> {
        std::future::ready(Err(OpenError::NotBuilt {
            what: "Bluetooth",
            advice: "build it with `cargo build --release --features bluetooth`, or bind the device with \
                     `sudo rfcomm bind 0 ADDRESS` and use serial:///dev/rfcomm0",
        }))
    }
}

#[cfg(feature = "bluetooth")]
mod radio {
    use std::io;

    use bluer::Address;
    use bluer::rfcomm::{SocketAddr, Stream};

    use super::{CHANNEL, OpenError, OpenRequest};
    use crate::connection::Connection;
    use crate::stream::{ByteStream, StreamConnection, StreamLabel};
    use crate::transports::{QUEUE_BYTES, with_deadline};
    use crate::url::{BluetoothAddress, Target};

    // The sockets answer how much lies in them, but older kernels say how much is *free* there (bt_sock_ioctl, TIOCOUTQ),
    // so they are not asked; `rate` bounds it.
    impl ByteStream for Stream {}

    pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
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

    /// Says what is wrong; all of it may heal: a radio is plugged in, a brick is switched on or paired.
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

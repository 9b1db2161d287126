//! An EV3 in the wireless network: found by what it announces, and opened by its serial number. Then the same telegrams pass
//! as over Bluetooth.
//!
//! # Model
//! ```text
//! listen   the brick announces itself to UDP 3015, each few seconds; one datagram goes back to it, and it opens its TCP port
//! dial     its address is known, its serial number given; a brick that was found once keeps its port open until it is switched off
//! both     TCP: GET /target?sn=<serial number>VMTP1.0\nProtocol: EV3      answer: Accept:EV340 and two line ends
//! ```
//!
//! # Sources
//! LEGO MINDSTORMS EV3 Communication Developer Kit, section 6 (WiFi); ev3-dc 0.9.10.2, which finds and opens bricks so.

mod announcement;

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use self::announcement::{Announcement, LONGEST};
use crate::connection::Connection;
use crate::error::OpenError;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::udp_socket::bind_first;
use crate::transports::{OpenFuture, OpenRequest, QUEUE_BYTES, RATE, Role, Transport, resolve, tcp, with_deadline};
use crate::url::{OptionHelp, OptionKind, TargetKind};

/// Which brick.
const SERIAL: OptionHelp = OptionHelp {
    name: "serial",
    kind: OptionKind::HexDigits { count: 12 },
    help: "the brick's serial number, on the brick under Brick Info; a link that listens takes any brick without it",
};

/// What an opened brick says, before two line ends.
const ACCEPTED: &[u8] = b"Accept:EV340";
/// Most bytes that are waited for before a brick counts as something else.
const LONGEST_WELCOME: usize = 64;
/// Behind its answer the brick is silent until it is asked; line ends that have not come by then do not come.
const LINE_ENDS_WITHIN: Duration = Duration::from_millis(200);
/// What goes back to a brick that announced itself; what stands in it does not matter.
const HEARD: &[u8] = b"\0";

/// See the module.
pub(crate) struct Ev3;

/// A brick whose door is known.
struct Door {
    address: SocketAddr,
    serial_number: String,
    /// How people call it.
    name: String,
}

impl Transport for Ev3 {
    fn scheme(&self) -> &'static str {
        "ev3"
    }
    fn summary(&self) -> &'static str {
        "an EV3 by WiFi: listens for one that announces itself, or dials one by address and serial number"
    }
    fn example(&self) -> &'static str {
        "ev3://0.0.0.0:3015"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Host
    }
    fn options(&self) -> &'static [OptionHelp] {
        &[SERIAL, RATE]
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(async move {
            match request.role {
                Role::Dial => with_deadline(&request.url, dial(&request)).await,
                Role::Listen => {
                    // As long as it takes: somebody has to switch the brick on.
                    let door = announced(&request).await?;
                    with_deadline(&request.url, open_door(&request, door)).await
                }
            }
        })
    }
}

async fn dial(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let serial_number = request.url.option_text(&SERIAL);
    let (host, port) = request.url.host_and_port();
    if host.is_empty() {
        return Err(OpenError::NoHost { url: request.url.to_string() });
    }
    if serial_number.is_empty() {
        return Err(OpenError::NoSerialNumber { url: request.url.to_string() });
    }
    let address = *resolve(host, port)
        .await?
        .first()
        .ok_or_else(|| OpenError::UnknownHost { host: host.to_owned(), source: io::ErrorKind::NotFound.into() })?;
    let door = Door { address, name: format!("the EV3 {serial_number}"), serial_number };
    open_door(request, door).await
}

/// Waits for a brick that may be opened to announce itself, and answers it.
async fn announced(request: &OpenRequest) -> Result<Door, OpenError> {
    let wanted = request.url.option_text(&SERIAL);
    let (host, port) = request.url.host_and_port();
    let (socket, local) = bind_first(&resolve(host, port).await?)?;
    let failed = |source| OpenError::Io { what: local.to_string(), source };
    let mut datagram = [0; LONGEST];
    loop {
        let (length, from) = socket.recv_from(&mut datagram).await.map_err(failed)?;
        let Some(brick) = Announcement::of(datagram.get(..length).unwrap_or_default()) else {
            tracing::debug!(%from, length, "no announcement of an EV3");
            continue;
        };
        if !wanted.is_empty() && !brick.serial_number.eq_ignore_ascii_case(&wanted) {
            tracing::debug!(%from, serial = brick.serial_number, "another EV3");
            continue;
        }
        socket.send_to(HEARD, from).await.map_err(failed)?;
        return Ok(Door {
            address: SocketAddr::new(from.ip(), brick.port),
            name: format!("the EV3 `{}` ({})", brick.name, brick.serial_number),
            serial_number: brick.serial_number,
        });
    }
}

async fn open_door(request: &OpenRequest, door: Door) -> Result<Box<dyn Connection>, OpenError> {
    let peer = door.address;
    let unreachable = |source| OpenError::Unreachable { peer: peer.to_string(), source };
    let mut stream = TcpStream::connect(peer).await.map_err(unreachable)?;
    tcp::configure(&stream).map_err(unreachable)?;
    let opening = format!("GET /target?sn={}VMTP1.0\nProtocol: EV3", door.serial_number);
    stream.write_all(opening.as_bytes()).await.map_err(unreachable)?;
    if !is_welcome(&mut stream).await.map_err(unreachable)? {
        return Err(OpenError::NotWelcome { peer: peer.to_string(), serial_number: door.serial_number });
    }
    let mut label = StreamLabel::new(format!("connected to {} at {peer}", door.name));
    label.local_address = stream.local_addr().ok();
    Ok(Box::new(StreamConnection::new(stream, label, request.timer, QUEUE_BYTES)))
}

/// Reads the brick's answer with its line ends, so that nothing of it is left for who reads telegrams.
async fn is_welcome(stream: &mut TcpStream) -> io::Result<bool> {
    let mut welcome = Vec::with_capacity(LONGEST_WELCOME);
    while welcome.len() < LONGEST_WELCOME {
        let byte = if welcome.ends_with(ACCEPTED) || line_ends(&welcome) > 0 {
            match tokio::time::timeout(LINE_ENDS_WITHIN, stream.read_u8()).await {
                Ok(byte) => byte?,
                Err(_elapsed) => return Ok(true),
            }
        } else {
            stream.read_u8().await?
        };
        welcome.push(byte);
        if line_ends(&welcome) == 2 {
            return Ok(true);
        }
    }
    Ok(false)
}

/// How many lines end behind the answer; 0 where it has not come, or where something else follows it.
fn line_ends(welcome: &[u8]) -> usize {
    let at = welcome.windows(ACCEPTED.len()).position(|part| part == ACCEPTED);
    let Some(rest) = at.and_then(|at| welcome.get(at + ACCEPTED.len()..)) else {
        return 0;
    };
    if rest.iter().any(|byte| !byte.is_ascii_whitespace()) {
        return 0;
    }
    rest.split(|byte| *byte == b'\n').count() - 1
}

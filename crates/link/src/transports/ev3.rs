//! An EV3 in the wireless network: found by its announcement, opened by its serial number. Then the same telegrams pass
//! as over Bluetooth.
//!
//! # Model
//! ```text
//! listen   the brick announces itself to UDP 3015 every few seconds; one datagram goes back, and it opens its TCP port
//! dial     address and serial number are given; a brick that was found once keeps its port open until it is switched off
//! both     TCP: GET /target?sn=<serial number>VMTP1.0\nProtocol: EV3      answer: Accept:EV340 and two line ends
//! ```
//!
//! # Sources
//! LEGO MINDSTORMS EV3 Communication Developer Kit, section 6 (WiFi); ev3-dc 0.9.10.2, which finds and opens bricks in
//! this way.

use std::io;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::connection::Connection;
use crate::error::OpenError;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transport::SERIAL_NUMBER;
use crate::transports::open_request::{
    ConnectRole, OpenRequest, QUEUE_BYTES, dialled_host, no_address, resolve, with_deadline,
};
use crate::transports::tcp::configure;
use crate::transports::udp_socket::bind_first_available;

/// The reply of an opened brick, before two line ends.
const ACCEPT_REPLY: &[u8] = b"Accept:EV340";
/// Longest reply; a peer that sends more is no EV3.
const MAX_REPLY_BYTES: usize = 64;
/// How long to wait for the line ends after the reply; the brick sends nothing else without a request.
const LINE_END_TIMEOUT: Duration = Duration::from_millis(200);
/// The datagram that answers an announcement; its content does not matter.
const ANNOUNCEMENT_REPLY: &[u8] = b"\0";

/// An EV3 whose TCP port is open.
struct Ev3Endpoint {
    address: SocketAddr,
    serial_number: String,
    name: String,
}

pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    match request.role {
        ConnectRole::Dial => with_deadline(&request.url, dial(&request)).await,
        ConnectRole::Listen => {
            // No deadline: the brick has to be switched on.
            let brick = wait_for_announcement(&request).await?;
            with_deadline(&request.url, open_session(&request, brick)).await
        }
    }
}

async fn dial(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let serial_number = request.url.option_text(&SERIAL_NUMBER);
    let (host, port) = dialled_host(&request.url)?;
    if serial_number.is_empty() {
        return Err(OpenError::NoSerialNumber { url: request.url.to_string() });
    }
    let address = *resolve(host, port).await?.first().ok_or_else(|| no_address(host))?;
    let brick = Ev3Endpoint { address, name: format!("the EV3 {serial_number}"), serial_number };
    open_session(request, brick).await
}

/// Waits for a brick that may be opened to announce itself, and answers it.
async fn wait_for_announcement(request: &OpenRequest) -> Result<Ev3Endpoint, OpenError> {
    let serial_number = request.url.option_text(&SERIAL_NUMBER);
    let (host, port) = request.url.host_and_port();
    let (socket, local) = bind_first_available(&resolve(host, port).await?)?;
    let failed = |source| OpenError::Io { what: local.to_string(), source };
    let mut datagram = [0; MAX_ANNOUNCEMENT_BYTES];
    loop {
        let (length, from) = socket.recv_from(&mut datagram).await.map_err(failed)?;
        let Some(brick) = Announcement::parse(datagram.get(..length).unwrap_or_default()) else {
            tracing::debug!(%from, length, "no announcement of an EV3");
            continue;
        };
        if !serial_number.is_empty() && !brick.serial_number.eq_ignore_ascii_case(&serial_number) {
            tracing::debug!(%from, serial = brick.serial_number, "another EV3");
            continue;
        }
        socket.send_to(ANNOUNCEMENT_REPLY, from).await.map_err(failed)?;
        return Ok(Ev3Endpoint {
            address: SocketAddr::new(from.ip(), brick.port),
            name: format!("the EV3 `{}` ({})", brick.name, brick.serial_number),
            serial_number: brick.serial_number,
        });
    }
}

async fn open_session(request: &OpenRequest, brick: Ev3Endpoint) -> Result<Box<dyn Connection>, OpenError> {
    let peer = brick.address;
    let unreachable = |source| OpenError::Unreachable { peer: peer.to_string(), source };
    let mut stream = TcpStream::connect(peer).await.map_err(unreachable)?;
    configure(&stream).map_err(unreachable)?;
    let opening = format!("GET /target?sn={}VMTP1.0\nProtocol: EV3", brick.serial_number);
    stream.write_all(opening.as_bytes()).await.map_err(unreachable)?;
    if !read_accept_reply(&mut stream).await.map_err(unreachable)? {
        return Err(OpenError::SerialNumberRejected { peer: peer.to_string(), serial_number: brick.serial_number });
    }
    let mut label = StreamLabel::new(format!("connected to {} at {peer}", brick.name));
    label.local_address = stream.local_addr().ok();
    Ok(Box::new(StreamConnection::new(stream, label, request.timer, QUEUE_BYTES)))
}

/// Reads the brick's answer with its line ends, so that nothing of it is left for the reader of telegrams.
async fn read_accept_reply(stream: &mut TcpStream) -> io::Result<bool> {
    let mut welcome = Vec::with_capacity(MAX_REPLY_BYTES);
    while welcome.len() < MAX_REPLY_BYTES {
        let byte = if welcome.ends_with(ACCEPT_REPLY) || count_line_ends(&welcome) > 0 {
            match tokio::time::timeout(LINE_END_TIMEOUT, stream.read_u8()).await {
                Ok(byte) => byte?,
                Err(_elapsed) => return Ok(true),
            }
        } else {
            stream.read_u8().await?
        };
        welcome.push(byte);
        if count_line_ends(&welcome) == 2 {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Number of line ends after the answer; 0 if the answer is incomplete or other bytes follow it.
fn count_line_ends(welcome: &[u8]) -> usize {
    let at = welcome.windows(ACCEPT_REPLY.len()).position(|part| part == ACCEPT_REPLY);
    let Some(rest) = at.and_then(|at| welcome.get(at + ACCEPT_REPLY.len()..)) else {
        return 0;
    };
    if rest.iter().any(|byte| !byte.is_ascii_whitespace()) {
        return 0;
    }
    rest.split(|byte| *byte == b'\n').count() - 1
}

/// Longest announcement; real ones have some 70 bytes.
pub(super) const MAX_ANNOUNCEMENT_BYTES: usize = 512;

/// A brick that announced itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Announcement {
    /// Twelve hexadecimal digits, required to open the brick.
    pub(super) serial_number: String,
    /// The TCP port on which it listens.
    pub(super) port: u16,
    /// The name that its user gave it; may be empty.
    pub(super) name: String,
}

impl Announcement {
    /// Parses a datagram; `None` if it is not from an EV3.
    pub(super) fn parse(datagram: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(datagram.get(..MAX_ANNOUNCEMENT_BYTES).unwrap_or(datagram)).ok()?;
        let value_of = |name: &str| {
            let pairs = text.lines().filter_map(|line| line.split_once(':'));
            let mut values = pairs.filter(|(key, _)| key.trim().eq_ignore_ascii_case(name));
            values.next().map(|(_, value)| value.trim())
        };
        let serial_number = value_of("Serial-Number")?;
        let is_serial_number = !serial_number.is_empty() && serial_number.bytes().all(|byte| byte.is_ascii_hexdigit());
        let is_ev3 = value_of("Protocol")? == "EV3" && is_serial_number;
        is_ev3.then_some(Self {
            serial_number: serial_number.to_owned(),
            port: value_of("Port")?.parse().ok()?,
            name: value_of("Name").unwrap_or_default().to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DATAGRAM: &[u8] = b"Serial-Number: 0016533f0c1e\r\nPort: 5555\r\nName: EV3\r\nProtocol: EV3\r\n";

    #[test]
    fn a_brick_announces_itself() {
        let expected = Announcement { serial_number: "0016533f0c1e".to_owned(), port: 5555, name: "EV3".to_owned() };
        assert_eq!(Announcement::parse(DATAGRAM), Some(expected));
    }

    #[test]
    fn what_is_no_announcement_is_none() {
        for end in 0..DATAGRAM.len() - 2 {
            assert_eq!(Announcement::parse(&DATAGRAM[..end]), None, "{end} bytes");
        }
        let text = String::from_utf8(DATAGRAM.to_vec()).unwrap();
        for (from, to) in [
            ("5555", "99999"),
            ("0016533f0c1e", "0016 53"),
            ("Protocol: EV3", "Protocol: NXT"),
            ("Serial-Number", "Serial"),
        ] {
            let other = text.replace(from, to);
            assert_eq!(Announcement::parse(other.as_bytes()), None, "{to}");
        }
        assert_eq!(Announcement::parse(&[0xFF; 70]), None);
    }
}

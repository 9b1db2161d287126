//! TCP: a client, or with [`Role::Listen`] a server for many clients.
//!
//! Nagle's delay is off, because estimates are small and urgent. Keep-alives find out about peers that left without a
//! word, as a robot does that drives out of the access point's reach.
//!
//! Linux would let a send buffer grow to 4 MiB, which is minutes of a slow link, first in, first out. It is kept small,
//! so that what a slow peer does not take waits in our own queue, where the newest estimate replaces the one before it.
//! What the *peer* has received and not read is out of our hands: its receive buffer adds to the age of what it reads.

use std::io;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

use crate::connection::Connection;
use crate::error::OpenError;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::tcp_server::TcpServer;
use crate::transports::{OpenFuture, OpenRequest, QUEUE_BYTES, Role, Transport, resolve, with_deadline};
use crate::url::TargetKind;

/// Silence after which the system asks whether the peer is still there.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
/// Pause between such questions.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
/// Unanswered questions that make a loss.
const KEEPALIVE_RETRIES: u32 = 3;
/// Unacknowledged data that make a loss: as long as the keep-alives need.
const USER_TIMEOUT: Duration = Duration::from_secs(11);

/// Send buffer that is asked for; Linux doubles it for its own bookkeeping. It also bounds what is under way, so a peer
/// that is 20 ms away still gets 800 kB/s, a hundred times what a robot's link carries.
const SEND_BUFFER_BYTES: usize = 16 * 1024;
/// Unsent bytes above which the system takes no more (tcp(7), TCP_NOTSENT_LOWAT): one of the longest frames (280 bytes)
/// per stream of a handful, so that the line never runs dry.
const UNSENT_BYTES: u32 = 2 * 1024;

/// See the module.
pub(crate) struct Tcp;

impl Transport for Tcp {
    fn scheme(&self) -> &'static str {
        "tcp"
    }
    fn summary(&self) -> &'static str {
        "a TCP client, or a server for many clients where the link listens"
    }
    fn example(&self) -> &'static str {
        "tcp://192.168.4.1:5760"
    }
    fn target_kind(&self) -> TargetKind {
        TargetKind::Host
    }
    fn open(&self, request: OpenRequest) -> OpenFuture {
        Box::pin(async move {
            match request.role {
                Role::Dial => with_deadline(&request.url, dial(&request)).await,
                Role::Listen => TcpServer::open(&request).await,
            }
        })
    }
}

async fn dial(request: &OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    let (host, port) = request.url.host_and_port();
    if host.is_empty() {
        return Err(OpenError::NoHost { url: request.url.to_string() });
    }
    let unreachable = |source| OpenError::Unreachable { peer: format!("{host}:{port}"), source };
    let addresses = resolve(host, port).await?;
    let stream = TcpStream::connect(&addresses[..]).await.map_err(unreachable)?;
    configure(&stream).map_err(unreachable)?;
    let peer = stream.peer_addr().map_err(unreachable)?;
    let mut label = StreamLabel::new(format!("connected to {peer}"));
    label.local_address = stream.local_addr().ok();
    Ok(Box::new(StreamConnection::new(stream, label, request.timer, QUEUE_BYTES)))
}

/// Sets what both ends of our connections need.
pub(super) fn configure(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    socket.set_tcp_keepalive(
        &TcpKeepalive::new()
            .with_time(KEEPALIVE_IDLE)
            .with_interval(KEEPALIVE_INTERVAL)
            .with_retries(KEEPALIVE_RETRIES),
    )?;
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.set_tcp_notsent_lowat(UNSENT_BYTES)?;
    socket.set_tcp_user_timeout(Some(USER_TIMEOUT))
}

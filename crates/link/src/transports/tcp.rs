//! TCP: a client, or with [`Role::Listen`] a server for many clients.
//!
//! Nagle's delay is off, because estimates are small and urgent. Keep-alives find out about peers that left without a
//! word, as a robot does that drives out of the access point's reach.

use std::io;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

use crate::connection::Connection;
use crate::error::OpenError;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::tcp_server::TcpServer;
use crate::transports::{
    OpenFuture, OpenRequest, QUEUE_BYTES, Role, Transport, resolve, with_deadline,
};
use crate::url::TargetKind;

/// Silence after which the system asks whether the peer is still there.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
/// Pause between such questions.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
/// Unanswered questions that make a loss.
const KEEPALIVE_RETRIES: u32 = 3;
/// Unacknowledged data that make a loss: as long as the keep-alives need.
const USER_TIMEOUT: Duration = Duration::from_secs(11);

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
        return Err(OpenError::NoHost {
            url: request.url.to_string(),
        });
    }
    let unreachable = |source| OpenError::Unreachable {
        peer: format!("{host}:{port}"),
        source,
    };
    let addresses = resolve(host, port).await?;
    let stream = TcpStream::connect(&addresses[..])
        .await
        .map_err(unreachable)?;
    configure(&stream).map_err(unreachable)?;
    let peer = stream.peer_addr().map_err(unreachable)?;
    let mut label = StreamLabel::new(format!("connected to {peer}"));
    label.local_address = stream.local_addr().ok();
    Ok(Box::new(StreamConnection::new(
        stream,
        label,
        request.timer,
        QUEUE_BYTES,
    )))
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
    socket.set_tcp_user_timeout(Some(USER_TIMEOUT))
}

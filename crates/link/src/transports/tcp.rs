//! TCP: a client, or with [`ConnectRole::Listen`] a server for many clients.

use tokio::net::TcpStream;

use crate::connection::Connection;
use crate::error::OpenError;
use crate::stream::{StreamConnection, StreamLabel};
use crate::transports::open_request::{ConnectRole, OpenRequest, QUEUE_BYTES, resolve, with_deadline};
use crate::transports::tcp_server::TcpServer;
use crate::transports::tcp_socket::configure;

pub(super) async fn open(request: OpenRequest) -> Result<Box<dyn Connection>, OpenError> {
    match request.role {
        ConnectRole::Dial => with_deadline(&request.url, dial(&request)).await,
        ConnectRole::Listen => TcpServer::open(&request).await,
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

//! Accepts connections: a limited number at a time, each with a timeout for the head of a request.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;

use super::connection_table::{ConnectionSlot, ConnectionTable};
use crate::counters::{ServerCounter, ServerCounters};
use crate::limits::{HEAD_TIMEOUT, MAX_HEAD_BYTES, SEND_TIMEOUT, SOCKET_BUFFER_BYTES};

/// For connections beyond the limit.
const BUSY_RESPONSE: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-type: application/json\r\ncontent-length: 51\r\n\r\n\
    {\"error\":\"too many connections; close one of them\"}";
/// After a failed accept, for instance without a free file descriptor.
const RETRY_DELAY: Duration = Duration::from_millis(100);

pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    connections: Arc<ConnectionTable>,
    counts: Arc<ServerCounters>,
    stop: CancellationToken,
) {
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => return,
        };
        let Ok((stream, from)) = accepted else {
            tokio::time::sleep(RETRY_DELAY).await;
            continue;
        };
        let Some(slot) = connections.admit(from.ip()) else {
            // The client may not even read it.
            drop(stream.try_write(BUSY_RESPONSE));
            continue;
        };
        let connection = Connection { router: router.clone(), counts: Arc::clone(&counts), slot: Arc::new(slot) };
        // A connection ends by itself, or with the runtime.
        drop(tokio::spawn(connection.serve(stream)));
    }
}

struct Connection {
    router: Router,
    counts: Arc<ServerCounters>,
    /// Each request holds it; one that becomes a stream keeps it.
    slot: Arc<ConnectionSlot>,
}

impl Connection {
    async fn serve(self, stream: TcpStream) {
        let Self { router, counts, slot } = &self;
        let socket = SockRef::from(&stream);
        // If the system refuses any of these options, the connection works without.
        drop(stream.set_nodelay(true));
        drop(socket.set_send_buffer_size(SOCKET_BUFFER_BYTES));
        drop(socket.set_tcp_user_timeout(Some(SEND_TIMEOUT)));
        let has_requested = AtomicBool::new(false);
        let service = service_fn(|mut request: Request<Incoming>| {
            request.extensions_mut().insert(Arc::clone(slot));
            has_requested.store(true, Ordering::Relaxed);
            TowerToHyperService::new(router.clone()).call(request)
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_TIMEOUT)
            .max_buf_size(MAX_HEAD_BYTES)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades();
        let served = tokio::select! {
            served = connection => served,
            // Made room for another, or showed a token that was revoked. A stream ends by itself.
            () = slot.end().cancelled() => return,
        };
        // A connection that has had a request may end in any way.
        if served.is_err() && !has_requested.load(Ordering::Relaxed) {
            counts.increment(ServerCounter::BadRequest);
        }
    }
}

//! Connections: so many at a time, each with a limit on how long it may take to say what it wants.

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
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::seat::Seat;
use crate::counts::{Count, Counts};
use crate::limits::{HEAD_BYTES, HEAD_TIMEOUT, MOST_CONNECTIONS, SEND_TIMEOUT, SOCKET_BUFFER_BYTES};

/// What whoever comes too many is told.
const BUSY: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\ncontent-type: application/json\r\ncontent-length: 51\r\n\r\n\
    {\"error\":\"too many connections; close one of them\"}";
/// After a failure to take a connection, such as no free file descriptor, the next try waits so long.
const PAUSE: Duration = Duration::from_millis(100);

/// Takes connections until it is told to stop.
pub(crate) async fn serve(listener: TcpListener, router: Router, counts: Arc<Counts>, stop: CancellationToken) {
    let room = Arc::new(Semaphore::new(MOST_CONNECTIONS));
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = stop.cancelled() => return,
        };
        let Ok((stream, _)) = accepted else {
            tokio::time::sleep(PAUSE).await;
            continue;
        };
        let Some(seat) = Seat::take(&room, &counts, Count::Connections) else {
            counts.one(Count::TooManyConnections);
            // It may not even listen.
            drop(stream.try_write(BUSY));
            continue;
        };
        let connection = Connection { router: router.clone(), counts: Arc::clone(&counts), seat: Arc::new(seat) };
        // A connection ends by itself, or with the runtime.
        drop(tokio::spawn(connection.serve(stream)));
    }
}

/// One connection.
struct Connection {
    router: Router,
    counts: Arc<Counts>,
    /// Every request has it with it: one that becomes a stream keeps it.
    seat: Arc<Seat>,
}

impl Connection {
    async fn serve(self, stream: TcpStream) {
        let Self { router, counts, seat } = &self;
        let socket = SockRef::from(&stream);
        // Whatever of these the system refuses, the connection works without.
        drop(stream.set_nodelay(true));
        drop(socket.set_send_buffer_size(SOCKET_BUFFER_BYTES));
        drop(socket.set_tcp_user_timeout(Some(SEND_TIMEOUT)));
        let has_asked = AtomicBool::new(false);
        let service = service_fn(|mut request: Request<Incoming>| {
            request.extensions_mut().insert(Arc::clone(seat));
            has_asked.store(true, Ordering::Relaxed);
            TowerToHyperService::new(router.clone()).call(request)
        });
        let served = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEAD_TIMEOUT)
            .max_buf_size(HEAD_BYTES)
            .serve_connection(TokioIo::new(stream), service)
            .with_upgrades()
            .await;
        // One that was asked something before may well fall silent.
        if served.is_err() && !has_asked.load(Ordering::Relaxed) {
            counts.one(Count::BadRequest);
        }
    }
}

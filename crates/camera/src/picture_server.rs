//! Serves pictures as a network camera does: an endless response of multipart/x-mixed-replace to whoever asks.

use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;

use http_body_util::channel::{Channel, Sender};
use hyper::body::{Bytes, Incoming};
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;

/// Most clients at a time.
const MAX_CLIENTS: usize = 8;
const MULTIPART: &str = "multipart/x-mixed-replace; boundary=picture";

/// A picture as it is served.
type Jpeg = Arc<[u8]>;

/// A running server. It ends when it is dropped.
#[derive(Debug)]
pub struct PictureServer {
    address: SocketAddr,
    newest: watch::Sender<Option<Jpeg>>,
    stop: CancellationToken,
}

impl PictureServer {
    /// Starts the thread of the server at a bound address.
    pub fn start(listener: TcpListener) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let (address, newest, stop) = (listener.local_addr()?, watch::Sender::new(None), CancellationToken::new());
        let (pictures, stopped) = (newest.clone(), stop.clone());
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        std::thread::Builder::new().name("pictures".to_owned()).spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    // It ends with the listener only, which the system closes never.
                    _ = serve(listener, pictures) => {}
                    () = stopped.cancelled() => {}
                }
            });
        })?;
        Ok(Self { address, newest, stop })
    }

    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Shows a JPEG picture to all clients; one that is slow misses it.
    pub fn publish(&self, jpeg: Vec<u8>) {
        self.newest.send_replace(Some(jpeg.into()));
    }
}

impl Drop for PictureServer {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}

async fn serve(listener: TcpListener, newest: watch::Sender<Option<Jpeg>>) -> io::Result<()> {
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let places = Arc::new(Semaphore::new(MAX_CLIENTS));
    loop {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return Ok(()) };
        let (stream, _) = listener.accept().await?;
        let pictures = newest.clone();
        let answer = service_fn(move |_: Request<Incoming>| {
            let (parts, body) = Channel::<Bytes, Infallible>::new(1);
            drop(tokio::spawn(send_parts(parts, pictures.subscribe())));
            let mut response = Response::new(body);
            response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(MULTIPART));
            std::future::ready(Ok::<_, Infallible>(response))
        });
        drop(tokio::spawn(async move {
            // A client that leaves is no error.
            drop(http1::Builder::new().timer(TokioTimer::new()).serve_connection(TokioIo::new(stream), answer).await);
            drop(place);
        }));
    }
}

/// Sends each newest picture until the client or the server is gone.
async fn send_parts(mut parts: Sender<Bytes>, mut newest: watch::Receiver<Option<Jpeg>>) {
    loop {
        let jpeg = newest.borrow_and_update().clone();
        if let Some(jpeg) = jpeg {
            let head = format!("--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
            if parts.send_data([head.as_bytes(), &jpeg, b"\r\n"].concat().into()).await.is_err() {
                return;
            }
        }
        if newest.changed().await.is_err() {
            return;
        }
    }
}

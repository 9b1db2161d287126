//! Pictures of a phone or network camera: a response of HTTP that does not end (multipart/x-mixed-replace).

use std::io;
use std::time::Duration;

use http_body_util::{BodyExt, Empty};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1;
use hyper::header::{ACCEPT, CONTENT_TYPE, HOST, USER_AGENT};
use hyper::{Request, Response, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use posebridge_link::{LinkError, OpenError};
use posebridge_vision::MultipartReader;
use tokio::net::TcpStream;

use crate::capture::{Capture, CaptureError};
use crate::picture::{EncodedPicture, PictureTime};

/// A camera that sends nothing for so long is lost.
const SILENCE: Duration = Duration::from_secs(5);
const DEFAULT_PORT: u16 = 80;

/// Receives until the stream ends or the link is closed.
pub(crate) fn receive(capture: &mut Capture, url: &str) -> Result<(), CaptureError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| OpenError::Io { what: url.to_owned(), source })?;
    let stop = capture.stop.clone();
    runtime.block_on(async {
        tokio::select! {
            ended = receive_stream(capture, url) => ended,
            () = stop.cancelled() => Ok(()),
        }
    })
}

async fn receive_stream(capture: &mut Capture, url: &str) -> Result<(), CaptureError> {
    let unusable = |reason: &str| OpenError::CameraRefused { url: url.to_owned(), reason: reason.to_owned() };
    let uri: Uri = url.parse().map_err(|_error| unusable("this is no address of a picture stream"))?;
    if uri.scheme_str() != Some("http") {
        return Err(unusable("only http:// is read; take https off, or the program's stream without encryption").into());
    }
    let response = request(&uri).await?;
    let status = response.status();
    if status != StatusCode::OK {
        return Err(unusable(&refusal(status)).into());
    }
    let content_type = response.headers().get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let reader = MultipartReader::new(content_type);
    let Some(mut reader) = reader else {
        let kind = if content_type.is_empty() { "nothing that says what it is" } else { content_type };
        return Err(unusable(&format!(
            "it answers with {kind}, not with a stream of pictures (multipart/x-mixed-replace): open the address in a browser \
             and take that of the moving picture itself"
        ))
        .into());
    };
    capture.report_open(format!("pictures of {url}"));
    let mut body = response.into_body();
    // When the first bytes of the picture that is being received came.
    let mut began = None;
    loop {
        let next = tokio::time::timeout(SILENCE, body.frame()).await;
        let Ok(frame) = next else {
            return Err(lost(format!("no picture for {} s", SILENCE.as_secs())));
        };
        let received = capture.timer.now();
        match frame {
            None => return Err(CaptureError::Lost(LinkError::HungUp)),
            Some(Err(error)) => return Err(lost(error.to_string())),
            Some(Ok(frame)) => {
                let Some(bytes) = frame.data_ref() else { continue };
                began.get_or_insert(received);
                reader.push(bytes, |part| {
                    let time = PictureTime::Received(began.take().unwrap_or(received));
                    capture.slot.put(EncodedPicture { time, bytes: part.bytes });
                });
            }
        }
    }
}

async fn request(uri: &Uri) -> Result<Response<Incoming>, OpenError> {
    let host = uri.host().unwrap_or_default();
    let port = uri.port_u16().unwrap_or(DEFAULT_PORT);
    let peer = format!("{host}:{port}");
    let unreachable = |source| OpenError::Unreachable { peer: peer.clone(), source };
    let address = host.trim_start_matches('[').trim_end_matches(']');
    let stream = TcpStream::connect((address, port)).await.map_err(unreachable)?;
    let (mut sender, connection) =
        http1::handshake(TokioIo::new(stream)).await.map_err(|error| unreachable(io::Error::other(error)))?;
    // It moves the bytes of the one request; its error reaches whoever reads the body.
    drop(tokio::spawn(connection));
    let path = uri.path_and_query().map_or("/", |path| path.as_str());
    let authority = uri.authority().map_or(peer.as_str(), hyper::http::uri::Authority::as_str);
    let request = Request::get(path)
        .header(HOST, authority)
        .header(USER_AGENT, concat!("posebridge/", env!("CARGO_PKG_VERSION")))
        .header(ACCEPT, "multipart/x-mixed-replace, image/jpeg")
        .body(Empty::<Bytes>::new())
        .map_err(|error| unreachable(io::Error::other(error)))?;
    sender.send_request(request).await.map_err(|error| unreachable(io::Error::other(error)))
}

fn refusal(status: StatusCode) -> String {
    match status {
        StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN => {
            format!("it answers {status}: switch its password off, or use a network of its own")
        }
        StatusCode::NOT_FOUND => {
            format!("it answers {status}: its page says where the stream is, often /video or /stream")
        }
        StatusCode::SERVICE_UNAVAILABLE | StatusCode::TOO_MANY_REQUESTS => {
            format!("it answers {status}: does another program or browser window take its pictures?")
        }
        _ => format!("it answers {status}"),
    }
}

fn lost(reason: String) -> CaptureError {
    CaptureError::Lost(LinkError::Camera(reason))
}

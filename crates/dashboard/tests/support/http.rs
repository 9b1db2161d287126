//! A client of the dashboard that sends exactly the given bytes.

#![allow(
    clippy::expect_used,
    clippy::unwrap_used,
    dead_code,
    reason = "helpers of several test files; they stop where the set-up is broken"
)]
#![allow(clippy::allow_attributes, reason = "whether a helper is used depends on the file that includes it")]

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use serde_json::Value;
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{Message, WebSocket};

/// Nothing in a test takes so long; it then fails instead of hanging.
const TIMEOUT: Duration = Duration::from_mins(1);

/// An answer.
#[derive(Debug)]
pub(crate) struct HttpResponse {
    pub(crate) status: u16,
    /// In lower case, line by line.
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl HttpResponse {
    /// The body as JSON.
    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body).expect("the body is JSON")
    }

    /// The body as text.
    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.body.clone()).expect("the body is text")
    }

    /// Why a request was refused.
    pub(crate) fn error(&self) -> String {
        let json = self.json();
        json["error"].as_str().expect("a refusal says why").to_owned()
    }

    /// The value of a header.
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines();
        lines.find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
    }
}

/// A connection.
pub(crate) fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).expect("the dashboard listens");
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream.set_write_timeout(Some(TIMEOUT)).unwrap();
    stream
}

/// Sends these bytes and reads until the other side closes; `None` if it closes without an answer.
pub(crate) fn exchange(address: SocketAddr, request: &[u8]) -> Option<HttpResponse> {
    let mut stream = connect(address);
    // Who is refused at once may be gone before everything is written.
    drop(stream.write_all(request));
    let mut bytes = Vec::new();
    drop(stream.read_to_end(&mut bytes));
    let end = bytes.windows(4).position(|window| window == b"\r\n\r\n")?;
    let head = String::from_utf8(bytes[..end].to_vec()).expect("a head is text");
    let status = head.split(' ').nth(1)?.parse().expect("a status is a number");
    Some(HttpResponse {
        status,
        head: head.to_ascii_lowercase().replace("\r\n", "\n"),
        body: bytes[end + 4..].to_vec(),
    })
}

/// A request with these further header lines.
pub(crate) fn request(address: SocketAddr, first_line: &str, headers: &str, body: &[u8]) -> HttpResponse {
    let length = body.len();
    let mut bytes = format!(
        "{first_line} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\ncontent-length: {length}\r\n{headers}\r\n"
    )
    .into_bytes();
    bytes.extend_from_slice(body);
    exchange(address, &bytes).expect("an answer")
}

/// Gets what is at a path.
pub(crate) fn get(address: SocketAddr, path: &str) -> HttpResponse {
    request(address, &format!("GET {path}"), "", b"")
}

/// Posts a command.
pub(crate) fn post(address: SocketAddr, command: &str) -> HttpResponse {
    let headers = "content-type: application/json\r\n";
    request(address, "POST /v1/commands", headers, command.as_bytes())
}

/// A number of `/metrics`; 0 if it is not there.
pub(crate) fn metric(address: SocketAddr, name: &str) -> f64 {
    let page = get(address, "/metrics").text();
    let mut lines = page.lines();
    let value = lines.find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    value.map_or(0.0, |value| value.parse().expect("a metric is a number"))
}

/// How many requests were refused for this reason.
pub(crate) fn refused(address: SocketAddr, reason: &str) -> f64 {
    let name = format!("posebridge_dashboard_refused_total{{reason=\"{reason}\"}}");
    metric(address, &name)
}

/// A reader of the stream.
pub(crate) struct StreamReader {
    socket: WebSocket<TcpStream>,
}

impl StreamReader {
    /// Opens the stream.
    pub(crate) fn open(address: SocketAddr) -> Self {
        Self::open_at(address, "/v1/stream")
    }

    /// Opens the stream with a token.
    pub(crate) fn open_as(address: SocketAddr, token: &str) -> Self {
        Self::open_at(address, &format!("/v1/stream?token={token}"))
    }

    fn open_at(address: SocketAddr, path: &str) -> Self {
        let url = format!("ws://{address}{path}");
        let request = url.into_client_request().expect("a request");
        let (socket, _) = tungstenite::client(request, connect(address)).expect("the stream is opened");
        Self { socket }
    }

    /// The next message.
    pub(crate) fn next(&mut self) -> Value {
        loop {
            match self.socket.read().expect("the stream goes on") {
                Message::Text(text) => {
                    return serde_json::from_str(&text).expect("a message is JSON");
                }
                Message::Ping(_) | Message::Pong(_) => {}
                other @ (Message::Binary(_) | Message::Close(_) | Message::Frame(_)) => {
                    panic!("{other:?}")
                }
            }
        }
    }

    /// Reads until a message is what is looked for.
    pub(crate) fn wait_for(&mut self, mut is_it: impl FnMut(&Value) -> bool) -> Value {
        loop {
            let message = self.next();
            if is_it(&message) {
                return message;
            }
        }
    }

    /// Sends a text.
    pub(crate) fn send(&mut self, text: &str) {
        self.send_message(Message::text(text));
    }

    /// Sends any message.
    pub(crate) fn send_message(&mut self, message: Message) {
        self.socket.send(message).expect("the stream takes it");
    }

    /// The connection below, for what no WebSocket sends.
    pub(crate) fn raw(&mut self) -> &mut TcpStream {
        self.socket.get_mut()
    }

    /// Reads until the other side closes it; returns the reason that it gave.
    pub(crate) fn close_reason(mut self) -> Option<String> {
        loop {
            match self.socket.read() {
                Ok(Message::Close(frame)) => return frame.map(|frame| frame.reason.to_string()),
                Ok(_) => {}
                Err(_) => return None,
            }
        }
    }

    /// Reads until the other side ends it.
    pub(crate) fn drain(mut self) {
        while self.socket.read().is_ok() {}
    }
}

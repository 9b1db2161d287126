//! Streams of HTTP, as phones and network cameras send them.

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};

use crate::drawing::{corners, picture_with_tag};
use crate::support::{CameraLink, corners_of, distance};

const SIZE: (usize, usize) = (160, 120);

/// How the body of a response is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BodyEncoding {
    Plain,
    Chunked,
}

/// A network camera that answers one request.
struct ServedStream {
    stream: TcpStream,
    encoding: BodyEncoding,
    request: String,
}

async fn listener() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("loopback");
    let url = format!("http://{}/video?quality=50", listener.local_addr().expect("bound"));
    (listener, url)
}

impl ServedStream {
    async fn accept(listener: &TcpListener, encoding: BodyEncoding) -> Self {
        let mut accepted =
            Self::accept_with(listener, "200 OK", "multipart/x-mixed-replace; boundary=frame", encoding).await;
        accepted.send(b"--frame\r\n").await;
        accepted
    }

    async fn accept_with(listener: &TcpListener, status: &str, content_type: &str, encoding: BodyEncoding) -> Self {
        let (mut stream, _) = listener.accept().await.expect("the link dials");
        let mut request = Vec::new();
        while !request.ends_with(b"\r\n\r\n") {
            request.push(stream.read_u8().await.expect("a request"));
        }
        let transfer = if encoding == BodyEncoding::Chunked { "Transfer-Encoding: chunked\r\n" } else { "" };
        let head = format!("HTTP/1.1 {status}\r\nContent-Type: {content_type}\r\n{transfer}\r\n");
        stream.write_all(head.as_bytes()).await.expect("the link reads");
        Self { stream, encoding, request: String::from_utf8(request).expect("text") }
    }

    async fn send_picture(&mut self, bytes: &[u8]) {
        let head = format!("Content-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", bytes.len());
        self.send(&[head.as_bytes(), bytes, b"\r\n--frame\r\n"].concat()).await;
    }

    /// In pieces that end anywhere.
    async fn send(&mut self, bytes: &[u8]) {
        for piece in bytes.chunks(1_000) {
            let piece = match self.encoding {
                BodyEncoding::Plain => piece.to_vec(),
                BodyEncoding::Chunked => [format!("{:x}\r\n", piece.len()).as_bytes(), piece, b"\r\n"].concat(),
            };
            self.stream.write_all(&piece).await.expect("the link reads");
        }
    }
}

#[tokio::test]
async fn tags_of_a_stream_arrive_whatever_its_encoding() {
    for encoding in [BodyEncoding::Plain, BodyEncoding::Chunked] {
        let (listener, url) = listener().await;
        let mut camera = CameraLink::new(&url);
        let serve = async {
            let mut stream = ServedStream::accept(&listener, encoding).await;
            assert!(stream.request.starts_with("GET /video?quality=50 HTTP/1.1\r\n"), "{}", stream.request);
            stream.send_picture(&picture_with_tag(SIZE, 7, (40, 30))).await;
            stream
        };
        let (line, _stream) = tokio::join!(camera.tag(), serve);
        assert!(distance(corners_of(&line), corners((40, 30))) < 0.1, "{encoding:?}: {line}");
        assert!(line["received_ago_us"].as_u64().is_some(), "{line}");
    }
}

#[tokio::test]
async fn a_camera_that_comes_back_with_another_size_is_used_again() {
    let (listener, url) = listener().await;
    let mut camera = CameraLink::new(&url);
    for size in [SIZE, (320, 240)] {
        let serve = async {
            let mut stream = ServedStream::accept(&listener, BodyEncoding::Plain).await;
            stream.send_picture(&picture_with_tag(size, 7, (40, 30))).await;
            stream
        };
        let (line, stream) = tokio::join!(camera.tag(), serve);
        assert_eq!(line["picture_px"], serde_json::json!([size.0, size.1]));
        drop(stream);
        assert!(camera.loss().await.contains("other end is gone"));
    }
    assert_eq!(camera.link.counters().reconnects, 1);
}

#[tokio::test]
async fn damaged_pictures_are_counted_and_the_next_good_one_is_searched() {
    let (listener, url) = listener().await;
    let mut camera = CameraLink::new(&url);
    let pictures = camera.view.subscribe();
    let serve = async {
        let mut stream = ServedStream::accept(&listener, BodyEncoding::Plain).await;
        stream.send_picture(b"\xFF\xD8 no picture at all").await;
        let good = picture_with_tag(SIZE, 9, (50, 40));
        // The damaged one may be replaced before it is looked at: only then does nobody count it.
        stream.send_picture(&good).await;
        stream
    };
    let (line, _stream) = tokio::join!(camera.tag(), serve);
    assert_eq!(line["tag"], 9);
    let seen = pictures.borrow().clone().unwrap();
    assert_eq!(seen.counts.damaged + seen.counts.dropped, 1, "{:?}", seen.counts);
    assert_eq!((seen.counts.searched, seen.width, seen.height), (1, SIZE.0, SIZE.1));
    assert_eq!(seen.tags.iter().map(|tag| tag.id).collect::<Vec<_>>(), [9]);
}

#[tokio::test]
async fn a_camera_that_sends_nothing_but_damage_is_lost_with_the_reason() {
    let (listener, url) = listener().await;
    let mut camera = CameraLink::new(&url);
    let serve = async {
        let mut stream = ServedStream::accept(&listener, BodyEncoding::Plain).await;
        loop {
            stream.send_picture(b"\xFF\xD8 no picture at all").await;
            tokio::task::yield_now().await;
        }
    };
    tokio::select! {
        reason = camera.loss() => assert!(reason.contains("60 pictures in a row cannot be decoded: the picture is damaged"), "{reason}"),
        () = serve => {}
    }
}

#[tokio::test]
async fn what_is_no_stream_of_pictures_says_what_to_do() {
    for (status, content_type, words) in [
        ("404 Not Found", "text/html", "often /video or /stream"),
        ("401 Unauthorized", "text/html", "switch its password off"),
        ("503 Service Unavailable", "text/html", "another program"),
        ("200 OK", "text/html", "open the address in a browser"),
        ("200 OK", "multipart/x-mixed-replace", "not with a stream of pictures"),
    ] {
        let (listener, url) = listener().await;
        let mut camera = CameraLink::new(&url);
        let serve = ServedStream::accept_with(&listener, status, content_type, BodyEncoding::Plain);
        let (opened, _stream) = tokio::join!(camera.link.try_open(), serve);
        let error = opened.unwrap_err().to_string();
        assert!(error.contains(words) && error.contains(&url), "{error}");
    }
}

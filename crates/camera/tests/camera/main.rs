//! Cameras as links: streams of HTTP on the loopback interface and folders of pictures, a simulated webcam, to lines of JSON.
#![expect(clippy::expect_used, clippy::panic, reason = "helpers outside #[test] stop where the test is broken")]

mod drawing;
mod folder;
mod http_stream;
mod support;
mod webcam;

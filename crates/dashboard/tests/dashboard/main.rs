//! The server over real sockets on loopback; the test plays the station loop.

#![expect(clippy::unwrap_used, reason = "helpers outside the test functions may fail loudly as well")]

mod cameras;
mod fleet;
#[path = "../support/http.rs"]
mod http;
mod limits;
mod played;
mod server;

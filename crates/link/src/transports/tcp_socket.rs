//! Socket options of TCP connections, for both roles.
//!
//! Nagle's delay is off, because estimates are small and urgent. Keep-alives detect peers that left without closing, such as a
//! robot that drives out of the access point's range.
//!
//! Linux would let a send buffer grow to 4 MiB, minutes of data on a slow link that nothing can overtake. It is kept small, so
//! that frames for a slow peer wait in the link's own queue, where the newest estimate replaces the one before it. The *peer's*
//! receive buffer is outside our control and adds to the age of what it reads.

use std::io;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};
use tokio::net::TcpStream;

/// Silence before the first keep-alive probe.
const KEEPALIVE_IDLE: Duration = Duration::from_secs(5);
/// Interval of the probes.
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(2);
/// Unanswered probes before the connection counts as lost.
const KEEPALIVE_RETRIES: u32 = 3;
/// How long sent data may stay unacknowledged: as long as the keep-alives take.
const USER_TIMEOUT: Duration = Duration::from_secs(11);

/// Send buffer; Linux doubles it for its own bookkeeping. It also limits the bytes in flight: at a round-trip time of 20 ms
/// to 800 kB/s, a hundred times the rate of a robot's link.
const SEND_BUFFER_BYTES: usize = 16 * 1024;
/// Unsent bytes above which the system accepts no more (tcp(7), TCP_NOTSENT_LOWAT): about seven of the longest frames (280
/// bytes), so that the link never idles.
const UNSENT_BYTES: u32 = 2 * 1024;

pub(super) fn configure(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    socket.set_tcp_keepalive(
        &TcpKeepalive::new()
            .with_time(KEEPALIVE_IDLE)
            .with_interval(KEEPALIVE_INTERVAL)
            .with_retries(KEEPALIVE_RETRIES),
    )?;
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.set_tcp_notsent_lowat(UNSENT_BYTES)?;
    socket.set_tcp_user_timeout(Some(USER_TIMEOUT))
}

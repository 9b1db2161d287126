//! The sockets of a UDP link: a large receive buffer for everybody, and one more for each peer that floods.
//!
//! The buffer of a socket is first come, first served: one peer that sends faster than we read fills it, and the system
//! then drops the datagrams of all. So a loud peer is given a socket of its own, bound to the same address and connected
//! to it; Linux delivers to the socket that fits best, so from then on that peer fills and loses only its own. Nothing is
//! lost on the way: what arrives between binding and connecting bears its sender's address and is delivered as usual.

use std::io;
use std::net::SocketAddr;

use socket2::{Domain, Protocol, SockRef, Socket, Type};
use tokio::net::UdpSocket;

/// Receive buffer that is asked for. Linux doubles it and charges 832 bytes for a small datagram (its default of 212 992
/// bytes was measured to hold 256), so this holds 10 000 of them: a fifth of a second of 1000 robots at 50 Hz.
pub const RECEIVE_BUFFER_BYTES: usize = 4 * 1024 * 1024;

/// Asks for a large receive buffer and returns how many bytes were granted.
pub(super) fn enlarge_receive_buffer(socket: &UdpSocket) -> usize {
    enlarge(&SockRef::from(socket))
}

fn enlarge(socket: &SockRef<'_>) -> usize {
    // A refusal shows in what is granted, which is what counts.
    let asked = socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES);
    let doubled = socket.recv_buffer_size().unwrap_or(0);
    tracing::debug!(?asked, doubled, "receive buffer");
    // Linux doubles the size for its own bookkeeping and reports the double: socket(7), SO_RCVBUF.
    doubled / 2
}

/// What is said about a buffer that is smaller than was asked for.
pub(super) fn buffer_warning(granted_bytes: usize) -> Option<String> {
    (granted_bytes < RECEIVE_BUFFER_BYTES).then(|| {
        format!(
            ", receive buffer only {granted_bytes} of {RECEIVE_BUFFER_BYTES} bytes: \
             run `sudo sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` for many robots"
        )
    })
}

/// A socket that hears `peer` instead of `main`, which is bound to `local`.
///
/// # Errors
/// The system has no socket left, or `peer` cannot be reached.
pub(super) fn split_off(
    main: &UdpSocket,
    local: SocketAddr,
    peer: SocketAddr,
) -> io::Result<UdpSocket> {
    let own = Socket::new(Domain::for_address(local), Type::DGRAM, Some(Protocol::UDP))?;
    own.set_nonblocking(true)?;
    own.set_reuse_address(true)?;
    enlarge(&SockRef::from(&own));
    // Both sides have to agree at the moment of binding. Afterwards the address is ours alone again, so that a second
    // program is still told that it is taken.
    let main = SockRef::from(main);
    main.set_reuse_address(true)?;
    let bound = own.bind(&local.into());
    let withdrawn = main.set_reuse_address(false);
    bound.and(withdrawn)?;
    own.connect(&peer.into())?;
    UdpSocket::from_std(own.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_receive_buffer_is_told_with_its_cure() {
        assert_eq!(buffer_warning(RECEIVE_BUFFER_BYTES), None);
        let warning = buffer_warning(212_992).expect("it is too small");
        assert!(warning.contains("212992 of 4194304 bytes"), "{warning}");
        assert!(warning.contains("net.core.rmem_max=4194304"), "{warning}");
    }
}

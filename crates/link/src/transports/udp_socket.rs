//! The sockets of a UDP link: a large receive buffer for everybody, and one more for each peer that floods.
//!
//! A host's name may have several addresses, of which the first need not be of any use here: an IPv6 address on a computer
//! without a way to IPv6, for instance. Unlike TCP no answer tells which one is heard, so what decides is what this computer
//! can know: which address it can listen at, and to which it has a way.
//!
//! The buffer of a socket is first come, first served: one peer that sends faster than we read fills it, and the system
//! then drops the datagrams of all. So a loud peer is given a socket of its own, bound to the same address and connected
//! to it; Linux delivers to the socket that fits best, so from then on that peer fills and loses only its own. Nothing is
//! lost on the way: what arrives between binding and connecting bears its sender's address and is delivered as usual.

use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};

use socket2::{Domain, Protocol, SockRef, Socket, Type};
use tokio::net::UdpSocket;

use crate::error::OpenError;
use crate::transports::bind_error;

/// Receive buffer that is asked for. Linux doubles it and charges 832 bytes for a small datagram (its default of 212 992
/// bytes was measured to hold 256), so this holds 10 000 of them: a fifth of a second of 1000 robots at 50 Hz.
pub const RECEIVE_BUFFER_BYTES: usize = 4 * 1024 * 1024;

/// A socket that listens at the first of these addresses that can be had, and that address.
///
/// # Errors
/// None can be had; what stands against the first.
pub(super) fn bind_first(targets: &[SocketAddr]) -> Result<(UdpSocket, SocketAddr), OpenError> {
    let mut failure = None;
    for target in targets {
        match bind(*target) {
            Ok(socket) => return Ok((socket, *target)),
            Err(error) => failure = failure.or(Some(bind_error(*target, error))),
        }
    }
    Err(failure.unwrap_or_else(nothing_to_open))
}

/// A socket that can send to the first of these addresses to which there is a way, and that address. Without a way to any
/// of them it is the first one: the network may come later.
///
/// # Errors
/// No socket can be had.
pub(super) fn call_first(targets: &[SocketAddr]) -> Result<(UdpSocket, SocketAddr), OpenError> {
    let reachable = targets.iter().find(|target| has_way_to(**target));
    let target = reachable.or(targets.first()).ok_or_else(nothing_to_open)?;
    let local = any_port_beside(*target);
    let socket = bind(local).map_err(|error| bind_error(local, error))?;
    Ok((socket, *target))
}

fn nothing_to_open() -> OpenError {
    OpenError::UnknownHost { host: String::new(), source: io::ErrorKind::NotFound.into() }
}

fn bind(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = std::net::UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket)
}

/// Whether the system knows where to send what is for `target`; to connect a UDP socket asks for that and sends nothing.
fn has_way_to(target: SocketAddr) -> bool {
    std::net::UdpSocket::bind(any_port_beside(target)).is_ok_and(|socket| socket.connect(target).is_ok())
}

/// Every interface, for the kind of address that `target` is, at a port that the system chooses.
fn any_port_beside(target: SocketAddr) -> SocketAddr {
    if target.is_ipv6() {
        SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0))
    } else {
        SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0))
    }
}

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
pub(super) fn split_off(main: &UdpSocket, local: SocketAddr, peer: SocketAddr) -> io::Result<UdpSocket> {
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
    use std::net::IpAddr;

    /// No interface has it: 192.0.2.0/24 is for documentation (RFC 5737).
    const FOREIGN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1)), 0);
    /// The system lets nobody send here who has not asked for it.
    const NO_WAY: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::BROADCAST), 9);
    const HERE: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
    const THERE: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 9);

    #[tokio::test]
    async fn of_several_addresses_the_first_that_can_be_had_listens() {
        let (socket, chosen) = bind_first(&[FOREIGN, HERE]).expect("one is ours");
        assert_eq!(chosen, HERE);
        let local = socket.local_addr().expect("it is bound");
        assert_eq!(local.ip(), HERE.ip());
        let error = bind_first(&[FOREIGN, local]).expect_err("neither is free");
        assert!(error.to_string().contains("192.0.2.1"), "{error}");
    }

    #[tokio::test]
    async fn of_several_addresses_the_first_with_a_way_is_called() {
        for (targets, expected) in [(&[NO_WAY, THERE][..], THERE), (&[THERE, NO_WAY], THERE), (&[NO_WAY], NO_WAY)] {
            let (socket, chosen) = call_first(targets).expect("a free port");
            assert_eq!(chosen, expected);
            let local = socket.local_addr().expect("it is bound");
            assert!(local.ip().is_unspecified());
        }
    }

    #[test]
    fn a_small_receive_buffer_is_told_with_its_cure() {
        assert_eq!(buffer_warning(RECEIVE_BUFFER_BYTES), None);
        let warning = buffer_warning(212_992).expect("it is too small");
        assert!(warning.contains("212992 of 4194304 bytes"), "{warning}");
        assert!(warning.contains("net.core.rmem_max=4194304"), "{warning}");
    }
}

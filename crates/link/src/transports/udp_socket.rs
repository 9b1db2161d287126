//! The sockets of a UDP link: one with a large receive buffer for all peers, and one more for each peer that floods.
//!
//! A host name may have several addresses, and the first may be unusable, such as an IPv6 address on a computer without
//! an IPv6 route. UDP has no handshake that would show it, so the choice uses what this computer knows: the addresses
//! that it can bind, and those to which it has a route.
//!
//! A socket's buffer is first come, first served: one peer that sends faster than we read fills it, and the system then
//! drops the datagrams of all. So such a peer gets its own socket, bound to the same address and connected to the peer;
//! Linux delivers to the most specific socket, so from then on that peer fills and loses only its own. No datagram is
//! lost meanwhile: one that arrives between bind and connect carries its sender's address and is delivered as usual.
//!
//! The system says with a datagram how many it has dropped before it (socket(7), SO_RXQ_OVFL).

use std::io::{self, IoSliceMut};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4, SocketAddrV6};
use std::os::fd::{AsRawFd, RawFd};

use nix::sys::socket::sockopt::RxqOvfl;
use nix::sys::socket::{ControlMessageOwned, MsgFlags, SockaddrStorage, recvmsg, setsockopt};
use socket2::{Domain, Protocol, SockRef, Socket, Type};
use tokio::io::Interest;
use tokio::net::UdpSocket;

use crate::error::OpenError;
use crate::transports::open_request::{bind_error, no_address};

/// Requested receive buffer. Linux doubles it and charges 832 bytes for a small datagram (measured: its default of 212 992
/// bytes holds 256), so this holds 10 000 of them: a fifth of a second of 1000 robots at 50 Hz.
pub const RECEIVE_BUFFER_BYTES: usize = 4 * 1024 * 1024;

/// Of the socket of one loud peer.
const DEDICATED_BUFFER_BYTES: usize = 1024 * 1024;

/// A socket that knows how many datagrams the system has dropped.
pub(super) struct DatagramSocket {
    pub(super) socket: UdpSocket,
    control: Vec<u8>,
    /// As the system counts them, from zero again after the largest.
    dropped: u32,
}

impl DatagramSocket {
    pub(super) fn new(socket: UdpSocket) -> Self {
        if let Err(error) = setsockopt(&socket, RxqOvfl, &1) {
            tracing::warn!(%error, "datagrams that the system drops are not counted");
        }
        Self { socket, control: nix::cmsg_space!(u32), dropped: 0 }
    }

    /// The next datagram: its length and sender. Adds what was dropped before it to `dropped`.
    pub(super) fn try_recv_from(&mut self, buffer: &mut [u8], dropped: &mut u64) -> io::Result<(usize, SocketAddr)> {
        let (fd, control) = (self.socket.as_raw_fd(), &mut self.control);
        let received = self.socket.try_io(Interest::READABLE, || receive(fd, control, buffer))?;
        Ok(self.count(&received, dropped))
    }

    /// Like [`Self::try_recv_from`], also if the runtime does not know yet that something came.
    pub(super) fn recv_from_now(&mut self, buffer: &mut [u8], dropped: &mut u64) -> io::Result<(usize, SocketAddr)> {
        let received = receive(self.socket.as_raw_fd(), &mut self.control, buffer)?;
        Ok(self.count(&received, dropped))
    }

    fn count(&mut self, received: &Datagram, dropped: &mut u64) -> (usize, SocketAddr) {
        if let Some(now) = received.dropped {
            *dropped += u64::from(now.wrapping_sub(std::mem::replace(&mut self.dropped, now)));
        }
        (received.length, received.from)
    }
}

struct Datagram {
    length: usize,
    from: SocketAddr,
    /// `None` while the system has dropped none.
    dropped: Option<u32>,
}

fn receive(fd: RawFd, control: &mut [u8], buffer: &mut [u8]) -> io::Result<Datagram> {
    let mut parts = [IoSliceMut::new(buffer)];
    let received = recvmsg::<SockaddrStorage>(fd, &mut parts, Some(control), MsgFlags::empty())?;
    let count_of = |message| if let ControlMessageOwned::RxqOvfl(count) = message { Some(count) } else { None };
    let dropped = received.cmsgs()?.find_map(count_of);
    let v4 = |from: &SockaddrStorage| from.as_sockaddr_in().map(|from| SocketAddr::V4(SocketAddrV4::from(*from)));
    let v6 = |from: &SockaddrStorage| from.as_sockaddr_in6().map(|from| SocketAddr::V6(SocketAddrV6::from(*from)));
    let from = received.address.as_ref().and_then(|from| v4(from).or_else(|| v6(from)));
    let from = from.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidData))?;
    Ok(Datagram { length: received.bytes, from, dropped })
}

/// A socket bound to the first possible address, and that address.
///
/// # Errors
/// None can be bound; the error of the first.
pub(super) fn bind_first_available(targets: &[SocketAddr]) -> Result<(UdpSocket, SocketAddr), OpenError> {
    let mut failure = None;
    for target in targets {
        match bind(*target) {
            Ok(socket) => return Ok((socket, *target)),
            Err(error) => failure = failure.or(Some(bind_error(*target, error))),
        }
    }
    Err(failure.unwrap_or_else(|| no_address("")))
}

/// A socket that sends to the first address with a route, and that address. Without any route it is the first address: the
/// network may come up later.
///
/// # Errors
/// No socket can be opened.
pub(super) fn connect_first_reachable(targets: &[SocketAddr]) -> Result<(UdpSocket, SocketAddr), OpenError> {
    let reachable = targets.iter().find(|target| has_route_to(**target));
    let target = reachable.or(targets.first()).ok_or_else(|| no_address(""))?;
    let local = wildcard_address_for(*target);
    let socket = bind(local).map_err(|error| bind_error(local, error))?;
    Ok((socket, *target))
}

fn bind(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = std::net::UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    UdpSocket::from_std(socket)
}

/// Whether the system has a route to `target`; connecting a UDP socket looks it up and sends nothing.
fn has_route_to(target: SocketAddr) -> bool {
    std::net::UdpSocket::bind(wildcard_address_for(target)).is_ok_and(|socket| socket.connect(target).is_ok())
}

/// Every interface of the address family of `target`, at a port that the system chooses.
fn wildcard_address_for(target: SocketAddr) -> SocketAddr {
    if target.is_ipv6() {
        SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0))
    } else {
        SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0))
    }
}

/// Requests a large receive buffer and returns the granted size in bytes.
pub(super) fn enlarge_receive_buffer(socket: &UdpSocket) -> usize {
    enlarge(&SockRef::from(socket), RECEIVE_BUFFER_BYTES)
}

fn enlarge(socket: &SockRef<'_>, bytes: usize) -> usize {
    // A refusal shows in what is granted, which is what counts.
    let outcome = socket.set_recv_buffer_size(bytes);
    let doubled = socket.recv_buffer_size().unwrap_or(0);
    tracing::debug!(?outcome, doubled, "receive buffer");
    // Linux doubles the size for its own bookkeeping and reports the double: socket(7), SO_RCVBUF.
    doubled / 2
}

pub(super) fn buffer_warning(granted_bytes: usize) -> Option<String> {
    (granted_bytes < RECEIVE_BUFFER_BYTES).then(|| {
        format!(
            ", receive buffer only {granted_bytes} of {RECEIVE_BUFFER_BYTES} bytes: \
             run `sudo sysctl net.core.rmem_max={RECEIVE_BUFFER_BYTES}` for many robots"
        )
    })
}

/// A socket that receives from `peer` instead of `main`, which is bound to `local`.
///
/// # Errors
/// No socket can be opened, or `peer` is unreachable.
pub(super) fn open_dedicated_socket(main: &UdpSocket, local: SocketAddr, peer: SocketAddr) -> io::Result<UdpSocket> {
    let own = Socket::new(Domain::for_address(local), Type::DGRAM, Some(Protocol::UDP))?;
    own.set_nonblocking(true)?;
    own.set_reuse_address(true)?;
    enlarge(&SockRef::from(&own), DEDICATED_BUFFER_BYTES);
    // Both sides have to agree at the moment of binding. Afterwards the address is ours alone again, so that a second program
    // still gets the error that it is in use.
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
    /// The system refuses to send here unless broadcasts are enabled on the socket.
    const NO_ROUTE: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::BROADCAST), 9);
    const HERE: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
    const THERE: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 9);

    #[tokio::test]
    async fn of_several_addresses_the_first_that_can_be_had_listens() {
        let (socket, chosen) = bind_first_available(&[FOREIGN, HERE]).expect("one is ours");
        assert_eq!(chosen, HERE);
        let local = socket.local_addr().expect("it is bound");
        assert_eq!(local.ip(), HERE.ip());
        let error = bind_first_available(&[FOREIGN, local]).expect_err("neither is free");
        assert!(error.to_string().contains("192.0.2.1"), "{error}");
    }

    #[tokio::test]
    async fn of_several_addresses_the_first_with_a_route_is_used() {
        for (targets, expected) in
            [(&[NO_ROUTE, THERE][..], THERE), (&[THERE, NO_ROUTE], THERE), (&[NO_ROUTE], NO_ROUTE)]
        {
            let (socket, chosen) = connect_first_reachable(targets).expect("a free port");
            assert_eq!(chosen, expected);
            let local = socket.local_addr().expect("it is bound");
            assert!(local.ip().is_unspecified());
        }
    }

    #[test]
    fn a_small_receive_buffer_is_reported_with_the_remedy() {
        assert_eq!(buffer_warning(RECEIVE_BUFFER_BYTES), None);
        let warning = buffer_warning(212_992).expect("it is too small");
        assert!(warning.contains("212992 of 4194304 bytes"), "{warning}");
        assert!(warning.contains("net.core.rmem_max=4194304"), "{warning}");
    }
    #[tokio::test]
    async fn what_the_system_drops_is_counted_with_the_next_datagram() {
        let (socket, _) = bind_first_available(&[HERE]).expect("a free port");
        SockRef::from(&socket).set_recv_buffer_size(4_096).expect("a small buffer");
        let address = socket.local_addr().expect("it is bound");
        let mut receiver = DatagramSocket::new(socket);
        let sender = std::net::UdpSocket::bind(HERE).expect("a free port");
        let (mut received, mut dropped, mut buffer) = (0, 0, [0; 300]);
        for burst in [100, 1, 100, 1] {
            for _ in 0..burst {
                sender.send_to(&[1; 200], address).expect("loopback");
            }
            while let Ok((length, from)) = receiver.recv_from_now(&mut buffer, &mut dropped) {
                assert_eq!((length, Ok(from)), (200, sender.local_addr().map_err(drop)));
                received += 1;
            }
        }
        assert!(received < 100, "the buffer is small");
        assert_eq!(received + dropped, 202);
    }
}

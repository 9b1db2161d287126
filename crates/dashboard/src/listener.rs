//! The listening socket. It is bound before anything else starts, so that a failure leaves nothing to clean up.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;
use socket2::SockRef;

use crate::api::{DashboardStartError, MAX_PORT_ATTEMPTS};

/// The address to listen on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListenAddress {
    /// Port 0 lets the system choose.
    Exact(SocketAddr),
    /// This address, or the next free port.
    FirstFree(SocketAddr),
}

/// A bound listening socket; connections are accepted later.
#[derive(Debug)]
pub struct BoundListener {
    pub(crate) listener: TcpListener,
    pub(crate) address: SocketAddr,
}

impl BoundListener {
    pub fn new(listen: ListenAddress) -> Result<Self, DashboardStartError> {
        let (first, tries) = match listen {
            ListenAddress::Exact(address) => (address, 0),
            ListenAddress::FirstFree(address) => (address, MAX_PORT_ATTEMPTS),
        };
        for step in 0..=tries {
            let mut address = first;
            address.set_port(first.port().saturating_add(step));
            match Self::bind_address(address) {
                Ok(bound) => return Ok(bound),
                Err(source) if source.kind() == io::ErrorKind::AddrInUse => {}
                Err(source) => return Err(DashboardStartError::Bind { address, source }),
            }
        }
        Err(match listen {
            ListenAddress::Exact(address) => DashboardStartError::AddressInUse { address },
            ListenAddress::FirstFree(address) => DashboardStartError::AllPortsInUse { address },
        })
    }

    fn bind_address(address: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address })
    }

    /// Addresses of this computer for other clients; loopback last.
    pub(crate) fn reachable_addresses(&self) -> Vec<IpAddr> {
        let own = self.address.ip();
        if !own.is_unspecified() {
            return vec![own];
        }
        let families = match own {
            IpAddr::V4(_) => IpFamilies::V4,
            IpAddr::V6(_) if SockRef::from(&self.listener).only_v6().unwrap_or(true) => IpFamilies::V6,
            IpAddr::V6(_) => IpFamilies::Both,
        };
        find_local_addresses(families)
    }
}

/// The address families from which a socket accepts connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum IpFamilies {
    V4,
    V6,
    Both,
}

/// The addresses of all networks, and then the loopback.
fn find_local_addresses(families: IpFamilies) -> Vec<IpAddr> {
    // If the system does not list them, only the loopback remains.
    let interfaces = getifaddrs().into_iter().flatten();
    let up = interfaces.filter(|one| one.flags.contains(InterfaceFlags::IFF_UP));
    let found = up.filter_map(|one| {
        let address = one.address?;
        let v4 = address.as_sockaddr_in().map(|v4| IpAddr::V4(v4.ip()));
        v4.or_else(|| address.as_sockaddr_in6().map(|v6| IpAddr::V6(v6.ip())))
    });
    select_addresses(found, families)
}

/// The addresses that work in another computer's browser, IPv4 first, then one for this computer.
fn select_addresses(found: impl Iterator<Item = IpAddr>, families: IpFamilies) -> Vec<IpAddr> {
    let is_selected = |address: &IpAddr| match address {
        IpAddr::V4(v4) => families != IpFamilies::V6 && !v4.is_link_local(),
        // A browser accepts no address with a zone, and a link-local one needs it.
        IpAddr::V6(v6) => families != IpFamilies::V4 && !v6.is_unicast_link_local(),
    };
    let mut chosen: Vec<IpAddr> = found.filter(|address| is_selected(address) && !address.is_loopback()).collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen.push(match families {
        IpFamilies::V4 | IpFamilies::Both => Ipv4Addr::LOCALHOST.into(),
        IpFamilies::V6 => Ipv6Addr::LOCALHOST.into(),
    });
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_those_that_others_can_open_and_then_that_of_this_computer() {
        let found = ["fe80::1", "2001:db8::7", "::1", "127.0.0.1", "192.0.2.7", "169.254.3.4", "10.0.0.3", "192.0.2.7"];
        let chosen = |families| {
            let found = found.iter().map(|text| text.parse().unwrap());
            let chosen = select_addresses(found, families).into_iter();
            chosen.map(|ip| ip.to_string()).collect::<Vec<_>>()
        };
        assert_eq!(chosen(IpFamilies::V4), ["10.0.0.3", "192.0.2.7", "127.0.0.1"]);
        assert_eq!(chosen(IpFamilies::V6), ["2001:db8::7", "::1"]);
        assert_eq!(chosen(IpFamilies::Both), ["10.0.0.3", "192.0.2.7", "2001:db8::7", "127.0.0.1"]);
    }

    #[test]
    fn this_computer_is_always_among_them() {
        let found = find_local_addresses(IpFamilies::V4);
        assert_eq!(found.last(), Some(&Ipv4Addr::LOCALHOST.into()));
    }
}

//! Under which addresses this computer is found when a server listens at all of them.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use nix::ifaddrs::getifaddrs;
use nix::net::if_::InterfaceFlags;

/// Of which kinds of addresses a socket takes connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Families {
    V4,
    V6,
    Both,
}

/// The addresses of all networks, and that of this computer for itself last.
pub(crate) fn reachable(families: Families) -> Vec<IpAddr> {
    // A system that does not tell leaves the address for this computer.
    let interfaces = getifaddrs().into_iter().flatten();
    let up = interfaces.filter(|one| one.flags.contains(InterfaceFlags::IFF_UP));
    let found = up.filter_map(|one| {
        let address = one.address?;
        let v4 = address.as_sockaddr_in().map(|v4| IpAddr::V4(v4.ip()));
        v4.or_else(|| address.as_sockaddr_in6().map(|v6| IpAddr::V6(v6.ip())))
    });
    chosen(found, families)
}

/// Those that can be typed into another computer's browser, IPv4 first, then one for this computer.
fn chosen(found: impl Iterator<Item = IpAddr>, families: Families) -> Vec<IpAddr> {
    let is_wanted = |address: &IpAddr| match address {
        IpAddr::V4(v4) => families != Families::V6 && !v4.is_link_local(),
        // A browser takes no address with a zone, and one of a link makes no sense without.
        IpAddr::V6(v6) => families != Families::V4 && !v6.is_unicast_link_local(),
    };
    let mut chosen: Vec<IpAddr> = found.filter(|address| is_wanted(address) && !address.is_loopback()).collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen.push(match families {
        Families::V4 | Families::Both => Ipv4Addr::LOCALHOST.into(),
        Families::V6 => Ipv6Addr::LOCALHOST.into(),
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
            let chosen = chosen(found, families).into_iter();
            chosen.map(|ip| ip.to_string()).collect::<Vec<_>>()
        };
        assert_eq!(chosen(Families::V4), ["10.0.0.3", "192.0.2.7", "127.0.0.1"]);
        assert_eq!(chosen(Families::V6), ["2001:db8::7", "::1"]);
        assert_eq!(chosen(Families::Both), ["10.0.0.3", "192.0.2.7", "2001:db8::7", "127.0.0.1"]);
    }

    #[test]
    fn this_computer_is_always_among_them() {
        let found = reachable(Families::V4);
        assert_eq!(found.last(), Some(&Ipv4Addr::LOCALHOST.into()));
    }
}

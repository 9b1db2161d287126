//! Which connection makes room for another at a full door, for every server of the program.
//!
//! A door has a limit in all and one for each client, so that nobody fills it alone. Where it is full, a newcomer takes the place of a
//! connection that is not in use, of the client that holds most of them. A connection in use keeps its place.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use crate::clock::{HostClock, Timestamp};

/// The first twelve bytes of an IPv4 address that is written as one of IPv6 (RFC 4291, section 2.5.5.2).
const MAPPED_IPV4_PREFIX: [u8; 12] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff];

/// Who counts as one client: an IPv4 address, or the 64-bit network of an IPv6 address, because a computer may take any address in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ClientNetwork([u8; 16]);

impl ClientNetwork {
    /// From the bytes of an IPv6 address, or of an IPv4 address that is mapped to IPv6.
    pub fn from_ipv6_octets(mut octets: [u8; 16]) -> Self {
        if !octets.starts_with(&MAPPED_IPV4_PREFIX) {
            octets[8..].fill(0);
        }
        Self(octets)
    }
}

/// How much a connection is in use, the least first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ConnectionUse {
    /// Nothing valid has come from it.
    Unproven,
    /// Something came from it, and nothing is under way.
    Idle,
    /// It is being served, or its client has shown a token: it keeps its place.
    Active,
}

/// A connection that has a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Occupant {
    pub client: ClientNetwork,
    pub usage: ConnectionUse,
    /// When it last did something, or came.
    pub since: Timestamp<HostClock>,
}

/// The number of places.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AdmissionLimits {
    pub total: usize,
    /// Of one client.
    pub per_client: usize,
}

/// What happens to a newcomer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// It gets a free place.
    Free,
    /// It gets the place of the occupant at this index, whose connection is to be closed.
    Replaces(usize),
    /// All places of its client are in use.
    ClientFull,
    /// All places are in use.
    AllFull,
}

impl AdmissionLimits {
    /// Decides about a newcomer of this client.
    pub fn admit(self, client: ClientNetwork, occupants: &[Occupant]) -> Admission {
        let own = occupants.iter().filter(|occupant| occupant.client == client).count();
        if own >= self.per_client {
            let replaced = longest_unused(occupants, |occupant| occupant.client == client);
            return replaced.map_or(Admission::ClientFull, Admission::Replaces);
        }
        if occupants.len() < self.total {
            return Admission::Free;
        }
        longest_unused(occupants, |_| true).map_or(Admission::AllFull, Admission::Replaces)
    }
}

/// The index of the connection that goes first: of the client with most unused connections the least used one, and of equal ones the oldest.
fn longest_unused(occupants: &[Occupant], is_candidate: impl Fn(&Occupant) -> bool) -> Option<usize> {
    let is_unused = |occupant: &Occupant| occupant.usage != ConnectionUse::Active && is_candidate(occupant);
    let mut unused_by_client: BTreeMap<ClientNetwork, usize> = BTreeMap::new();
    for occupant in occupants.iter().filter(|occupant| is_unused(occupant)) {
        *unused_by_client.entry(occupant.client).or_default() += 1;
    }
    let unused = occupants.iter().enumerate().filter(|(_, occupant)| is_unused(occupant));
    let first = unused.min_by_key(|(_, occupant)| {
        (Reverse(unused_by_client.get(&occupant.client).copied()), occupant.usage, occupant.since)
    });
    first.map(|(index, _)| index)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: AdmissionLimits = AdmissionLimits { total: 6, per_client: 4 };

    fn client(last_byte: u8) -> ClientNetwork {
        ClientNetwork::from_ipv6_octets([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 192, 0, 2, last_byte])
    }

    fn occupants(rows: &[(u8, ConnectionUse, i64)]) -> Vec<Occupant> {
        let row = |&(last_byte, usage, since_ms): &(u8, ConnectionUse, i64)| Occupant {
            client: client(last_byte),
            usage,
            since: Timestamp::from_millis(since_ms),
        };
        rows.iter().map(row).collect()
    }

    #[test]
    fn an_ipv4_address_and_a_64_bit_network_of_ipv6_are_one_client_each() {
        let network = |text: &str| {
            let address: std::net::Ipv6Addr = text.parse().unwrap();
            ClientNetwork::from_ipv6_octets(address.octets())
        };
        assert_ne!(network("::ffff:192.0.2.1"), network("::ffff:192.0.2.2"));
        assert_eq!(network("2001:db8:0:7::1"), network("2001:db8:0:7:ffff::9"));
        assert_ne!(network("2001:db8:0:7::1"), network("2001:db8:0:8::1"));
    }

    #[test]
    fn a_newcomer_gets_a_free_place_until_all_or_those_of_its_client_are_taken() {
        use ConnectionUse::Active;
        let own = occupants(&[(1, Active, 0), (1, Active, 1), (1, Active, 2)]);
        assert_eq!(LIMITS.admit(client(1), &own), Admission::Free);
        let own = occupants(&[(1, Active, 0), (1, Active, 1), (1, Active, 2), (1, Active, 3)]);
        assert_eq!(LIMITS.admit(client(1), &own), Admission::ClientFull);
        assert_eq!(LIMITS.admit(client(2), &own), Admission::Free);
        let all = occupants(&[
            (1, Active, 0),
            (2, Active, 1),
            (3, Active, 2),
            (4, Active, 3),
            (5, Active, 4),
            (6, Active, 5),
        ]);
        assert_eq!(LIMITS.admit(client(7), &all), Admission::AllFull);
    }

    #[test]
    fn of_a_full_client_its_own_least_used_connection_makes_room_the_oldest_first() {
        use ConnectionUse::{Active, Idle, Unproven};
        let full = occupants(&[(2, Unproven, 0), (1, Active, 1), (1, Idle, 2), (1, Unproven, 9), (1, Unproven, 5)]);
        assert_eq!(LIMITS.admit(client(1), &full), Admission::Replaces(4));
        let full = occupants(&[(2, Unproven, 0), (1, Active, 1), (1, Idle, 7), (1, Idle, 6), (1, Active, 0)]);
        assert_eq!(LIMITS.admit(client(1), &full), Admission::Replaces(3));
    }

    #[test]
    fn at_a_full_door_the_client_with_most_unused_connections_makes_room() {
        use ConnectionUse::{Active, Idle, Unproven};
        // Client 3 has more connections, and uses them; client 2 came last and says nothing yet.
        let full =
            occupants(&[(1, Idle, 8), (1, Idle, 7), (2, Unproven, 0), (3, Active, 0), (3, Active, 0), (3, Active, 0)]);
        for newcomer in [1, 2, 9] {
            assert_eq!(LIMITS.admit(client(newcomer), &full), Admission::Replaces(1), "{newcomer}");
        }
    }
}

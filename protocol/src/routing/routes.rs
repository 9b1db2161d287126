//! Who was heard by which way, and when last.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{Address, ComponentId, HostClock, LinkId, PeerId, SystemId, TimeDelta, Timestamp};

use super::endpoint::{Endpoint, MAX_PEERS};

/// A route expires after this long without a frame: thirty missed heartbeats.
pub(super) const LIFETIME: TimeDelta = TimeDelta::from_millis(30_000);
/// Most routes.
const MAX_ROUTES: usize = MAX_PEERS;

/// Behind one way no honest neighbourhood is larger than this: as many systems as eight bits name.
const MANY_ROUTES: usize = 255;

/// Routes that were learnt by listening.
#[derive(Clone, Debug, Default)]
pub(super) struct RouteTable(BTreeMap<(Address, Endpoint), Timestamp<HostClock>>);

impl RouteTable {
    /// Records a received frame.
    pub(super) fn observe(&mut self, now: Timestamp<HostClock>, source: Address, way: Endpoint) {
        if self.0.len() >= MAX_ROUTES && !self.0.contains_key(&(source, way)) {
            self.evict_routes(now);
        }
        self.0.insert((source, way), now);
    }

    /// The ways to one component, by rising link and peer.
    pub(super) fn to_component(&self, now: Timestamp<HostClock>, address: Address) -> BTreeSet<Endpoint> {
        self.endpoints_in_range(now, address, address)
    }

    /// The ways to any component of a system.
    pub(super) fn to_system(&self, now: Timestamp<HostClock>, system: SystemId) -> BTreeSet<Endpoint> {
        let component = |number| Address { system, component: ComponentId(number) };
        self.endpoints_in_range(now, component(0), component(u8::MAX))
    }

    /// Removes all routes of a link.
    pub(super) fn forget_link(&mut self, link: LinkId) {
        self.0.retain(|(_, way), _| way.link != link);
    }

    fn endpoints_in_range(&self, now: Timestamp<HostClock>, first: Address, last: Address) -> BTreeSet<Endpoint> {
        let lowest = Endpoint { link: LinkId(0), peer: PeerId(0) };
        let highest = Endpoint { link: LinkId(u16::MAX), peer: PeerId(u32::MAX) };
        self.0
            .range((first, lowest)..=(last, highest))
            .filter(|(_, heard)| now - **heard <= LIFETIME)
            .map(|((_, way), _)| *way)
            .collect()
    }

    /// A sender that invents addresses displaces its own entries: of the way with the most routes the older half goes, at once,
    /// so that a flood costs no search per frame. If no way has many, the flood comes by invented ways, and the link with the
    /// most loses as much.
    fn evict_routes(&mut self, now: Timestamp<HostClock>) {
        self.0.retain(|_, heard| now - *heard <= LIFETIME);
        if self.0.len() < MAX_ROUTES {
            return;
        }
        let (mut of_ways, mut of_links) = (BTreeMap::new(), BTreeMap::new());
        for (_, way) in self.0.keys() {
            *of_ways.entry(*way).or_insert(0_usize) += 1;
            *of_links.entry(way.link).or_insert(0_usize) += 1;
        }
        let loudest_way = of_ways.into_iter().max_by_key(|(_, routes)| *routes);
        let loudest_link = of_links.into_iter().max_by_key(|(_, routes)| *routes);
        match (loudest_way, loudest_link) {
            (Some((way, routes)), _) if routes >= MANY_ROUTES => {
                self.evict_older_half(|found| found == way);
            }
            (_, Some((link, _))) => self.evict_older_half(|found| found.link == link),
            _ => {}
        }
    }

    fn evict_older_half(&mut self, is_one: impl Fn(Endpoint) -> bool) {
        let found = self.0.iter().filter(|((_, way), _)| is_one(*way));
        let mut by_silence: Vec<_> = found.map(|(key, heard)| (*heard, *key)).collect();
        by_silence.sort_unstable();
        for (_, key) in by_silence.iter().take(by_silence.len().div_ceil(2)) {
            self.0.remove(key);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    fn endpoint(link: u16, peer: u32) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(peer) }
    }

    #[test]
    fn who_falls_silent_is_forgotten_way_by_way() {
        let mut routes = RouteTable::default();
        let robot = Address::new(1, 1);
        routes.observe(at(0), robot, endpoint(0, 0));
        routes.observe(at(20_000), robot, endpoint(1, 0));
        let ways = |now| routes.to_component(at(now), robot).into_iter();
        assert!(ways(30_000).eq([endpoint(0, 0), endpoint(1, 0)]));
        assert!(ways(30_001).eq([endpoint(1, 0)]));
        assert_eq!(ways(50_001).count(), 0);
    }

    #[test]
    fn a_system_is_where_any_of_its_components_is_and_nowhere_else() {
        let mut routes = RouteTable::default();
        routes.observe(at(0), Address::new(1, 0), endpoint(0, 0));
        routes.observe(at(0), Address::new(1, 255), endpoint(1, 7));
        routes.observe(at(0), Address::new(2, 1), endpoint(2, 0));
        routes.observe(at(0), Address::new(0, 255), endpoint(3, 0));
        let ways = routes.to_system(at(0), SystemId(1));
        assert!(ways.into_iter().eq([endpoint(0, 0), endpoint(1, 7)]));
        routes.forget_link(LinkId(0));
        let ways = routes.to_system(at(0), SystemId(1));
        assert!(ways.into_iter().eq([endpoint(1, 7)]));
    }

    fn sender(number: u32) -> Address {
        Address::new((number / 256 % 256) as u8, (number % 256) as u8)
    }

    #[test]
    fn who_invents_senders_pushes_out_his_own() {
        let mut routes = RouteTable::default();
        let robot = Address::new(1, 1);
        routes.observe(at(0), robot, endpoint(0, 0));
        routes.observe(at(0), robot, endpoint(1, 0));
        for number in 0..60_000 {
            routes.observe(at(1), sender(number + 512), endpoint(1, 7));
            assert!(routes.0.len() <= MAX_ROUTES);
        }
        assert!(routes.to_component(at(2), robot).into_iter().eq([endpoint(0, 0), endpoint(1, 0)]));
        assert!(routes.0.len() > MAX_ROUTES / 4);
        assert_eq!(routes.to_component(at(2), sender(60_511)).len(), 1);
    }

    #[test]
    fn who_invents_ways_as_well_pushes_nobody_out_on_another_link() {
        let mut routes = RouteTable::default();
        let robot = Address::new(1, 1);
        routes.observe(at(0), robot, endpoint(0, 0));
        for number in 0..60_000 {
            routes.observe(at(1), sender(number + 512), endpoint(1, number));
            assert!(routes.0.len() <= MAX_ROUTES);
        }
        assert_eq!(routes.to_component(at(2), robot).len(), 1);
    }
}

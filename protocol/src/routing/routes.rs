//! Who was heard by which way, and when last.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{
    Address, ComponentId, HostClock, LinkId, PeerId, Span, Stamp, SystemId,
};

use super::Way;

/// A way by which somebody was not heard for this long leads to him no more: thirty missed heartbeats, and the time after
/// which a pipeline forgets a peer.
const LIFETIME: Span = Span::from_millis(30_000);
/// Most routes; the oldest goes first. As many as a link may have peers.
const MOST_ROUTES: usize = 4_096;

/// Routes that were learnt by listening.
#[derive(Clone, Debug, Default)]
pub(super) struct Routes(BTreeMap<(Address, Way), Stamp<HostClock>>);

impl Routes {
    /// Somebody was heard.
    pub(super) fn learn(&mut self, now: Stamp<HostClock>, source: Address, way: Way) {
        if self.0.len() >= MOST_ROUTES && !self.0.contains_key(&(source, way)) {
            self.make_room(now);
        }
        self.0.insert((source, way), now);
    }

    /// The ways to one component, by rising link and peer.
    pub(super) fn to_component(&self, now: Stamp<HostClock>, address: Address) -> BTreeSet<Way> {
        self.between(now, address, address)
    }

    /// The ways to any component of a system.
    pub(super) fn to_system(&self, now: Stamp<HostClock>, system: SystemId) -> BTreeSet<Way> {
        let component = |number| Address {
            system,
            component: ComponentId(number),
        };
        self.between(now, component(0), component(u8::MAX))
    }

    /// Nobody is heard on this link any more.
    pub(super) fn forget_link(&mut self, link: LinkId) {
        self.0.retain(|(_, way), _| way.link != link);
    }

    fn between(&self, now: Stamp<HostClock>, first: Address, last: Address) -> BTreeSet<Way> {
        let lowest = Way {
            link: LinkId(0),
            peer: PeerId(0),
        };
        let highest = Way {
            link: LinkId(u16::MAX),
            peer: PeerId(u32::MAX),
        };
        self.0
            .range((first, lowest)..=(last, highest))
            .filter(|(_, heard)| now - **heard <= LIFETIME)
            .map(|((_, way), _)| *way)
            .collect()
    }

    fn make_room(&mut self, now: Stamp<HostClock>) {
        self.0.retain(|_, heard| now - *heard <= LIFETIME);
        if self.0.len() >= MOST_ROUTES
            && let Some(oldest) = self
                .0
                .iter()
                .min_by_key(|(_, heard)| **heard)
                .map(|(k, _)| *k)
        {
            self.0.remove(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Stamp<HostClock> {
        Stamp::from_millis(millis)
    }

    fn way(link: u16, peer: u32) -> Way {
        Way {
            link: LinkId(link),
            peer: PeerId(peer),
        }
    }

    #[test]
    fn who_falls_silent_is_forgotten_way_by_way() {
        let mut routes = Routes::default();
        let robot = Address::new(1, 1);
        routes.learn(at(0), robot, way(0, 0));
        routes.learn(at(20_000), robot, way(1, 0));
        let ways = |now| routes.to_component(at(now), robot).into_iter();
        assert!(ways(30_000).eq([way(0, 0), way(1, 0)]));
        assert!(ways(30_001).eq([way(1, 0)]));
        assert_eq!(ways(50_001).count(), 0);
    }

    #[test]
    fn a_system_is_where_any_of_its_components_is_and_nowhere_else() {
        let mut routes = Routes::default();
        routes.learn(at(0), Address::new(1, 0), way(0, 0));
        routes.learn(at(0), Address::new(1, 255), way(1, 7));
        routes.learn(at(0), Address::new(2, 1), way(2, 0));
        routes.learn(at(0), Address::new(0, 255), way(3, 0));
        let ways = routes.to_system(at(0), SystemId(1));
        assert!(ways.into_iter().eq([way(0, 0), way(1, 7)]));
        routes.forget_link(LinkId(0));
        let ways = routes.to_system(at(0), SystemId(1));
        assert!(ways.into_iter().eq([way(1, 7)]));
    }

    #[test]
    fn the_oldest_route_gives_way_when_there_are_too_many() {
        let mut routes = Routes::default();
        for peer in 0..=MOST_ROUTES as u32 {
            routes.learn(at(i64::from(peer)), Address::new(1, 1), way(0, peer));
        }
        let ways = routes.to_component(at(5_000), Address::new(1, 1));
        assert_eq!(ways.len(), MOST_ROUTES);
        assert!(!ways.contains(&way(0, 0)) && ways.contains(&way(0, 1)));
    }
}

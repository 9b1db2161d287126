//! Which block of the configuration a robot takes, found without a look at all of them: in a large room each robot has one.

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, LinkId, SystemId};

use crate::config::RobotBlock;

/// The blocks of a configuration by the system that they ask for.
#[derive(Debug)]
pub(crate) struct RobotBlockIndex {
    /// Places of blocks, in their order; `None` has those that take any system.
    by_system: BTreeMap<Option<SystemId>, Vec<usize>>,
}

impl RobotBlockIndex {
    pub(crate) fn new(blocks: &[RobotBlock]) -> Self {
        let mut by_system: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (place, block) in blocks.iter().enumerate() {
            by_system.entry(block.matches.system).or_default().push(place);
        }
        Self { by_system }
    }

    /// The first block for the robot that is heard on a link under an address, that of its own frames; `None` if there is none. `blocks`
    /// are those that this was made from.
    pub(crate) fn find(&self, blocks: &[RobotBlock], link: LinkId, address: Address) -> Option<usize> {
        let first = |system| {
            let places = self.by_system.get(&system)?;
            places.iter().copied().find(|place| blocks[*place].matches.is_for(link, address))
        };
        [Some(address.system), None].into_iter().filter_map(first).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{RobotConfig, RobotMatch};
    use crate::test_config::station_config;
    use posebridge_telemetry::ComponentId;

    #[test]
    fn the_block_is_the_first_of_all_that_match() {
        let mut config = station_config();
        let links = [None, Some(LinkId(1)), Some(LinkId(2))];
        let systems = [Some(SystemId(3)), None, Some(SystemId(1))];
        let components = [Some(ComponentId(1)), Some(ComponentId(2)), None];
        for (tag, number) in (0_u32..).zip((0..27).map(|k: usize| k * 10 % 27)) {
            let matches = RobotMatch {
                link: links[number % 3],
                system: systems[number / 3 % 3],
                component: components[number / 9],
            };
            config.robots.push(RobotBlock { matches, robot: RobotConfig { tag: Some(tag), ..config.robot.clone() } });
        }
        for blocks in (0..=27).rev() {
            config.robots.truncate(blocks);
            let index = RobotBlockIndex::new(&config.robots);
            for (link, system, component) in (0..64).map(|k| (LinkId(k % 4), (k / 4 % 4) as u8, (k / 16) as u8)) {
                let address = Address::new(system, component);
                let first = config.robots.iter().position(|block| block.matches.is_for(link, address));
                assert_eq!(index.find(&config.robots, link, address), first);
            }
        }
    }
}

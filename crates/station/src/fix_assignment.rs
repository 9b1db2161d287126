//! Assigns a camera's fix to a robot.

use posebridge_protocol::routing::Endpoint;
use posebridge_telemetry::Address;

use crate::config::StationConfig;
use crate::robot_table::RobotTable;
use crate::sender_identity::RobotIndex;

/// The robot of a fix; `None` if that is ambiguous, or if the robot is not known yet.
///
/// A fix of a tag that the configuration assigns to a robot is for that robot. Any other is for the only robot on its
/// sender's endpoint, else for the only robot at all, else for the only one in its sender's system, unless that one has
/// another tag.
pub(crate) fn robot_of_fix(
    robots: &RobotTable,
    config: &StationConfig,
    endpoint: Endpoint,
    sender: Address,
    tag: Option<u32>,
) -> Option<RobotIndex> {
    let nearest =
        || robots.identities.only_at(endpoint).or_else(|| robots.only()).or_else(|| robots.of_system(sender.system));
    let Some(tag) = tag else {
        return nearest();
    };
    let mut configured = config.robots.iter().map(|block| &block.robot).chain([&config.robot]);
    if configured.any(|robot| robot.tag == Some(tag)) {
        return robots.of_tag(tag);
    }
    nearest().filter(|index| robots.get(*index).tag.is_none())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{RobotBlock, RobotConfig, RobotMatch};
    use crate::observers::Observers;
    use crate::sender_identity::MessageOrigin;
    use crate::test_config::station_config;
    use posebridge_estimator::find_filter;
    use posebridge_telemetry::{LinkId, PeerId, SystemId, Timestamp};

    #[test]
    fn a_fix_of_a_tag_is_for_the_robot_with_that_tag_and_for_no_other() {
        let mut config = station_config();
        let block = |system, tag| RobotBlock {
            matches: RobotMatch { system: Some(SystemId(system)), ..RobotMatch::default() },
            robot: RobotConfig { tag: Some(tag), ..config.robot.clone() },
        };
        config.robots = vec![block(1, 7), block(2, 8)];
        let mut robots = RobotTable::new(find_filter("pose").unwrap(), &config);
        let endpoint = Endpoint { link: LinkId(0), peer: PeerId(0) };
        let address = Address::new(1, 1);
        let origin = MessageOrigin { endpoint, home: endpoint.link, address, is_new: true, is_telemetry: true };
        assert_eq!(robots.adopt(Timestamp::ZERO, origin, &config, &mut Observers::default()), Some(0));
        // The robot of tag 8 was not received yet, and tag 9 is on none.
        for (tag, robot) in [(None, Some(0)), (Some(7), Some(0)), (Some(8), None), (Some(9), None)] {
            assert_eq!(robot_of_fix(&robots, &config, endpoint, Address::new(1, 100), tag), robot, "tag {tag:?}");
        }
    }
}

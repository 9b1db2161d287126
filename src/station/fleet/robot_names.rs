//! The names by which the fleet knows the robots of this station.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use posebridge_fleet::{RobotName, StationName};
use posebridge_station::{Robot, Station};
use posebridge_telemetry::{Address, LinkId, RobotId};

use crate::config::Config;

/// The robots of this station by their names, for its viewers, too.
pub(super) type SharedRobotIds = Arc<Mutex<BTreeMap<RobotName, RobotId>>>;

/// Names in both directions.
pub(super) struct RobotNames {
    names: BTreeMap<RobotId, Option<RobotName>>,
    ids: SharedRobotIds,
    /// Of links whose robots say no id of their own, the name of their robot.
    by_link: BTreeMap<LinkId, String>,
}

impl RobotNames {
    /// A robot has the name of its `[[robot]]` block, else its MAVLink ids. A brick without MAVLink has none: it gets a name that no robot of
    /// another station has, and so stays at this station.
    pub(super) fn new(config: &Config, station: &StationName) -> Self {
        let bricks = config.links.iter().enumerate().filter(|(_, link)| link.brick.is_some());
        let by_link = bricks.map(|(index, _)| (LinkId(index as u16), format!("{station}.link{index}")));
        Self { names: BTreeMap::new(), ids: SharedRobotIds::default(), by_link: by_link.collect() }
    }

    /// Names a robot, unless another one of this station has the name.
    pub(super) fn add(&mut self, station: &Station, robot: RobotId) {
        if self.names.contains_key(&robot) {
            return;
        }
        let Some(configured) = station.robots().iter().find(|known| known.id() == robot).map(Robot::name) else {
            // A camera or another participant that is no robot.
            return;
        };
        let text = match (configured, self.by_link.get(&robot.link)) {
            (Some(name), _) => name.to_owned(),
            (None, Some(name)) => name.clone(),
            (None, None) => address_name(robot.address),
        };
        let name = match RobotName::new(&text) {
            Ok(name) => match self.id(&name) {
                None => Some(name),
                Some(other) => {
                    tracing::warn!(
                        "robot {robot} has the same name in the fleet as robot {other}, `{name}`, and is not served: give it a name or \
                         another system id"
                    );
                    None
                }
            },
            Err(error) => {
                tracing::warn!("robot {robot} is not served: its name `{text}` is none in a fleet: {error}");
                None
            }
        };
        if let Some(name) = &name {
            self.ids().insert(name.clone(), robot);
        }
        self.names.insert(robot, name);
    }

    pub(super) fn name(&self, robot: RobotId) -> Option<&RobotName> {
        self.names.get(&robot)?.as_ref()
    }

    pub(super) fn id(&self, robot: &RobotName) -> Option<RobotId> {
        self.ids().get(robot).copied()
    }

    pub(super) fn shared_ids(&self) -> SharedRobotIds {
        Arc::clone(&self.ids)
    }

    pub(super) fn on_link(&self, link: LinkId) -> Vec<RobotName> {
        self.ids().iter().filter(|(_, id)| id.link == link).map(|(name, _)| name.clone()).collect()
    }

    fn ids(&self) -> MutexGuard<'_, BTreeMap<RobotName, RobotId>> {
        self.ids.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The name of a robot without one of its own.
fn address_name(address: Address) -> String {
    format!("{}-{}", address.system, address.component)
}

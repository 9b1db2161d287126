//! `[fleet]`: stations that share robots (docs/fleet.md).

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use posebridge_fleet::{FleetName, RobotName, StationName};
use posebridge_station::OwnershipPolicy;
use posebridge_telemetry::TimeDelta;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::robot_blocks::RobotBlockSection;

/// The fleet that the station belongs to.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct FleetSection {
    /// Its name; empty for a station of its own.
    pub name: String,
    /// The name of this station in it; empty for that of the computer.
    pub station: String,
    /// Stations to connect to, as Zenoh writes it: tcp/192.168.1.5:7447.
    pub join: Vec<String>,
    /// Where other stations may connect; without it only those of this computer can.
    pub listen: Vec<String>,
    /// Whether stations are looked for by multicast on the local network.
    pub multicast: bool,
    /// A configuration of Zenoh with TLS, users and access control.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zenoh_config: Option<String>,
    /// How often the state of each robot goes to the others, who continue from it when this station dies.
    pub state_interval_ms: u32,
}

impl Default for FleetSection {
    fn default() -> Self {
        Self {
            name: String::new(),
            station: String::new(),
            join: Vec::new(),
            listen: Vec::new(),
            multicast: false,
            zenoh_config: None,
            state_interval_ms: 1_000,
        }
    }
}

/// A checked [`FleetSection`] with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetSettings {
    pub fleet: FleetName,
    /// `None` for the computer's.
    pub station: Option<StationName>,
    pub join: Vec<String>,
    pub listen: Vec<String>,
    pub multicast: bool,
    pub zenoh_config: Option<PathBuf>,
    pub state_interval: TimeDelta,
}

impl FleetSection {
    pub(super) const fn ownership(&self) -> OwnershipPolicy {
        if self.name.is_empty() { OwnershipPolicy::Unmanaged } else { OwnershipPolicy::Fleet }
    }

    /// `None` without a fleet. Fails if a name is none, also that of a robot: robots have the same names at every station.
    pub fn checked(&self, robots: &[RobotBlockSection]) -> Result<Option<FleetSettings>> {
        if self.name.is_empty() {
            ensure!(
                self.join.is_empty() && self.listen.is_empty(),
                "`fleet.join` or `fleet.listen` is given, but no fleet: add `--fleet NAME` or `fleet.name`"
            );
            return Ok(None);
        }
        let fleet = FleetName::new(&self.name).with_context(|| format!("`fleet.name` is `{}`", self.name))?;
        let station = (!self.station.is_empty()).then(|| StationName::new(&self.station)).transpose();
        let station = station.with_context(|| format!("`fleet.station` is `{}`", self.station))?;
        for block in robots {
            let name = &block.robot.name;
            RobotName::new(name).with_context(|| {
                format!("`robot.name` is `{name}`; in a fleet it is part of a key, the same at every station")
            })?;
        }
        ensure!(self.state_interval_ms >= 100, "`fleet.state_interval_ms` is {}; at least 100", self.state_interval_ms);
        Ok(Some(FleetSettings {
            fleet,
            station,
            join: self.join.clone(),
            listen: self.listen.clone(),
            multicast: self.multicast,
            zenoh_config: self.zenoh_config.as_ref().map(PathBuf::from),
            state_interval: TimeDelta::from_millis(i64::from(self.state_interval_ms)),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_need_a_fleet_and_its_names_are_parts_of_keys() {
        assert_eq!(FleetSection::default().checked(&[]).unwrap(), None);
        let joined = FleetSection { join: vec!["tcp/h:7447".to_owned()], ..FleetSection::default() };
        let error = |section: FleetSection| format!("{:#}", section.checked(&[]).unwrap_err());
        assert!(error(joined).contains("--fleet NAME"));
        let named = |name: &str| FleetSection { name: name.to_owned(), ..FleetSection::default() };
        assert!(named("class-7").checked(&[]).unwrap().is_some());
        assert!(error(named("class/7")).contains("'/'"));
        assert!(error(FleetSection { state_interval_ms: 99, ..named("a") }).contains("99"));
    }
}

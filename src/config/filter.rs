//! The filter of a robot: which one, its tunables, and everything that it is built from.

use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow};
use posebridge_estimator::{FILTERS, FilterConfig, FilterEntry, Initialization, Params, find_filter};
use posebridge_telemetry::ArenaMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::robot::RobotFile;

/// The filter and its tunables.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema, PartialEq)]
#[serde(default)]
pub struct FilterSection {
    /// Name of a filter.
    pub name: String,
    /// Its tunables, by key.
    #[serde(flatten)]
    pub params: BTreeMap<String, f64>,
}

impl Default for FilterSection {
    fn default() -> Self {
        Self { name: "pose".to_owned(), params: BTreeMap::new() }
    }
}

impl FilterSection {
    /// The filter that it names.
    ///
    /// # Errors
    /// There is no such filter; the message lists those that there are.
    pub fn entry(&self) -> Result<&'static FilterEntry> {
        find_filter(&self.name)
            .ok_or_else(|| anyhow!("`filter.name` is `{}`; there are: {}", self.name, names_of_filters()))
    }

    /// Why it would never give a pose, where that is so; with what to do about it.
    pub fn warning(&self, robot: &RobotFile) -> Option<String> {
        let name = &self.name;
        match find_filter(name)?.initialization {
            Initialization::Start if robot.start.is_none() => Some(format!(
                "the filter `{name}` uses no fixes and has no configured start, so it never gets a pose: give `[robot.start]` with x_m, \
                 y_m, heading_deg, position_sigma_m and heading_sigma_deg, or take another filter, such as `pose`"
            )),
            Initialization::NotApplicable => {
                Some(format!("the filter `{name}` estimates one quantity and no pose; `pose` does"))
            }
            Initialization::Fix | Initialization::Start => None,
        }
    }

    /// The tunables, the defaults where none is given.
    ///
    /// # Errors
    /// A key is unknown, or its value makes no sense.
    pub fn params(&self) -> Result<Params> {
        let mut params = Params::default();
        for (key, value) in &self.params {
            params.set(key, *value).context("`[filter]`")?;
        }
        Ok(params)
    }
}

/// All filters, for people.
pub fn names_of_filters() -> String {
    let names: Vec<_> = FILTERS.iter().map(|entry| entry.name).collect();
    names.join(", ")
}

/// What a filter of this robot is built from: a live station and a replayed recording both come through here, so that the same
/// files give the same filter.
///
/// # Errors
/// A value makes no sense; the message names its key.
pub fn filter_config(robot: &RobotFile, filter: &FilterSection, world: ArenaMap) -> Result<FilterConfig> {
    Ok(FilterConfig {
        geometry: robot.geometry()?,
        noise: robot.noise()?,
        start: robot.start()?,
        params: filter.params()?,
        calibration: robot.calibration()?,
        arena_map: Arc::new(world),
    })
}

//! The fleet of stations that share robots, as this station knows it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::frame::Number;

/// `GET /v1/fleet`: the stations and robots of the fleet, as this station knows them.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FleetState {
    /// The fleet's name.
    pub name: String,
    /// This station first, then those that are connected.
    pub stations: Vec<FleetStationRow>,
    /// Robots that a station owns, or that were heard of in the last minute, by name.
    pub robots: Vec<FleetRobotRow>,
}

/// A station of the fleet.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FleetStationRow {
    /// Names one run of it: a station that was restarted has another one.
    pub id: String,
    /// Its configured name, else that of its computer.
    pub name: String,
    /// Whether it is the station that answers.
    pub is_this: bool,
    /// Its host time minus that of this station, in seconds; `null` before the first exchange of times.
    pub clock_offset_s: Option<f64>,
    /// The true offset is at most this far from that.
    pub clock_uncertainty_s: Option<f64>,
    /// Number of robots that it owns.
    pub robots: usize,
}

/// A robot of the fleet.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FleetRobotRow {
    /// Its name, the same at every station: `fleet_robot` in commands.
    pub name: String,
    /// The station that fuses its observations and takes its commands; `null` while there is none.
    pub owner: Option<FleetOwnerRow>,
    /// Link, system and component, e.g. `0/1/1`, where this station has heard it, too; else `null`.
    pub robot: Option<String>,
    /// The last estimate of its owner; `null` before the first one.
    pub estimate: Option<FleetEstimateRow>,
    /// Estimates of other stations that have arrived.
    pub received: u64,
    /// Estimates that have not, by the numbers that their owner gives them.
    pub lost: u64,
    /// Estimates of earlier owners, which are not shown.
    pub stale: u64,
}

/// The owner of a robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Eq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FleetOwnerRow {
    /// The station's id.
    pub id: String,
    /// The station's name.
    pub name: String,
    /// Whether it is the station that answers.
    pub is_this: bool,
    /// Counts the owners of this robot, from 1.
    pub epoch: u32,
}

/// An estimate that came from the owner of a robot.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FleetEstimateRow {
    /// Of the owner that made it.
    pub epoch: u32,
    /// East.
    pub x_m: Number,
    /// North.
    pub y_m: Number,
    /// Counter-clockwise from east.
    pub heading_rad: Number,
    /// Half the longer axis of the ellipse that holds the position with 95 %.
    pub major_m: Number,
    /// One standard deviation.
    pub heading_sigma_rad: Number,
    /// Whether the position is one in the arena: not while it counts from the robot's start.
    pub is_position_valid: bool,
    /// Whether the heading is known.
    pub is_heading_valid: bool,
    /// Nothing absolute was used for too long.
    pub is_dead_reckoning: bool,
    /// Since the instant of the estimate, by the clocks of both stations; since its arrival while `transit_s` is `null`.
    pub age_s: f64,
    /// From its instant to its arrival here, by the clocks of both stations; `null` while these are not aligned.
    pub transit_s: Option<f64>,
}

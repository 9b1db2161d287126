//! What goes wrong in a drive, in the TOML format of a scenario: kidnaps, wheels that spin, and fixes that err together.
//!
//! Disturbances are spaced evenly; each begins up to a second later, at random.

use serde::Deserialize;

/// The robot is moved to another pose. Afterwards it continues its path, shifted and turned as it was itself.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kidnaps {
    pub first_s: f64,
    pub every_s: f64,
    /// It is carried for so long: the wheels stand and the gyro measures the turn. 0 moves it at once and the gyro measures nothing.
    pub carry_s: f64,
    /// Distance, uniform from here,
    pub least_m: f64,
    /// to here, in any direction.
    pub most_m: f64,
    /// Turn, uniform from here, either way,
    pub least_deg: f64,
    /// to here.
    pub most_deg: f64,
}

/// One wheel, either, spins forward on the spot.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlipBursts {
    pub first_s: f64,
    pub every_s: f64,
    /// The wheel turns by so many counts of its encoder without moving the robot,
    pub counts: u32,
    /// evenly over so many steps.
    pub spread_steps: u32,
}

/// An error of the camera's fixes that is constant within each patch of the floor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patches {
    /// Side of a square patch.
    pub size_m: f64,
    /// Each axis.
    pub sigma_m: f64,
}

/// Runs of fixes that agree with each other and are wrong.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FixBursts {
    pub first_s: f64,
    pub every_s: f64,
    pub lasts_s: f64,
    /// How far off they are, in any direction, constant during a burst.
    pub offset_m: f64,
    /// Whether they are off the robot, or off the place at which it was when the burst began.
    pub follows_robot: bool,
}

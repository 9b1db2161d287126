//! What a scenario requires of the filter that it is made for, in its TOML format.

use serde::Deserialize;

/// Largest values that count as passed; missing ones are not required.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    pub rms_m: Option<f64>,
    /// Of the rms to the bound.
    pub rms_per_bound: Option<f64>,
    /// Of the rms to that of the same drives without bursts of wrong fixes.
    pub rms_per_undisturbed: Option<f64>,
    pub anees_least: Option<f64>,
    pub anees_most: Option<f64>,
    /// From a kidnap's end, or from an unknown start, until the pose is right. With landmarks alone the time begins with the second
    /// landmark that is sighted.
    pub recovery_s: Option<f64>,
    /// Over all runs.
    pub resets: Option<u32>,
    /// Good fixes that are refused in the five seconds after a slip, its first one not counted; on average over runs.
    pub fixes_gated_after_slips: Option<f64>,
}

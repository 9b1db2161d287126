//! The sensors on board that measure the pose against the arena, in the TOML format of a scenario, and what their errors have in common.

use posebridge_telemetry::{Mounting, UncertainValue};
use serde::Deserialize;
use serde::de::{Deserializer, Error};

use crate::config_file::SMALLEST;

/// Not zero, because filters are configured with it.
pub(super) fn sigma_of_filters<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let sigma = f64::deserialize(deserializer)?;
    let complaint =
        || D::Error::custom(format!("{sigma} is less than {SMALLEST}; give more, filters are configured with it"));
    if sigma >= SMALLEST { Ok(sigma) } else { Err(complaint()) }
}

/// A number that each run draws from a normal distribution; a sigma of zero fixes it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrawnValue {
    pub value: f64,
    pub sigma: f64,
}

impl DrawnValue {
    /// What a filter is told of it.
    pub(super) const fn prior(self) -> UncertainValue {
        UncertainValue { value: self.value, sigma: self.sigma }
    }
}

/// Where a sensor sits on the robot, from mid-axle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorPlace {
    /// Forward.
    pub x_m: DrawnValue,
    /// To the left.
    pub y_m: DrawnValue,
    /// Counter-clockwise from forward.
    pub yaw_deg: DrawnValue,
}

impl SensorPlace {
    pub(super) const fn prior(self) -> Mounting {
        let DrawnValue { value, sigma } = self.yaw_deg;
        Mounting {
            x_m: self.x_m.prior(),
            y_m: self.y_m.prior(),
            yaw_rad: UncertainValue { value: value.to_radians(), sigma: sigma.to_radians() },
        }
    }
}

/// Errors of the timestamps of one source.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StampErrors {
    /// How much later than the measurement the timestamp is.
    pub offset_s: DrawnValue,
    /// How much faster the source's clock runs; it is right at the start.
    pub skew_ppm: DrawnValue,
}

impl StampErrors {
    pub const NONE: Self =
        Self { offset_s: DrawnValue { value: 0.0, sigma: 0.0 }, skew_ppm: DrawnValue { value: 0.0, sigma: 0.0 } };
}

/// A camera or scanner on board that measures range and bearing of landmarks.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Landmarks {
    /// In the map.
    pub positions_m: Vec<[f64; 2]>,
    /// Of their true positions about those of the map, each axis.
    #[serde(default)]
    pub map_sigma_m: f64,
    /// It then measures all landmarks in view.
    pub every_steps: u32,
    /// From a timestamp to the arrival.
    pub delay_steps: u32,
    /// The constant part of the range's noise,
    pub range_sigma_m: f64,
    /// and the part that is proportional to the range.
    #[serde(default)]
    pub range_share: f64,
    #[serde(deserialize_with = "sigma_of_filters")]
    pub bearing_sigma_deg: f64,
    /// The whole angle, about the sensor's axis.
    pub field_of_view_deg: f64,
    pub max_range_m: f64,
    #[serde(default)]
    pub mounting: SensorPlace,
    #[serde(default)]
    pub stamps: StampErrors,
}

/// A radio tag that measures the ranges to beacons.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Beacons {
    pub positions_m: Vec<[f64; 2]>,
    /// It then measures all beacons in reach.
    pub every_steps: u32,
    /// From a timestamp to the arrival.
    pub delay_steps: u32,
    /// The constant part of the range's noise,
    pub range_sigma_m: f64,
    /// and the part that is proportional to the range.
    #[serde(default)]
    pub range_share: f64,
    /// Of each beacon's constant error.
    #[serde(default)]
    pub offset_sigma_m: f64,
    /// Of each beacon's relative error.
    #[serde(default)]
    pub scale_sigma: f64,
    pub max_range_m: f64,
    #[serde(default)]
    pub mounting: SensorPlace,
    #[serde(default)]
    pub stamps: StampErrors,
}

/// A compass.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Compass {
    pub every_steps: u32,
    /// From a timestamp to the arrival.
    pub delay_steps: u32,
    #[serde(deserialize_with = "sigma_of_filters")]
    pub heading_sigma_deg: f64,
    #[serde(default)]
    pub mounting: SensorPlace,
    #[serde(default)]
    pub stamps: StampErrors,
}

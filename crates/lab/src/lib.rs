//! The laboratory: experiments, calibration, identification and tuning, as pure functions over observations.
//!
//! The program reads recordings and simulates drives; these modules evaluate them and return values, tables and pages of
//! [`posebridge_report`]. No IO, no clock, and random numbers only from a given seed: two calls with the same data give the same bytes.

use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::{FilterConfig, Params};
use posebridge_telemetry::{Calibration, DriveGeometry, Meters, Radians, SensorNoise};

pub mod accuracy;
pub mod calibration;
pub mod clocks;
pub mod end_errors;
pub mod identification;
pub mod indirect_map;
pub mod noise_identification;
pub mod recorded_drive;
pub mod square;
pub mod statistics;
#[cfg(test)]
#[path = "../tests/lab/support.rs"]
mod test_support;
pub mod tuning;
pub mod wall;

/// For a filter that uses no wheels.
fn config_without_wheels(noise: SensorNoise, params: Params) -> FilterConfig {
    let geometry = DriveGeometry {
        left_wheel_radius: Meters(1.0),
        right_wheel_radius: Meters(1.0),
        track_width: Meters(1.0),
        tick: Radians(1.0),
    };
    let (calibration, arena_map) = (Calibration::default(), std::sync::Arc::default());
    FilterConfig { geometry, noise, start: None, params, calibration, arena_map, slow_sensor: SlowSensor::UNKNOWN }
}

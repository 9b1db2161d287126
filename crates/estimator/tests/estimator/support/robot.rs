//! The robot of the tests: a LEGO robot with one-degree encoders and a one-degree gyro.

use posebridge_estimator::models::slow_sensor::SlowSensor;
use posebridge_estimator::{FilterConfig, Params};
use posebridge_telemetry::{Calibration, DriveGeometry, Meters, Pose, Radians, SensorNoise, StartPose, UncertainValue};

pub(crate) const DEGREE: f64 = std::f64::consts::PI / 180.0;
pub(crate) const RADIUS_M: f64 = 0.028;
pub(crate) const TRACK_M: f64 = 0.112;

pub(crate) const NOISE: SensorNoise = SensorNoise {
    wheel_travel_m_per_sqrt_m: 0.0008,
    travel_m_per_sqrt_m: 0.0,
    turn_rad_per_sqrt_rad: 0.004,
    heading_rad_per_sqrt_m: 0.0,
    gyro_rad_per_s: 0.6 * DEGREE,
    gyro_resolution_rad_per_s: DEGREE,
    gyro_bias_rad_per_s: DEGREE,
    gyro_bias_walk_rad_per_s_sqrt_s: 0.01 * DEGREE,
    fix_position_m: 0.005,
    fix_heading_rad: DEGREE,
    ..SensorNoise::EXACT
};

pub(crate) const GEOMETRY: DriveGeometry = DriveGeometry {
    left_wheel_radius: Meters(RADIUS_M),
    right_wheel_radius: Meters(RADIUS_M),
    track_width: Meters(TRACK_M),
    tick: Radians(DEGREE),
};

/// The robot at the arena's origin, known to a tenth of a millimetre.
pub(crate) fn config() -> FilterConfig {
    FilterConfig {
        geometry: GEOMETRY,
        noise: NOISE,
        start: Some(StartPose { pose: Pose::default(), position_sigma_m: 1e-4, heading_sigma_rad: 1e-4 }),
        params: Params::default(),
        calibration: Calibration::default(),
        arena_map: std::sync::Arc::default(),
        slow_sensor: SlowSensor::UNKNOWN,
    }
}

/// Zero, give or take.
pub(crate) fn unknown(sigma: f64) -> UncertainValue {
    UncertainValue { value: 0.0, sigma }
}

/// How wrong the geometry of a kit may be whose track was measured with a ruler, one standard deviation, relative: mean radius,
/// difference of the radii, track.
pub(crate) const GEOMETRY_SIGMAS: [f64; 3] = [0.005, 0.005, 0.03];

/// The same robot, configured with the sigmas of its geometry.
pub(crate) fn learning_geometry() -> FilterConfig {
    let [radius, difference, track] = GEOMETRY_SIGMAS;
    FilterConfig {
        calibration: Calibration {
            radius_scale: unknown(radius),
            radius_difference: unknown(difference),
            track_scale: unknown(track),
            ..Calibration::default()
        },
        ..config()
    }
}

//! Two wheels on one axle: wheel travel to body motion, and how uncertain that is.
//!
//! # Model
//! ```text
//! d   = (s_L + s_R) / 2
//! dth = (s_R - s_L) / b
//! var s_i = k_w^2 |s_i|                                        each wheel for itself
//! var d   = (var s_L + var s_R) / 4 + k_d^2 |d|
//! var dth = (var s_L + var s_R) / b^2 + k_t^2 |dth| + k_h^2 |d|
//! cov(d, dth) = (var s_R - var s_L) / (2 b)
//! ```
//! At rest there is no noise: a robot that stands does not become uncertain.
//!
//! # Sources
//! Paper 1, equation 14 (with half the track for its r); square-root-of-distance law: Borenstein and Feng (1996);
//! docs/maths/pose.md section 2.

use posebridge_telemetry::{DriveGeometry, SensorNoise};

use super::se2::BodyStep;

/// Travel of the two wheels' contact points, in metres, forward positive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WheelTravel {
    /// Of the left wheel.
    pub left_m: f64,
    /// Of the right wheel.
    pub right_m: f64,
}

/// Uncertainty of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepNoise {
    /// Variance of the distance, m².
    pub forward_var_m2: f64,
    /// Variance of the change of heading, rad².
    pub turn_var_rad2: f64,
    /// Covariance of the two, m rad.
    pub forward_turn_m_rad: f64,
}

/// Turns wheel travel into body motion, exact while neither wheel slips.
pub fn body_step(travel: WheelTravel, geometry: &DriveGeometry) -> BodyStep {
    BodyStep {
        forward_m: 0.5 * (travel.left_m + travel.right_m),
        turn_rad: (travel.right_m - travel.left_m) / geometry.track_width.0,
    }
}

/// How uncertain a step over this travel is.
pub fn step_noise(travel: WheelTravel, geometry: &DriveGeometry, noise: &SensorNoise) -> StepNoise {
    let step = body_step(travel, geometry);
    let b = geometry.track_width.0;
    let wheel_var = noise.wheel_travel_m_per_sqrt_m.powi(2);
    let left_var = wheel_var * travel.left_m.abs();
    let right_var = wheel_var * travel.right_m.abs();
    let d = step.forward_m.abs();
    StepNoise {
        forward_var_m2: 0.25 * (left_var + right_var) + noise.travel_m_per_sqrt_m.powi(2) * d,
        turn_var_rad2: (left_var + right_var) / (b * b)
            + noise.turn_rad_per_sqrt_rad.powi(2) * step.turn_rad.abs()
            + noise.heading_rad_per_sqrt_m.powi(2) * d,
        forward_turn_m_rad: (right_var - left_var) / (2.0 * b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Meters, Radians};

    const GEOMETRY: DriveGeometry = DriveGeometry {
        left_wheel_radius: Meters(0.028),
        right_wheel_radius: Meters(0.028),
        track_width: Meters(0.1),
        tick: Radians(0.017_453_3),
    };

    #[test]
    fn opposite_wheels_turn_in_place() {
        let step = body_step(WheelTravel { left_m: -0.05, right_m: 0.05 }, &GEOMETRY);
        assert_eq!(step, BodyStep { forward_m: 0.0, turn_rad: 1.0 });
    }

    #[test]
    fn at_rest_there_is_no_noise() {
        let noise = SensorNoise {
            wheel_travel_m_per_sqrt_m: 1.0,
            travel_m_per_sqrt_m: 1.0,
            turn_rad_per_sqrt_rad: 1.0,
            heading_rad_per_sqrt_m: 1.0,
            gyro_rad_per_s: 1.0,
            gyro_resolution_rad_per_s: 1.0,
            gyro_bias_rad_per_s: 1.0,
            gyro_bias_walk_rad_per_s_sqrt_s: 1.0,
            fix_position_m: 1.0,
            fix_heading_rad: 1.0,
            ..SensorNoise::EXACT
        };
        assert_eq!(step_noise(WheelTravel::default(), &GEOMETRY, &noise), StepNoise::default());
        let one_wheel = step_noise(WheelTravel { left_m: 0.0, right_m: 0.04 }, &GEOMETRY, &noise);
        assert!((one_wheel.forward_turn_m_rad - 0.2).abs() < 1e-12);
    }
}

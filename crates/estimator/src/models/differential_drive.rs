//! Two wheels on one axle: wheel travel to body motion, and how uncertain that is.
//!
//! ```text
//! d   = (s_L + s_R) / 2            dth = (s_R - s_L) / b            var s_i = k_w^2 |s_i|      each wheel for itself
//! var d   = (var s_L + var s_R) / 4 + k_d^2 |d|                     cov(d, dth) = (var s_R - var s_L) / (2 b)
//! var dth = (var s_L + var s_R) / b^2 + k_t^2 |dth| + k_h^2 |d|
//! ```
//! Source: Paper 1, equation 14 (with half the track for its r); square-root-of-distance law: Borenstein and Feng
//! (1996); docs/maths/pose.md section 2.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector3};
use posebridge_telemetry::{DriveGeometry, SensorNoise};
use serde::{Deserialize, Serialize};

use super::se2::{BodyStep, StepRule, displace};
use crate::numerics::covariance::symmetrise;
use crate::saved::finite;

/// Travel of the two wheels' contact points, in metres, forward positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WheelTravel {
    #[serde(deserialize_with = "finite")]
    pub left_m: f64,
    #[serde(deserialize_with = "finite")]
    pub right_m: f64,
}

impl WheelTravel {
    /// The travel of wheels that have turned by these angles.
    pub fn from_rotation(left_rad: f64, right_rad: f64, geometry: &DriveGeometry) -> Self {
        Self { left_m: geometry.left_wheel_radius.0 * left_rad, right_m: geometry.right_wheel_radius.0 * right_rad }
    }
}

/// Variances of a step's distance and turn, and their covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepNoise {
    pub forward_var_m2: f64,
    pub turn_var_rad2: f64,
    pub forward_turn_m_rad: f64,
}

/// Turns wheel travel into body motion, exact while neither wheel slips.
pub fn body_step(travel: WheelTravel, geometry: &DriveGeometry) -> BodyStep {
    BodyStep {
        forward_m: 0.5 * (travel.left_m + travel.right_m),
        turn_rad: (travel.right_m - travel.left_m) / geometry.track_width.0,
    }
}

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

impl StepNoise {
    /// Adds the noise of wheels that turned for a time: commands that are not followed at once, wheels that wobble.
    #[must_use]
    pub fn with_time(self, moving_s: f64, noise: &SensorNoise) -> Self {
        Self {
            forward_var_m2: self.forward_var_m2 + noise.travel_m_per_sqrt_s.powi(2) * moving_s,
            turn_var_rad2: self.turn_var_rad2 + noise.heading_rad_per_sqrt_s.powi(2) * moving_s,
            ..self
        }
    }

    /// Adds independent errors of the left and the right wheel's travel, m².
    #[must_use]
    pub fn with_wheel_variances(self, [left_m2, right_m2]: [f64; 2], geometry: &DriveGeometry) -> Self {
        let b = geometry.track_width.0;
        Self {
            forward_var_m2: self.forward_var_m2 + 0.25 * (left_m2 + right_m2),
            turn_var_rad2: self.turn_var_rad2 + (left_m2 + right_m2) / (b * b),
            forward_turn_m_rad: self.forward_turn_m_rad + (right_m2 - left_m2) / (2.0 * b),
        }
    }
}

/// A step corrected for relative errors of mean radius, of the difference of radii (right minus left) and of the track
/// width, with its derivatives by these.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CalibratedStep {
    /// The travel of the true wheels.
    pub travel: WheelTravel,
    pub step: BodyStep,
    /// Derivatives of the distance by the errors, m.
    pub forward_by_scales: [f64; 3],
    /// Derivatives of the change of heading by the errors, rad.
    pub turn_by_scales: [f64; 3],
}

/// The true step for wheel travel that was computed with the nominal geometry.
#[inline]
pub fn calibrated_step(
    travel: WheelTravel,
    geometry: &DriveGeometry,
    [mean, difference, track]: [f64; 3],
) -> CalibratedStep {
    let track_m = geometry.track_width.0 * (1.0 + track);
    let scaled = WheelTravel {
        left_m: travel.left_m * (1.0 + mean - 0.5 * difference),
        right_m: travel.right_m * (1.0 + mean + 0.5 * difference),
    };
    let turn_rad = (scaled.right_m - scaled.left_m) / track_m;
    let (sum_m, difference_m) = (travel.left_m + travel.right_m, travel.right_m - travel.left_m);
    CalibratedStep {
        travel: scaled,
        step: BodyStep { forward_m: 0.5 * (scaled.left_m + scaled.right_m), turn_rad },
        forward_by_scales: [0.5 * sum_m, 0.25 * difference_m, 0.0],
        turn_by_scales: [difference_m / track_m, 0.5 * sum_m / track_m, -turn_rad / (1.0 + track)],
    }
}

/// A pose (x, y, heading) and its covariance after a step by the papers' midpoint rule; the heading is not wrapped.
pub(crate) fn propagate_pose(
    pose: &Vector3<f64>,
    covariance: &Matrix3<f64>,
    step: BodyStep,
    noise: &StepNoise,
) -> (Vector3<f64>, Matrix3<f64>) {
    let moved = displace(pose[2], step, StepRule::Midpoint);
    let mut f = Matrix3::identity();
    f[(0, 2)] = moved.by_heading[0];
    f[(1, 2)] = moved.by_heading[1];
    let [along_x, along_y] = moved.by_forward;
    let [turn_x, turn_y] = moved.by_turn;
    let g = Matrix3x2::new(along_x, turn_x, along_y, turn_y, 0.0, 1.0);
    let shared = noise.forward_turn_m_rad;
    let q = Matrix2::new(noise.forward_var_m2, shared, shared, noise.turn_var_rad2);
    let mut propagated = f * covariance * f.transpose() + g * q * g.transpose();
    symmetrise(&mut propagated);
    (pose + Vector3::new(moved.dx_m, moved.dy_m, step.turn_rad), propagated)
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

    #[test]
    fn derivatives_by_the_scales_agree_with_central_differences() {
        let travel = WheelTravel { left_m: 0.013, right_m: -0.004 };
        let scales = [0.01, -0.02, 0.05];
        let found = calibrated_step(travel, &GEOMETRY, scales);
        for column in 0..3 {
            let at = |h: f64| {
                let mut moved = scales;
                moved[column] += h;
                calibrated_step(travel, &GEOMETRY, moved).step
            };
            let (ahead, behind) = (at(1e-6), at(-1e-6));
            assert!((found.forward_by_scales[column] - (ahead.forward_m - behind.forward_m) / 2e-6).abs() < 1e-8);
            assert!((found.turn_by_scales[column] - (ahead.turn_rad - behind.turn_rad) / 2e-6).abs() < 1e-8);
        }
    }
}

//! Conversion between north-east-down or forward-right-down and our coordinate frames; done only here.
//!
//! ```text
//! north-east-down   n = y, e = x, yaw = pi/2 - heading      (yaw clockwise from north, heading counter-clockwise from east)
//! forward-right     f = x, r = -y, yaw = -heading
//! ```
//! Every one of these maps is its own inverse, so each function serves both directions. Covariances are upper triangles, row
//! by row: xx, xy, x-heading, yy, y-heading, heading-heading. Source: MAVLink common.xml, MAV_FRAME.

use std::f64::consts::FRAC_PI_2;

use posebridge_telemetry::quantities::wrap_rad;

/// Values of MAV_FRAME.
pub(super) mod frame {
    pub(in crate::dialect) const LOCAL_NED: u8 = 1;
    pub(in crate::dialect) const LOCAL_ENU: u8 = 4;
    /// Superseded by `BODY_FRD`, same axes.
    pub(in crate::dialect) const BODY_NED: u8 = 8;
    pub(in crate::dialect) const BODY_FRD: u8 = 12;
    /// Reserved since 2019, formerly BODY_FLU, still sent.
    pub(in crate::dialect) const BODY_FLU: u8 = 13;
    /// This and the following three are reserved since 2019, formerly the frames of trackers, still sent.
    pub(in crate::dialect) const MOCAP_NED: u8 = 14;
    pub(in crate::dialect) const MOCAP_ENU: u8 = 15;
    pub(in crate::dialect) const VISION_NED: u8 = 16;
    pub(in crate::dialect) const VISION_ENU: u8 = 17;
    pub(in crate::dialect) const LOCAL_FRD: u8 = 20;
    pub(in crate::dialect) const LOCAL_FLU: u8 = 21;
}

/// Variance written for what a planar filter does not estimate (height, roll, pitch), in m² or rad²: MAVLink has no
/// "unknown" for a single element, so the number must be too large to be used.
pub(super) const UNOBSERVED_VARIANCE: f32 = 1e4;

/// Indices of the planar elements in a 6 x 6 upper triangle of x, y, z, roll, pitch, yaw.
const PLANAR: [usize; 6] = [0, 1, 5, 6, 10, 20];
const UNOBSERVED: [usize; 3] = [11, 15, 18];
pub(super) const TRIANGLE_LEN: usize = 21;

/// A planar pose: two coordinates in metres and an angle in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PlanarPoint {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) angle: f64,
}

/// The negated value; zero stays the positive zero, whose bytes can be truncated.
pub(super) fn negate(value: f64) -> f64 {
    0.0 - value
}

/// Arena to north-east-down and back.
pub(crate) fn turn_ned(pose: PlanarPoint) -> PlanarPoint {
    PlanarPoint { x: pose.y, y: pose.x, angle: wrap_rad(FRAC_PI_2 - pose.angle) }
}

/// Covariance in the arena to north-east-down and back.
pub(super) fn turn_ned_covariance([xx, xy, xh, yy, yh, hh]: [f64; 6]) -> [f64; 6] {
    [yy, xy, negate(yh), xx, negate(xh), hh]
}

/// Forward-left to forward-right-down and back.
pub(super) fn turn_frd(pose: PlanarPoint) -> PlanarPoint {
    PlanarPoint { x: pose.x, y: negate(pose.y), angle: wrap_rad(negate(pose.angle)) }
}

/// Covariance of a forward-left pose to forward-right-down and back.
pub(super) fn turn_frd_covariance([xx, xy, xh, yy, yh, hh]: [f64; 6]) -> [f64; 6] {
    [xx, negate(xy), negate(xh), yy, yh, hh]
}

/// A planar covariance in MAVLink's 6 x 6 triangle; `None` is NaN in the first element.
pub(super) fn triangle(planar: Option<[f64; 6]>) -> [f32; TRIANGLE_LEN] {
    let mut full = [0.0; TRIANGLE_LEN];
    let Some(planar) = planar else {
        full[0] = f32::NAN;
        return full;
    };
    for (index, value) in PLANAR.into_iter().zip(planar) {
        full[index] = value as f32;
    }
    for index in UNOBSERVED {
        full[index] = UNOBSERVED_VARIANCE;
    }
    full
}

/// The planar part of MAVLink's 6 x 6 triangle. NaN in the first element means unknown; so do two position variances of
/// zero, which is what a sender without the extension field leaves behind.
pub(super) fn planar(triangle: &[f32; TRIANGLE_LEN]) -> Option<[f64; 6]> {
    let planar = PLANAR.map(|index| f64::from(triangle[index]));
    let [xx, _, _, yy, ..] = planar;
    let is_absent = xx.is_nan() || (xx == 0.0 && yy == 0.0);
    (!is_absent).then_some(planar)
}

/// The quaternion (w, x, y, z) of a turn about the vertical.
pub(super) fn quaternion(yaw_rad: f64) -> [f32; 4] {
    let (sin, cos) = (yaw_rad / 2.0).sin_cos();
    [cos as f32, 0.0, 0.0, sin as f32]
}

/// The turn about the vertical of a quaternion (w, x, y, z), in radians; `None` for an invalid one (NaN or all zeros).
pub(super) fn yaw(quaternion: [f32; 4]) -> Option<f64> {
    let [w, x, y, z] = quaternion.map(f64::from);
    let norm = w * w + x * x + y * y + z * z;
    let is_rotation = norm.is_finite() && norm > 0.0;
    is_rotation.then(|| (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_covariances_come_in_two_disguises() {
        assert_eq!(planar(&triangle(None)), None);
        assert_eq!(planar(&[0.0; TRIANGLE_LEN]), None);
        let known = [1.0, 0.5, 0.25, 2.0, 0.125, 4.0];
        assert_eq!(planar(&triangle(Some(known))), Some(known));
    }

    #[test]
    fn a_quaternion_that_is_none_has_no_yaw() {
        assert_eq!(yaw([0.0; 4]), None);
        assert_eq!(yaw([f32::NAN, 0.0, 0.0, 0.0]), None);
        let turned = yaw(quaternion(2.5)).unwrap();
        assert!((turned - 2.5).abs() < 1e-6);
        // Scaled by two: still the same rotation.
        let scaled = quaternion(-0.5).map(|part| 2.0 * part);
        assert!((yaw(scaled).unwrap() + 0.5).abs() < 1e-6);
    }
}

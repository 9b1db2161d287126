//! Range and bearing to a landmark whose place is known, by a camera on the robot.
//!
//! ```text
//! q = R' (L - p)            the landmark in the body's space       r = |q|
//! nu = [ z_r - (r (1 + s) + o) , wrap(z_b - atan2(q_y, q_x)) ]
//! H  = [ -q_x/r (1 + s)  -q_y/r (1 + s)   0 | 1 at o, r at s ]
//!      [  q_y/r^2        -q_x/r^2        -1 |                ]
//! ```
//! Source: docs/maths/pose.md section 4; Leung et al. (2011) for the data that it was tried on.

use nalgebra::{Matrix2, SMatrix, Vector2};
use posebridge_telemetry::{Arena, Point2, quantities::wrap_rad};

use crate::filters::pose::state::{FORWARD, HEADING, LANDMARK_OFFSET, LANDMARK_SCALE, LEFT, PoseState};
use crate::update::Measurement;

/// Nearer than this a bearing says nothing, m.
const NEAREST_M: f64 = 0.01;

/// What a sighting says: range in m, bearing in rad counter-clockwise from forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Distance from mid-axle.
    pub range_m: f64,
    /// Direction in the body's space.
    pub bearing_rad: f64,
}

/// Innovation, H and R of a sighting; `None` when the robot believes to stand on the landmark.
#[must_use]
pub fn measurement<const N: usize>(
    state: &PoseState<N>,
    place: Point2<Arena>,
    seen: Sighting,
    (range_var_m2, bearing_var_rad2): (f64, f64),
) -> Option<Measurement<N, 2>> {
    let [qx, qy] = state.pose.seen_from(place.x.0, place.y.0);
    let range_m = qx.hypot(qy);
    if range_m < NEAREST_M {
        return None;
    }
    let squared = range_m * range_m;
    let mut jacobian = SMatrix::<f64, 2, N>::zeros();
    let scale = 1.0 + state.value(LANDMARK_SCALE);
    jacobian[(0, FORWARD)] = -qx / range_m * scale;
    jacobian[(0, LEFT)] = -qy / range_m * scale;
    if LANDMARK_SCALE < N {
        jacobian[(0, LANDMARK_OFFSET)] = 1.0;
        jacobian[(0, LANDMARK_SCALE)] = range_m;
    }
    jacobian[(1, FORWARD)] = qy / squared;
    jacobian[(1, LEFT)] = -qx / squared;
    jacobian[(1, HEADING)] = -1.0;
    Some(Measurement {
        innovation: Vector2::new(
            seen.range_m - range_m * scale - state.value(LANDMARK_OFFSET),
            wrap_rad(seen.bearing_rad - qy.atan2(qx)),
        ),
        jacobian,
        noise: Matrix2::new(range_var_m2, 0.0, 0.0, bearing_var_rad2),
    })
}

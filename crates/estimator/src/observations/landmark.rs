//! Range and bearing to a landmark whose position is known, by a camera on the robot.
//!
//! ```text
//! q = R' (L - p)            the landmark in the body's space       r = |q|
//! nu = [ z_r - (r (1 + s) + o) , wrap(z_b - atan2(q_y, q_x)) ]
//! H  = [ -q_x/r (1 + s)  -q_y/r (1 + s)   0 | 1 at o, r at s ]
//!      [  q_y/r^2        -q_x/r^2        -1 |                ]
//! ```
//! Source: docs/maths/pose.md section 4; Leung et al. (2011) for the data that it was tried on.

use nalgebra::{Matrix2, Vector2};
use posebridge_telemetry::{Arena, Point2, quantities::wrap_rad};

use super::model::{JacobianRow, ObservationModel, PoseView, StateTerm};

/// Nearer than this the bearing is undefined, m.
const MIN_RANGE_M: f64 = 0.01;

/// A measured range and bearing: range in m, bearing in rad counter-clockwise from forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeBearing {
    pub range_m: f64,
    /// In the body's frame.
    pub bearing_rad: f64,
}

/// Innovation, H and R of a sighting; `None` when the estimate is on the landmark.
pub fn measurement(
    view: &impl PoseView,
    landmark: Point2<Arena>,
    measured: RangeBearing,
    range_variance_m2: f64,
    bearing_variance_rad2: f64,
) -> Option<ObservationModel<2>> {
    let [qx, qy] = view.pose().point_in_body(landmark.x.0, landmark.y.0);
    let range_m = qx.hypot(qy);
    if range_m < MIN_RANGE_M {
        return None;
    }
    let squared = range_m * range_m;
    let (offset, scale) = (StateTerm::LandmarkOffset, StateTerm::LandmarkScale);
    let factor = 1.0 + view.term(scale);
    Some(ObservationModel {
        innovation: Vector2::new(
            measured.range_m - range_m * factor - view.term(offset),
            wrap_rad(measured.bearing_rad - qy.atan2(qx)),
        ),
        rows: [
            JacobianRow {
                forward: -qx / range_m * factor,
                left: -qy / range_m * factor,
                heading: 0.0,
                terms: [Some((offset, 1.0)), Some((scale, range_m))],
            },
            JacobianRow { forward: qy / squared, left: -qx / squared, heading: -1.0, ..JacobianRow::default() },
        ],
        noise: Matrix2::new(range_variance_m2, 0.0, 0.0, bearing_variance_rad2),
    })
}

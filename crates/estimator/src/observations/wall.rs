//! The range straight ahead to a wall whose position is known.
//!
//! ```text
//! n   unit normal of the wall, in the body's space       a  a point of the wall, there
//! h(x) = (a . n) / n_x                                   the way along the body's x axis to the wall
//! H = [ -1, -n_y / n_x, -(n_y / n_x) h ]
//! ```
//! Of several walls the nearest ahead is met; a wall that is met at less than 20 degrees reflects away and is left out.
//!
//! Source: docs/maths/pose.md section 4; paper 3 for the use.

use nalgebra::{Matrix1, Vector1};
use posebridge_telemetry::Wall;

use super::model::{JacobianRow, ObservationModel, PoseView};
use crate::models::lie::Se2;

/// Sine of the flattest angle at which a wall still reflects to the sensor: 20 degrees.
const MIN_INCIDENCE_SINE: f64 = 0.342;

/// The intersection of the robot's forward axis with a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
struct WallIntersection {
    range_m: f64,
    /// n_y / n_x in the body's space.
    slope: f64,
}

/// Innovation, H and R of a range; `None` when no wall lies ahead.
pub fn measurement(
    view: &impl PoseView,
    walls: &[Wall],
    range_m: f64,
    variance_m2: f64,
) -> Option<ObservationModel<1>> {
    let pose = view.pose();
    let meeting =
        walls.iter().filter_map(|wall| intersect(pose, wall)).min_by(|a, b| a.range_m.total_cmp(&b.range_m))?;
    Some(ObservationModel {
        innovation: Vector1::new(range_m - meeting.range_m),
        rows: [JacobianRow {
            forward: -1.0,
            left: -meeting.slope,
            heading: -meeting.slope * meeting.range_m,
            ..JacobianRow::default()
        }],
        noise: Matrix1::new(variance_m2),
    })
}

fn intersect(pose: Se2, wall: &Wall) -> Option<WallIntersection> {
    let [from_x, from_y] = pose.point_in_body(wall.from.x.0, wall.from.y.0);
    let [to_x, to_y] = pose.point_in_body(wall.to.x.0, wall.to.y.0);
    let (dx, dy) = (to_x - from_x, to_y - from_y);
    let length_m = dx.hypot(dy);
    // The robot looks along y = 0 of its own space: the wall must have an end on either side.
    if length_m <= 0.0 || from_y * to_y > 0.0 || dy.abs() < MIN_INCIDENCE_SINE * length_m {
        return None;
    }
    let range_m = from_x - from_y * dx / dy;
    let slope = -dx / dy;
    (range_m > 0.0).then_some(WallIntersection { range_m, slope })
}

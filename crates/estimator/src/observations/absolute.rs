//! Landmarks, radio beacons, walls and a compass: what the pose is observed by besides fixes.
//!
//! ```text
//! landmark, beacon   q = R' (L - p)  the point in the body's space     r = |q|
//!   range            h(x) = r (1 + s) + o            H = [ -q_x/r (1 + s)  -q_y/r (1 + s)   0 | 1 at o, r at s ]
//!   bearing          h(x) = atan2(q_y, q_x)          H = [  q_y/r^2        -q_x/r^2        -1 ]
//! wall               n its unit normal, a a point of it, in the body's space
//!   range            h(x) = (a . n) / n_x            H = [ -1  -n_y / n_x  -(n_y / n_x) h ]        along the body's x axis
//! compass            h(x) = th                       H = [  0   0   1 ]
//! ```
//! Radio ranges are too long, by a few per cent and some decimetres: without o and s they would bias a filter. Of
//! several walls the nearest ahead is met; a wall that is met at less than 20 degrees reflects away and is left out. A
//! disturbed compass is off by far more than its noise: the gate rejects that.
//!
//! Source: docs/maths/pose.md section 4; Leung et al. (2011) for the landmarks' data; paper 3 for the use of a wall.

use nalgebra::{Matrix1, Matrix2, Vector1, Vector2};
use posebridge_telemetry::{Arena, Point2, Wall, quantities::wrap_rad};

use super::{JacobianRow, ObservationModel, PoseView, StateTerm};
use crate::models::lie::Se2;

/// Nearer than this the direction to a point is undefined, m.
const MIN_RANGE_M: f64 = 0.01;
/// Sine of the flattest angle at which a wall still reflects to the sensor: 20 degrees.
const MIN_INCIDENCE_SINE: f64 = 0.342;

/// The range to a point whose position is known.
struct PointRange {
    /// The point in the body's frame, m.
    q: [f64; 2],
    range_m: f64,
    /// The range with its relative error, and what is added to it.
    scaled_m: f64,
    offset_m: f64,
    row: JacobianRow,
}

impl PointRange {
    /// `None` when the estimate is on the point.
    fn predict(view: &impl PoseView, point: Point2<Arena>, offset: StateTerm, scale: StateTerm) -> Option<Self> {
        let q = view.pose().point_in_body(point.x.0, point.y.0);
        let range_m = q[0].hypot(q[1]);
        if range_m < MIN_RANGE_M {
            return None;
        }
        let factor = 1.0 + view.term(scale);
        let row = JacobianRow {
            forward: -q[0] / range_m * factor,
            left: -q[1] / range_m * factor,
            heading: 0.0,
            terms: [Some((offset, 1.0)), Some((scale, range_m))],
        };
        Some(Self { q, range_m, scaled_m: range_m * factor, offset_m: view.term(offset), row })
    }
}

/// A measured range and bearing: range in m, bearing in rad counter-clockwise from forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeBearing {
    pub range_m: f64,
    pub bearing_rad: f64,
}

/// A sighting of a landmark by the robot's camera; `None` when the estimate is on the landmark.
pub fn landmark(
    view: &impl PoseView,
    landmark: Point2<Arena>,
    measured: RangeBearing,
    range_variance_m2: f64,
    bearing_variance_rad2: f64,
) -> Option<ObservationModel<2>> {
    let predicted = PointRange::predict(view, landmark, StateTerm::LandmarkOffset, StateTerm::LandmarkScale)?;
    let [qx, qy] = predicted.q;
    let squared = predicted.range_m * predicted.range_m;
    Some(ObservationModel {
        innovation: Vector2::new(
            measured.range_m - predicted.scaled_m - predicted.offset_m,
            wrap_rad(measured.bearing_rad - qy.atan2(qx)),
        ),
        rows: [
            predicted.row,
            JacobianRow { forward: qy / squared, left: -qx / squared, heading: -1.0, ..JacobianRow::default() },
        ],
        noise: Matrix2::new(range_variance_m2, 0.0, 0.0, bearing_variance_rad2),
    })
}

/// The range to a radio beacon; `slot` is its number among the beacons of the arena. `None` when the estimate is on the
/// beacon.
pub fn beacon(
    view: &impl PoseView,
    position: Point2<Arena>,
    slot: usize,
    range_m: f64,
    variance_m2: f64,
) -> Option<ObservationModel<1>> {
    let (offset, scale) = (StateTerm::BeaconOffset(slot), StateTerm::BeaconScale(slot));
    let predicted = PointRange::predict(view, position, offset, scale)?;
    Some(ObservationModel {
        innovation: Vector1::new(range_m - (predicted.scaled_m + predicted.offset_m)),
        rows: [predicted.row],
        noise: Matrix1::new(variance_m2),
    })
}

/// The range straight ahead to the nearest wall; `None` when no wall lies ahead.
pub fn wall(view: &impl PoseView, walls: &[Wall], range_m: f64, variance_m2: f64) -> Option<ObservationModel<1>> {
    let pose = view.pose();
    let hits = walls.iter().filter_map(|wall| intersect(pose, wall));
    let nearest = hits.min_by(|a, b| a.range_m.total_cmp(&b.range_m))?;
    let row = JacobianRow {
        forward: -1.0,
        left: -nearest.slope,
        heading: -nearest.slope * nearest.range_m,
        ..JacobianRow::default()
    };
    Some(ObservationModel {
        innovation: Vector1::new(range_m - nearest.range_m),
        rows: [row],
        noise: Matrix1::new(variance_m2),
    })
}

/// The intersection of the robot's forward axis with a wall.
struct WallIntersection {
    range_m: f64,
    /// n_y / n_x in the body's space.
    slope: f64,
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

pub fn compass(view: &impl PoseView, heading_rad: f64, variance_rad2: f64) -> ObservationModel<1> {
    ObservationModel {
        innovation: Vector1::new(wrap_rad(heading_rad - view.pose().heading_rad)),
        rows: [JacobianRow { heading: 1.0, ..JacobianRow::default() }],
        noise: Matrix1::new(variance_rad2),
    }
}

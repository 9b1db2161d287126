//! Landmarks, radio beacons, walls and a compass: what the pose is observed by besides fixes.
//!
//! Derivatives are by zeta, the error of the sensor's own pose S ([`SensorFrame`]).
//!
//! ```text
//! landmark, beacon   q = S^-1 L  the point in the sensor's frame     r = |q|     L = map + error of the place
//!   range            h(x) = r (1 + s) + o      H = [ -q_x/r (1 + s)  -q_y/r (1 + s)   0 | 1 at o, r at s, (1 + s) q'R'/r at L ]
//!   bearing          h(x) = atan2(q_y, q_x)    H = [  q_y/r^2        -q_x/r^2        -1 | (-q_y, q_x)' R'/r^2 at L ]
//! wall               n its unit normal, a a point of it, in the sensor's frame
//!   range            h(x) = (a . n) / n_x      H = [ -1  -n_y / n_x  -(n_y / n_x) h ]        along the sensor's x axis
//! compass            h(x) = th of S            H = [  0   0   1 ]
//! ```
//! Radio ranges are too long, by a few per cent and some decimetres: without o and s they would bias a filter. Of
//! several walls the nearest ahead is met; a wall that is met at less than 20 degrees reflects away and is left out. A
//! disturbed compass is off by far more than its noise: the gate rejects that.
//!
//! Source: docs/maths/pose.md section 4; Leung et al. (2011) for the landmarks' data; paper 3 for the use of a wall.

use nalgebra::{Matrix1, Matrix2, Vector1, Vector2};
use posebridge_telemetry::{Arena, Point2, Wall, quantities::wrap_rad};

use super::sensor_frame::SensorFrame;
use super::{ArenaAxis, JacobianRow, ObservationModel, PoseView, StateTerm};
use crate::models::lie::Se2;

/// Nearer than this the direction to a point is undefined, m.
const MIN_RANGE_M: f64 = 0.01;
/// Sine of the flattest angle at which a wall still reflects to the sensor: 20 degrees.
const MIN_INCIDENCE_SINE: f64 = 0.342;

/// A point that a sensor measures, and the states that its range depends on besides the sensor's own.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredPoint {
    /// In the map.
    pub position: Point2<Arena>,
    /// Number among the landmarks, whose positions may be states; `None` for a beacon.
    pub landmark: Option<usize>,
    pub offset: StateTerm,
    pub scale: StateTerm,
}

impl MeasuredPoint {
    /// `slot` is its number among the landmarks of the arena.
    pub const fn landmark(position: Point2<Arena>, slot: usize) -> Self {
        Self { position, landmark: Some(slot), offset: StateTerm::LandmarkOffset, scale: StateTerm::LandmarkScale }
    }

    /// `slot` is its number among the beacons of the arena.
    pub const fn beacon(position: Point2<Arena>, slot: usize) -> Self {
        Self { position, landmark: None, offset: StateTerm::BeaconOffset(slot), scale: StateTerm::BeaconScale(slot) }
    }
}

/// The range to a point.
struct PointRange {
    /// The point in the sensor's frame, m.
    q: [f64; 2],
    range_m: f64,
    predicted_m: f64,
    row: JacobianRow,
}

impl PointRange {
    /// `None` when the estimate is on the point.
    fn predict(view: &impl PoseView, frame: &SensorFrame, point: &MeasuredPoint) -> Option<Self> {
        let [x_m, y_m] = place(view, point);
        let q = frame.pose.point_in_body(x_m, y_m);
        let range_m = q[0].hypot(q[1]);
        if range_m < MIN_RANGE_M {
            return None;
        }
        let factor = 1.0 + view.term(point.scale);
        let towards = [q[0] / range_m * factor, q[1] / range_m * factor];
        let mut row = frame.row([-towards[0], -towards[1], 0.0]);
        row.push(point.offset, 1.0);
        row.push(point.scale, range_m);
        push_place(&mut row, frame, point, towards);
        Some(Self { q, range_m, predicted_m: range_m * factor + view.term(point.offset), row })
    }
}

/// Where the point is by the map and what was learned of it, m.
fn place(view: &impl PoseView, point: &MeasuredPoint) -> [f64; 2] {
    let error = point
        .landmark
        .map_or([0.0; 2], |slot| ArenaAxis::ALL.map(|axis| view.term(StateTerm::LandmarkPlace(slot, axis))));
    [point.position.x.0 + error[0], point.position.y.0 + error[1]]
}

/// Adds the derivatives by a landmark's place, from those by its position in the sensor's frame.
fn push_place(row: &mut JacobianRow, frame: &SensorFrame, point: &MeasuredPoint, by_point: [f64; 2]) {
    if let Some(slot) = point.landmark {
        let [by_x, by_y] = frame.rotate_out(by_point);
        row.push(StateTerm::LandmarkPlace(slot, ArenaAxis::X), by_x);
        row.push(StateTerm::LandmarkPlace(slot, ArenaAxis::Y), by_y);
    }
}

/// Variance of a range with a constant part of its noise and one that is proportional to it.
pub fn range_variance(range_m: f64, constant_m: f64, share: f64) -> f64 {
    constant_m.powi(2) + (share * range_m).powi(2)
}

/// A measured range and bearing: range in m, bearing in rad counter-clockwise from the sensor's x axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeBearing {
    pub range_m: f64,
    pub bearing_rad: f64,
}

/// A sighting of a landmark by the robot's camera; `None` when the estimate is on the landmark.
pub fn landmark(
    view: &impl PoseView,
    frame: &SensorFrame,
    point: &MeasuredPoint,
    measured: RangeBearing,
    [range_m2, bearing_rad2]: [f64; 2],
) -> Option<ObservationModel<2>> {
    let predicted = PointRange::predict(view, frame, point)?;
    let [qx, qy] = predicted.q;
    let squared = predicted.range_m * predicted.range_m;
    let mut bearing_row = frame.row([qy / squared, -qx / squared, -1.0]);
    push_place(&mut bearing_row, frame, point, [-qy / squared, qx / squared]);
    Some(ObservationModel {
        innovation: Vector2::new(
            measured.range_m - predicted.predicted_m,
            wrap_rad(measured.bearing_rad - qy.atan2(qx)),
        ),
        rows: [predicted.row, bearing_row],
        noise: Matrix2::new(range_m2, 0.0, 0.0, bearing_rad2),
    })
}

/// The range to a radio beacon; `None` when the estimate is on the beacon.
pub fn beacon(
    view: &impl PoseView,
    frame: &SensorFrame,
    point: &MeasuredPoint,
    range_m: f64,
    variance_m2: f64,
) -> Option<ObservationModel<1>> {
    let predicted = PointRange::predict(view, frame, point)?;
    Some(ObservationModel {
        innovation: Vector1::new(range_m - predicted.predicted_m),
        rows: [predicted.row],
        noise: Matrix1::new(variance_m2),
    })
}

/// The range straight ahead of the sensor to the nearest wall; `None` when no wall lies ahead.
pub fn wall(frame: &SensorFrame, walls: &[Wall], range_m: f64, variance_m2: f64) -> Option<ObservationModel<1>> {
    let hits = walls.iter().filter_map(|wall| intersect(frame.pose, wall));
    let nearest = hits.min_by(|a, b| a.range_m.total_cmp(&b.range_m))?;
    Some(ObservationModel {
        innovation: Vector1::new(range_m - nearest.range_m),
        rows: [frame.row([-1.0, -nearest.slope, -nearest.slope * nearest.range_m])],
        noise: Matrix1::new(variance_m2),
    })
}

/// The intersection of the sensor's x axis with a wall.
struct WallIntersection {
    range_m: f64,
    /// n_y / n_x in the sensor's frame.
    slope: f64,
}

fn intersect(pose: Se2, wall: &Wall) -> Option<WallIntersection> {
    let [from_x, from_y] = pose.point_in_body(wall.from.x.0, wall.from.y.0);
    let [to_x, to_y] = pose.point_in_body(wall.to.x.0, wall.to.y.0);
    let (dx, dy) = (to_x - from_x, to_y - from_y);
    let length_m = dx.hypot(dy);
    // The sensor looks along y = 0 of its own frame: the wall must have an end on either side.
    if length_m <= 0.0 || from_y * to_y > 0.0 || dy.abs() < MIN_INCIDENCE_SINE * length_m {
        return None;
    }
    let range_m = from_x - from_y * dx / dy;
    let slope = -dx / dy;
    (range_m > 0.0).then_some(WallIntersection { range_m, slope })
}

pub fn compass(frame: &SensorFrame, heading_rad: f64, variance_rad2: f64) -> ObservationModel<1> {
    ObservationModel {
        innovation: Vector1::new(wrap_rad(heading_rad - frame.pose.heading_rad)),
        rows: [frame.row([0.0, 0.0, 1.0])],
        noise: Matrix1::new(variance_rad2),
    }
}

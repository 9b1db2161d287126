//! The range straight ahead to a wall whose place is known.
//!
//! ```text
//! n   unit normal of the wall, in the body's space       a  a point of the wall, there
//! h(x) = (a . n) / n_x                                   the way along the body's x axis to the wall
//! H = [ -1, -n_y / n_x, -(n_y / n_x) h ]
//! ```
//! Of several walls the nearest ahead is met; a wall that is met at less than 20 degrees reflects away and is left out.
//!
//! Source: docs/maths/pose.md section 4; paper 3 for the use.

use nalgebra::{Matrix1, SMatrix, Vector1};
use posebridge_telemetry::Wall;

use crate::filters::pose::state::{FORWARD, HEADING, LEFT, PoseState};
use crate::update::Measurement;

/// Sine of the flattest angle at which a wall still reflects to the sensor: 20 degrees.
const FLATTEST: f64 = 0.342;

/// How the robot would meet a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Meeting {
    range_m: f64,
    /// n_y / n_x in the body's space.
    slope: f64,
}

/// Innovation, H and R of a range; `None` when no wall lies ahead.
#[must_use]
pub fn measurement<const N: usize>(
    state: &PoseState<N>,
    walls: &[Wall],
    range_m: f64,
    variance_m2: f64,
) -> Option<Measurement<N, 1>> {
    let meeting = walls.iter().filter_map(|wall| meet(state, wall)).min_by(|a, b| a.range_m.total_cmp(&b.range_m))?;
    let mut jacobian = SMatrix::<f64, 1, N>::zeros();
    jacobian[(0, FORWARD)] = -1.0;
    jacobian[(0, LEFT)] = -meeting.slope;
    jacobian[(0, HEADING)] = -meeting.slope * meeting.range_m;
    Some(Measurement {
        innovation: Vector1::new(range_m - meeting.range_m),
        jacobian,
        noise: Matrix1::new(variance_m2),
    })
}

fn meet<const N: usize>(state: &PoseState<N>, wall: &Wall) -> Option<Meeting> {
    let [from_x, from_y] = state.pose.seen_from(wall.from.x.0, wall.from.y.0);
    let [to_x, to_y] = state.pose.seen_from(wall.to.x.0, wall.to.y.0);
    let (dx, dy) = (to_x - from_x, to_y - from_y);
    let length_m = dx.hypot(dy);
    // The robot looks along y = 0 of its own space: the wall must have an end on either side.
    if length_m <= 0.0 || from_y * to_y > 0.0 || dy.abs() < FLATTEST * length_m {
        return None;
    }
    let range_m = from_x - from_y * dx / dy;
    let slope = -dx / dy;
    (range_m > 0.0).then_some(Meeting { range_m, slope })
}

//! The range to a radio beacon whose place is known, with an offset and a scale of its own.
//!
//! ```text
//! q = R' (L - p)       r = |q|       h(x) = r (1 + s_i) + o_i
//! H = [ -q_x/r (1 + s_i), -q_y/r (1 + s_i), 0 | 1 at o_i, r at s_i ]
//! ```
//! Radio ranges read long, by a few per cent and by some decimetres: a filter that takes them as they are is led astray.
//!
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix1, SMatrix, Vector1};
use posebridge_telemetry::{Arena, Point2};

use crate::filters::pose::state::{BEACONS, FORWARD, LEFT, MOST_BEACONS, PoseState};
use crate::update::Measurement;

/// Nearer than this the direction to a beacon says nothing, m.
const NEAREST_M: f64 = 0.01;

/// A beacon: where it is and which of the state's rows are its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beacon {
    /// Its place.
    pub place: Point2<Arena>,
    /// Its number among the beacons of the world.
    pub slot: usize,
}

/// Innovation, H and R of a range; `None` when the robot believes to stand on the beacon.
#[must_use]
pub fn measurement<const N: usize>(
    state: &PoseState<N>,
    beacon: Beacon,
    range_m: f64,
    variance_m2: f64,
) -> Option<Measurement<N, 1>> {
    let place = beacon.place;
    let [qx, qy] = state.pose.seen_from(place.x.0, place.y.0);
    let true_m = qx.hypot(qy);
    if true_m < NEAREST_M {
        return None;
    }
    let mut jacobian = SMatrix::<f64, 1, N>::zeros();
    let mut predicted_m = true_m;
    let mut scale = 1.0;
    let offset_row = BEACONS + 2 * beacon.slot;
    if beacon.slot < MOST_BEACONS && offset_row + 1 < N {
        scale += state.mean[offset_row + 1];
        predicted_m = true_m * scale + state.mean[offset_row];
        jacobian[(0, offset_row)] = 1.0;
        jacobian[(0, offset_row + 1)] = true_m;
    }
    jacobian[(0, FORWARD)] = -qx / true_m * scale;
    jacobian[(0, LEFT)] = -qy / true_m * scale;
    Some(Measurement { innovation: Vector1::new(range_m - predicted_m), jacobian, noise: Matrix1::new(variance_m2) })
}

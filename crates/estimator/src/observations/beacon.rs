//! The range to a radio beacon whose position is known, with an offset and a scale of its own.
//!
//! ```text
//! q = R' (L - p)       r = |q|       h(x) = r (1 + s_i) + o_i
//! H = [ -q_x/r (1 + s_i), -q_y/r (1 + s_i), 0 | 1 at o_i, r at s_i ]
//! ```
//! Radio ranges are too long, by a few per cent and some decimetres, which would bias a filter without these states.
//!
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix1, Vector1};
use posebridge_telemetry::{Arena, Point2};

use super::model::{JacobianRow, ObservationModel, PoseView, StateTerm};

/// Nearer than this the direction to a beacon is undefined, m.
const MIN_RANGE_M: f64 = 0.01;

/// A beacon with its position and states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beacon {
    pub position: Point2<Arena>,
    /// Its number among the beacons of the arena.
    pub slot: usize,
}

/// Innovation, H and R of a range; `None` when the estimate is on the beacon.
pub fn measurement(
    view: &impl PoseView,
    beacon: Beacon,
    range_m: f64,
    variance_m2: f64,
) -> Option<ObservationModel<1>> {
    let position = beacon.position;
    let [qx, qy] = view.pose().point_in_body(position.x.0, position.y.0);
    let true_m = qx.hypot(qy);
    if true_m < MIN_RANGE_M {
        return None;
    }
    let (offset, scale) = (StateTerm::BeaconOffset(beacon.slot), StateTerm::BeaconScale(beacon.slot));
    let factor = 1.0 + view.term(scale);
    let predicted_m = true_m * factor + view.term(offset);
    Some(ObservationModel {
        innovation: Vector1::new(range_m - predicted_m),
        rows: [JacobianRow {
            forward: -qx / true_m * factor,
            left: -qy / true_m * factor,
            heading: 0.0,
            terms: [Some((offset, 1.0)), Some((scale, true_m))],
        }],
        noise: Matrix1::new(variance_m2),
    })
}

//! A compass: the heading against the arena, when no iron and no motor current disturbs it.
//!
//! ```text
//! nu = wrap(z - th)      H = [.. 1 at the heading]      R = sigma^2
//! ```
//! A disturbed compass is off by far more than its noise: the gate rejects that, and the learned noise scale of its
//! source does the rest.
//!
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix1, Vector1};
use posebridge_telemetry::quantities::wrap_rad;

use super::model::{JacobianRow, ObservationModel, PoseView};

/// Innovation, H and R of a compass heading.
pub fn measurement(view: &impl PoseView, heading_rad: f64, variance_rad2: f64) -> ObservationModel<1> {
    ObservationModel {
        innovation: Vector1::new(wrap_rad(heading_rad - view.pose().heading_rad)),
        rows: [JacobianRow { heading: 1.0, ..JacobianRow::default() }],
        noise: Matrix1::new(variance_rad2),
    }
}

//! A compass: the heading against the arena, when no iron and no motor current disturbs it.
//!
//! ```text
//! nu = wrap(z - th)      H = [.. 1 at the heading]      R = sigma^2
//! ```
//! A disturbed compass is off by far more than its noise: the gate keeps that out, and the scale of its source does the rest.
//!
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix1, SMatrix, Vector1};
use posebridge_telemetry::quantities::wrap_rad;

use crate::filters::pose::state::{HEADING, PoseState};
use crate::update::Measurement;

/// Innovation, H and R of a compass heading.
#[must_use]
pub fn measurement<const N: usize>(state: &PoseState<N>, heading_rad: f64, variance_rad2: f64) -> Measurement<N, 1> {
    let mut jacobian = SMatrix::<f64, 1, N>::zeros();
    jacobian[(0, HEADING)] = 1.0;
    Measurement {
        innovation: Vector1::new(wrap_rad(heading_rad - state.pose.heading_rad)),
        jacobian,
        noise: Matrix1::new(variance_rad2),
    }
}

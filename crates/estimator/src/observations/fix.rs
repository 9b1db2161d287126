//! A position or a pose seen from outside, of a tag that is not mid-axle, and a little earlier than its stamp says.
//!
//! ```text
//! X_s = X U^-1              the pose tau before the stamp; U the motion since, from the wheels
//! nu  = R_s' (z - p_s) - l,  wrap(z_th - th_s)                    in the body's space at X_s; l the tag in the body
//! H   = [ 1 0 -l_y | -(v - w l_y) at tau | 1 0 at l ] Ad(U)
//!       [ 0 1  l_x | -w l_x        at tau | 0 1 at l ]
//!       [ 0 0  1   | -w            at tau | 0 0 at l ]
//! R   = R_s' R_z R_s, plus (v sigma_t)^2 and (w sigma_t)^2 for a stamp that may be off by sigma_t
//! ```
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use posebridge_telemetry::{Arena, Fix, Heading, Meters, Pose, SensorNoise, quantities::wrap_rad};

use super::{JacobianRow, ObservationModel, PoseView, StateTerm};
use crate::models::lie::Se2;

/// Context of a fix: motion since its exposure, timestamp uncertainty, speeds. By default the robot is at rest and the timestamp is exact.
#[derive(Clone, Copy, Debug, Default)]
pub struct FixContext {
    /// The body's motion between the exposure and the stamp.
    pub moved_since: Se2,
    pub stamp_sigma_s: f64,
    /// At the exposure.
    pub forward_m_per_s: f64,
    pub turn_rad_per_s: f64,
}

impl FixContext {
    /// Of a fix that is taken for one of its stamp's instant.
    pub fn at_speeds(stamp_sigma_s: f64, forward_m_per_s: f64, turn_rad_per_s: f64) -> Self {
        Self { moved_since: Se2::default(), stamp_sigma_s, forward_m_per_s, turn_rad_per_s }
    }
}

/// Variances of a fix, in the arena: xx, xy, yy in m², heading in rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixNoise {
    pub position: Matrix2<f64>,
    pub heading_rad2: f64,
}

/// R of a fix: the variances that it reports, or the configured ones, times the learned scale of its source.
pub fn fix_noise(
    fix: &Fix,
    configured: &SensorNoise,
    [of_position, of_heading]: [f64; 2],
    circumstances: &FixContext,
) -> FixNoise {
    let smear_m2 = (circumstances.forward_m_per_s * circumstances.stamp_sigma_s).powi(2);
    let smear_rad2 = (circumstances.turn_rad_per_s * circumstances.stamp_sigma_s).powi(2);
    let configured_heading_rad2 = configured.fix_heading_rad.powi(2);
    let (position, heading_rad2) = match fix.covariance {
        Some(own) => {
            let heading = if own.heading_rad2.is_finite() { own.heading_rad2 } else { configured_heading_rad2 };
            (Matrix2::new(own.xx_m2, own.xy_m2, own.xy_m2, own.yy_m2), heading)
        }
        None => (Matrix2::from_diagonal_element(configured.fix_position_m.powi(2)), configured_heading_rad2),
    };
    FixNoise {
        position: position * of_position + Matrix2::from_diagonal_element(smear_m2),
        heading_rad2: heading_rad2 * of_heading + smear_rad2,
    }
}

pub fn position(view: &impl PoseView, fix: &Fix, noise: &FixNoise, circumstances: &FixContext) -> ObservationModel<2> {
    let moved = circumstances.moved_since;
    let shown = view.pose().compose(moved.inverse());
    let tag =
        [fix.tag_in_body.x.0 + view.term(StateTerm::TagForward), fix.tag_in_body.y.0 + view.term(StateTerm::TagLeft)];
    let measured = shown.point_in_body(fix.position.x.0, fix.position.y.0);
    let (sin, cos) = moved.heading_rad.sin_cos();
    let (v, w) = (circumstances.forward_m_per_s, circumstances.turn_rad_per_s);
    // (rho, phi) at the instant shown is Ad(U) times that at the stamp: (R rho - phi J t, phi), J t = (-t_y, t_x).
    let rows = [
        JacobianRow {
            forward: cos,
            left: -sin,
            heading: moved.y_m - tag[1],
            terms: [Some((StateTerm::FixDelay, w * tag[1] - v)), Some((StateTerm::TagForward, 1.0))],
        },
        JacobianRow {
            forward: sin,
            left: cos,
            heading: tag[0] - moved.x_m,
            terms: [Some((StateTerm::FixDelay, -w * tag[0])), Some((StateTerm::TagLeft, 1.0))],
        },
    ];
    let (sin, cos) = shown.heading_rad.sin_cos();
    let body_from_arena = Matrix2::new(cos, sin, -sin, cos);
    ObservationModel {
        innovation: Vector2::new(measured[0] - tag[0], measured[1] - tag[1]),
        rows,
        noise: body_from_arena * noise.position * body_from_arena.transpose(),
    }
}

pub fn pose(
    view: &impl PoseView,
    fix: &Fix,
    heading_rad: f64,
    noise: &FixNoise,
    circumstances: &FixContext,
) -> ObservationModel<3> {
    let flat = position(view, fix, noise, circumstances);
    let shown_rad = view.pose().heading_rad - circumstances.moved_since.heading_rad;
    let turn_rad = wrap_rad(heading_rad - shown_rad);
    let heading_row = JacobianRow {
        heading: 1.0,
        terms: [Some((StateTerm::FixDelay, -circumstances.turn_rad_per_s)), None],
        ..JacobianRow::default()
    };
    ObservationModel {
        innovation: Vector3::new(flat.innovation[0], flat.innovation[1], turn_rad),
        rows: [flat.rows[0], flat.rows[1], heading_row],
        noise: with_heading_variance(&flat.noise, noise.heading_rad2),
    }
}

/// R of position and heading, whose errors are independent.
pub fn with_heading_variance(position: &Matrix2<f64>, heading_rad2: f64) -> Matrix3<f64> {
    let mut noise = Matrix3::from_diagonal_element(heading_rad2);
    noise.fixed_view_mut::<2, 2>(0, 0).copy_from(position);
    noise
}

/// The pose of a robot with this heading, in rad, from the tag's position in the fix.
pub fn mid_axle(fix: &Fix, heading_rad: f64) -> Pose<Arena> {
    let lever = lever_in_arena([fix.tag_in_body.x.0, fix.tag_in_body.y.0], heading_rad);
    Pose::new(Meters(fix.position.x.0 - lever[0]), Meters(fix.position.y.0 - lever[1]), Heading::from_rad(heading_rad))
}

/// From mid-axle to a tag of a robot with this heading, m.
pub(crate) fn lever_in_arena([x, y]: [f64; 2], heading_rad: f64) -> Vector2<f64> {
    let (sin, cos) = heading_rad.sin_cos();
    Vector2::new(x * cos - y * sin, x * sin + y * cos)
}

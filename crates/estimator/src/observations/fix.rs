//! A position or a pose seen from outside, of a tag that is not mid-axle, and a little earlier than its stamp says.
//!
//! ```text
//! S   = X U^-1 M              the tag at the exposure, see sensor_frame
//! nu  = S^-1 (z - b)          in the tag's frame; b an error that all fixes of one source share
//!       wrap(z_th - th_s)
//! H   = I by zeta, R_s' at b
//! R   = R_s' R_z R_s, plus (v sigma_t)^2 and (w sigma_t)^2 for a stamp that may be off by sigma_t
//! ```
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use posebridge_telemetry::{Arena, Fix, Heading, Meters, Pose, SensorNoise, quantities::wrap_rad};

use super::sensor_frame::{Exposure, SensorFrame};
use super::{ArenaAxis, ObservationModel, PoseView, StateTerm};

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
    exposure: &Exposure,
    stamp_sigma_s: f64,
) -> FixNoise {
    let smear_m2 = (exposure.forward_m_per_s * stamp_sigma_s).powi(2);
    let smear_rad2 = (exposure.turn_rad_per_s * stamp_sigma_s).powi(2);
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

/// A fix as an observation: its noise, when it was made, and the number of its source among those with a shared error.
#[derive(Clone, Copy, Debug)]
pub struct FixMeasurement<'a> {
    pub fix: &'a Fix,
    pub noise: FixNoise,
    pub exposure: Exposure,
    pub source: Option<usize>,
}

impl FixMeasurement<'_> {
    /// Its position, without the source's shared error, m.
    pub fn unbiased_position(&self, view: &impl PoseView) -> [f64; 2] {
        let bias = self
            .source
            .map_or([0.0; 2], |source| ArenaAxis::ALL.map(|axis| view.term(StateTerm::FixBias(source, axis))));
        [self.fix.position.x.0 - bias[0], self.fix.position.y.0 - bias[1]]
    }

    fn frame(&self, view: &impl PoseView) -> SensorFrame {
        SensorFrame::of_tag(view, [self.fix.tag_in_body.x.0, self.fix.tag_in_body.y.0], &self.exposure)
    }

    /// The observation model of the position alone.
    pub fn position_model(&self, view: &impl PoseView) -> ObservationModel<2> {
        self.position_in(&self.frame(view), view)
    }

    fn position_in(&self, frame: &SensorFrame, view: &impl PoseView) -> ObservationModel<2> {
        let [x_m, y_m] = self.unbiased_position(view);
        let innovation = frame.pose.point_in_body(x_m, y_m);
        let (sin, cos) = frame.pose.heading_rad.sin_cos();
        let tag_from_arena = Matrix2::new(cos, sin, -sin, cos);
        let mut rows = [frame.row([1.0, 0.0, 0.0]), frame.row([0.0, 1.0, 0.0])];
        if let Some(source) = self.source {
            for (i, row) in rows.iter_mut().enumerate() {
                for (column, axis) in ArenaAxis::ALL.into_iter().enumerate() {
                    row.push(StateTerm::FixBias(source, axis), tag_from_arena[(i, column)]);
                }
            }
        }
        ObservationModel {
            innovation: Vector2::new(innovation[0], innovation[1]),
            rows,
            noise: tag_from_arena * self.noise.position * tag_from_arena.transpose(),
        }
    }

    /// The observation model of position and heading.
    pub fn pose_model(&self, view: &impl PoseView, heading_rad: f64) -> ObservationModel<3> {
        let frame = self.frame(view);
        let position = self.position_in(&frame, view);
        let turn_rad = wrap_rad(heading_rad - frame.pose.heading_rad);
        ObservationModel {
            innovation: Vector3::new(position.innovation[0], position.innovation[1], turn_rad),
            rows: [position.rows[0], position.rows[1], frame.row([0.0, 0.0, 1.0])],
            noise: with_heading_variance(&position.noise, self.noise.heading_rad2),
        }
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

//! A position or a pose seen from outside, of a tag that is not mid-axle.
//!
//! ```text
//! h(x) = [ x + l_x cos th - l_y sin th ]      H = [ 1 0 -l_x sin th - l_y cos th ]
//!        [ y + l_x sin th + l_y cos th ]          [ 0 1  l_x cos th - l_y sin th ]
//!        [ th                          ]          [ 0 0  1                       ]
//! ```
//! A stamp that may be off by sigma_t moves what was seen by v sigma_t and turns it by w sigma_t; both enter R.
//!
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};
use posebridge_telemetry::{Fix, SensorNoise, quantities::wrap_rad};

use crate::filters::pose::state::{HEADING, Mean, N, X, Y};
use crate::update::Measurement;

/// What is known besides the fix itself.
#[derive(Clone, Copy, Debug)]
pub struct Circumstances<'a> {
    /// The configured noise, used where the fix brings none.
    pub noise: &'a SensorNoise,
    /// How far the fix's stamp may be off, s.
    pub stamp_sigma_s: f64,
    /// Forward speed at the fix's time, m/s.
    pub forward_m_per_s: f64,
    /// Turn rate at the fix's time, rad/s.
    pub turn_rad_per_s: f64,
}

/// Variances of a fix: xx, xy, yy in m², heading in rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixNoise {
    /// Of the position.
    pub position: Matrix2<f64>,
    /// Of the heading.
    pub heading_rad2: f64,
}

/// R of a fix.
#[must_use]
pub fn noise_of(fix: &Fix, circumstances: &Circumstances<'_>) -> FixNoise {
    let smear_m2 = (circumstances.forward_m_per_s * circumstances.stamp_sigma_s).powi(2);
    let smear_rad2 = (circumstances.turn_rad_per_s * circumstances.stamp_sigma_s).powi(2);
    let position_m2 = circumstances.noise.fix_position_m.powi(2);
    let configured_heading_rad2 = circumstances.noise.fix_heading_rad.powi(2);
    let (position, heading_rad2) = match fix.covariance {
        Some(own) => {
            let heading = if own.heading_rad2.is_finite() {
                own.heading_rad2
            } else {
                configured_heading_rad2
            };
            (
                Matrix2::new(own.xx_m2, own.xy_m2, own.xy_m2, own.yy_m2),
                heading,
            )
        }
        None => (
            Matrix2::from_diagonal_element(position_m2),
            configured_heading_rad2,
        ),
    };
    FixNoise {
        position: position + Matrix2::from_diagonal_element(smear_m2),
        heading_rad2: heading_rad2 + smear_rad2,
    }
}

/// Innovation, H and R of the position alone.
#[must_use]
pub fn position(mean: &Mean, fix: &Fix, noise: &FixNoise) -> Measurement<N, 2> {
    let (sin, cos) = mean[HEADING].sin_cos();
    let (lever_x, lever_y) = (fix.tag_in_body.x.0, fix.tag_in_body.y.0);
    let offset = Vector2::new(lever_x * cos - lever_y * sin, lever_x * sin + lever_y * cos);
    let mut jacobian = SMatrix::<f64, 2, N>::zeros();
    jacobian[(0, X)] = 1.0;
    jacobian[(1, Y)] = 1.0;
    jacobian[(0, HEADING)] = -offset[1];
    jacobian[(1, HEADING)] = offset[0];
    let seen = Vector2::new(fix.position.x.0, fix.position.y.0);
    let predicted = Vector2::new(mean[X], mean[Y]) + offset;
    Measurement {
        innovation: seen - predicted,
        jacobian,
        noise: noise.position,
    }
}

/// Innovation, H and R of position and heading.
#[must_use]
pub fn pose(mean: &Mean, fix: &Fix, heading_rad: f64, noise: &FixNoise) -> Measurement<N, 3> {
    let flat = position(mean, fix, noise);
    let mut jacobian = SMatrix::<f64, 3, N>::zeros();
    jacobian.fixed_rows_mut::<2>(0).copy_from(&flat.jacobian);
    jacobian[(2, HEADING)] = 1.0;
    let turn = wrap_rad(heading_rad - mean[HEADING]);
    let mut full_noise = Matrix3::from_diagonal_element(noise.heading_rad2);
    full_noise
        .fixed_view_mut::<2, 2>(0, 0)
        .copy_from(&noise.position);
    Measurement {
        innovation: Vector3::new(flat.innovation[0], flat.innovation[1], turn),
        jacobian,
        noise: full_noise,
    }
}

//! A position or a pose seen from outside, of a tag that is not mid-axle, and a little earlier than its stamp says.
//!
//! ```text
//! X_s = X U^-1              the pose tau before the stamp; U the motion since, from the wheels
//! nu  = R_s' (z - p_s) - l,  wrap(z_th - th_s)                    in the body's space at X_s; l the tag in the body
//! H   = [ 1 0 -l_y | -(v - w l_y) at tau | 1 0 at l ] Ad(U)
//!       [ 0 1  l_x | -w l_x        at tau | 0 1 at l ]
//!       [ 0 0  1   | -w            at tau | 0 0 at l ]
//! R   = R_s' R_z R_s
//! ```
//! A stamp that may be off by sigma_t moves what was seen by v sigma_t and turns it by w sigma_t; both enter R.
//!
//! Source: docs/maths/pose.md section 4.

use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};
use posebridge_telemetry::{Arena, Fix, Heading, Meters, Pose, SensorNoise, quantities::wrap_rad};

use crate::filters::pose::state::{DELAY, FORWARD, HEADING, LEFT, PoseState, TAG_FORWARD, TAG_LEFT};
use crate::models::lie::Se2;
use crate::update::Measurement;

/// What is known besides the fix itself; by default that the robot stands and the stamp is right.
#[derive(Clone, Copy, Debug, Default)]
pub struct Circumstances {
    /// How the body has moved between the instant that the fix shows and its stamp.
    pub moved_since: Se2,
    /// How far the fix's stamp may be off, s.
    pub stamp_sigma_s: f64,
    /// Forward speed at the instant that the fix shows, m/s.
    pub forward_m_per_s: f64,
    /// Turn rate then, rad/s.
    pub turn_rad_per_s: f64,
}

/// Variances of a fix, in the arena: xx, xy, yy in m², heading in rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixNoise {
    /// Of the position.
    pub position: Matrix2<f64>,
    /// Of the heading.
    pub heading_rad2: f64,
}

/// R of a fix: what it claims or what is configured, times what its source's innovations say.
#[must_use]
pub fn noise_of(
    fix: &Fix,
    configured: &SensorNoise,
    [of_position, of_heading]: [f64; 2],
    circumstances: &Circumstances,
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

/// Innovation, H and R of the position alone.
#[must_use]
pub fn position<const N: usize>(
    state: &PoseState<N>,
    fix: &Fix,
    noise: &FixNoise,
    circumstances: &Circumstances,
) -> Measurement<N, 2> {
    let moved = circumstances.moved_since;
    let shown = state.pose.then(moved.inverse());
    let tag = [fix.tag_in_body.x.0 + state.value(TAG_FORWARD), fix.tag_in_body.y.0 + state.value(TAG_LEFT)];
    let seen = shown.seen_from(fix.position.x.0, fix.position.y.0);
    let (sin, cos) = moved.heading_rad.sin_cos();
    let mut jacobian = SMatrix::<f64, 2, N>::zeros();
    // (rho, phi) at the instant shown is Ad(U) times that at the stamp: (R rho - phi J t, phi), J t = (-t_y, t_x).
    jacobian[(0, FORWARD)] = cos;
    jacobian[(0, LEFT)] = -sin;
    jacobian[(0, HEADING)] = moved.y_m - tag[1];
    jacobian[(1, FORWARD)] = sin;
    jacobian[(1, LEFT)] = cos;
    jacobian[(1, HEADING)] = tag[0] - moved.x_m;
    let (v, w) = (circumstances.forward_m_per_s, circumstances.turn_rad_per_s);
    for (row, by_delay) in [(0, w * tag[1] - v), (1, -w * tag[0])] {
        set(&mut jacobian, row, DELAY, by_delay);
    }
    set(&mut jacobian, 0, TAG_FORWARD, 1.0);
    set(&mut jacobian, 1, TAG_LEFT, 1.0);
    let (sin, cos) = shown.heading_rad.sin_cos();
    let body_from_arena = Matrix2::new(cos, sin, -sin, cos);
    Measurement {
        innovation: Vector2::new(seen[0] - tag[0], seen[1] - tag[1]),
        jacobian,
        noise: body_from_arena * noise.position * body_from_arena.transpose(),
    }
}

/// Innovation, H and R of position and heading.
#[must_use]
pub fn pose<const N: usize>(
    state: &PoseState<N>,
    fix: &Fix,
    heading_rad: f64,
    noise: &FixNoise,
    circumstances: &Circumstances,
) -> Measurement<N, 3> {
    let flat = position(state, fix, noise, circumstances);
    let shown_rad = state.pose.heading_rad - circumstances.moved_since.heading_rad;
    let turn_rad = wrap_rad(heading_rad - shown_rad);
    let mut full = with_heading(&flat, HEADING, (turn_rad, noise.heading_rad2));
    set(&mut full.jacobian, 2, DELAY, -circumstances.turn_rad_per_s);
    full
}

/// Puts a heading behind a position: its innovation, in rad, is that of the state's `row`, and its variance, in rad², is not shared
/// with the position.
#[must_use]
pub fn with_heading<const N: usize>(
    position: &Measurement<N, 2>,
    row: usize,
    (turn_rad, heading_rad2): (f64, f64),
) -> Measurement<N, 3> {
    let mut jacobian = SMatrix::<f64, 3, N>::zeros();
    jacobian.fixed_rows_mut::<2>(0).copy_from(&position.jacobian);
    jacobian[(2, row)] = 1.0;
    let mut noise = Matrix3::from_diagonal_element(heading_rad2);
    noise.fixed_view_mut::<2, 2>(0, 0).copy_from(&position.noise);
    Measurement { innovation: Vector3::new(position.innovation[0], position.innovation[1], turn_rad), jacobian, noise }
}

/// Innovation and H of a fix's position for a state that holds x, y and heading themselves, in the arena.
///
/// ```text
/// nu = z - (x, y) - R(th) l          H = [ 1 0 -(R l)_y ]
///                                        [ 0 1  (R l)_x ]          l the tag in the body
/// ```
/// What is believed comes first, x in m, y in m and the heading in rad, then the rows of these.
#[must_use]
pub fn position_in_arena<const N: usize>(
    [x_m, y_m, heading_rad]: [f64; 3],
    [x, y, heading]: [usize; 3],
    fix: &Fix,
) -> (Vector2<f64>, SMatrix<f64, 2, N>) {
    let lever = lever_in_arena(fix, heading_rad);
    let mut jacobian = SMatrix::<f64, 2, N>::zeros();
    jacobian[(0, x)] = 1.0;
    jacobian[(1, y)] = 1.0;
    jacobian[(0, heading)] = -lever[1];
    jacobian[(1, heading)] = lever[0];
    let seen = Vector2::new(fix.position.x.0, fix.position.y.0);
    (seen - Vector2::new(x_m, y_m) - lever, jacobian)
}

/// The pose of a robot with this heading, in rad, whose tag is where a fix sees it.
#[must_use]
pub fn mid_axle(fix: &Fix, heading_rad: f64) -> Pose<Arena> {
    let lever = lever_in_arena(fix, heading_rad);
    Pose::new(Meters(fix.position.x.0 - lever[0]), Meters(fix.position.y.0 - lever[1]), Heading::from_rad(heading_rad))
}

/// From mid-axle to the tag of a robot with this heading, m.
fn lever_in_arena(fix: &Fix, heading_rad: f64) -> Vector2<f64> {
    let (sin, cos) = heading_rad.sin_cos();
    let (x, y) = (fix.tag_in_body.x.0, fix.tag_in_body.y.0);
    Vector2::new(x * cos - y * sin, x * sin + y * cos)
}

/// Sets a derivative, where the state has that row.
fn set<const M: usize, const N: usize>(jacobian: &mut SMatrix<f64, M, N>, row: usize, column: usize, value: f64) {
    if column < N {
        jacobian[(row, column)] = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Point2;

    const FIX: Fix = Fix {
        position: Point2::new(Meters(1.3), Meters(-0.4)),
        heading: None,
        covariance: None,
        tag_in_body: Point2::new(Meters(0.2), Meters(-0.1)),
        reset_counter: 0,
    };

    fn innovation(at: [f64; 3]) -> Vector2<f64> {
        position_in_arena::<3>(at, [0, 1, 2], &FIX).0
    }

    #[test]
    fn a_robot_that_turned_left_has_its_tag_ahead_of_it_to_the_north() {
        let pose = mid_axle(&FIX, std::f64::consts::FRAC_PI_2);
        // The tag is 0.2 m ahead, which is north, and 0.1 m to the right, which is east.
        assert!((pose.x.0 - 1.2).abs() < 1e-12 && (pose.y.0 + 0.6).abs() < 1e-12);
        assert!(innovation([pose.x.0, pose.y.0, pose.heading.rad()]).norm() < 1e-12);
    }

    #[test]
    fn the_jacobian_of_a_position_in_the_arena_agrees_with_central_differences() {
        let at = [0.7, 0.2, -2.3];
        let jacobian = position_in_arena::<3>(at, [0, 1, 2], &FIX).1;
        let h = 1e-6;
        for column in 0..3 {
            let (mut above, mut below) = (at, at);
            above[column] += h;
            below[column] -= h;
            // The innovation falls by as much as the prediction grows.
            let slope = (innovation(below) - innovation(above)) / (2.0 * h);
            assert!((jacobian.column(column) - slope).norm() < 1e-9, "{column}");
        }
    }
}

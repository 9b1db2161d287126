//! Innovation and H of a fix for the states of the papers, which hold x, y and heading themselves, in the arena.

use nalgebra::{SMatrix, Vector2, Vector3};
use posebridge_telemetry::Fix;

use crate::observations::fix::{lever_in_arena, with_heading_variance};
use crate::update::LinearizedMeasurement;

/// Puts a heading behind a position: its innovation, in rad, is that of the state's `row`, and its variance, in rad², is not shared
/// with the position.
pub(super) fn with_heading<const N: usize>(
    position: &LinearizedMeasurement<N, 2>,
    row: usize,
    turn_rad: f64,
    heading_rad2: f64,
) -> LinearizedMeasurement<N, 3> {
    let mut jacobian = SMatrix::<f64, 3, N>::zeros();
    jacobian.fixed_rows_mut::<2>(0).copy_from(&position.jacobian);
    jacobian[(2, row)] = 1.0;
    LinearizedMeasurement {
        innovation: Vector3::new(position.innovation[0], position.innovation[1], turn_rad),
        jacobian,
        noise: with_heading_variance(&position.noise, heading_rad2),
    }
}

/// Innovation and H of a fix's position for a state that holds x, y and heading themselves, in the arena.
///
/// ```text
/// nu = z - (x, y) - R(th) l          H = [ 1 0 -(R l)_y ]
///                                        [ 0 1  (R l)_x ]          l the tag in the body
/// ```
/// The estimate comes first, x in m, y in m and the heading in rad, then the rows of these.
pub(super) fn position_in_arena<const N: usize>(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observations::fix::mid_axle;
    use posebridge_telemetry::{Meters, Point2};

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

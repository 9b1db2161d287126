//! The ellipse of a position's covariance.
//!
//! ```text
//! P = [xx xy; xy yy]     m = (xx + yy)/2     d = (xx - yy)/2     r = sqrt(d² + xy²)
//! eigenvalues m + r and m - r;  the first eigenvector points at atan2(xy, d)/2
//! ```
//! Closed form of the symmetric 2 x 2 eigenproblem. An ellipse of k standard deviations holds 1 - exp(-k²/2) of a normal
//! distribution: 86.5 % for k = 2.

use crate::quantities::Meters;
use crate::spaces::{Arena, Point2};

/// Corners of the polygon that approximates an ellipse; 48 stay within 0.2 % of its axes.
const CORNERS: u32 = 48;

/// An ellipse around an estimated position, in the arena.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    pub semi_major_m: f64,
    pub semi_minor_m: f64,
    /// Direction of the longer axis, counter-clockwise from the arena's x, in radians, in (-pi/2, pi/2].
    pub direction_rad: f64,
}

impl Ellipse {
    /// An ellipse of this many standard deviations holds 95 % of a normal distribution in the plane: sqrt(-2 ln 0.05).
    pub const SIGMAS_95: f64 = 2.447_746_830_680_816;

    /// The ellipse of `sigmas` standard deviations, from the covariance's upper triangle; `None` if that is not finite
    /// or not positive semi-definite (beyond rounding).
    pub fn from_covariance(xx_m2: f64, xy_m2: f64, yy_m2: f64, sigmas: f64) -> Option<Self> {
        let mean = f64::midpoint(xx_m2, yy_m2);
        let half_difference = (xx_m2 - yy_m2) / 2.0;
        let radius = half_difference.hypot(xy_m2);
        let smaller = mean - radius;
        let is_definite = smaller >= -mean.abs() * f64::EPSILON * 4.0;
        if !(mean + radius).is_finite() || !is_definite {
            return None;
        }
        Some(Self {
            semi_major_m: sigmas * (mean + radius).sqrt(),
            semi_minor_m: sigmas * smaller.max(0.0).sqrt(),
            direction_rad: xy_m2.atan2(half_difference) / 2.0,
        })
    }

    /// The ellipse as the corners of a polygon around a centre; the first lies on the longer axis.
    pub fn corners(&self, center: Point2<Arena>) -> Vec<Point2<Arena>> {
        let (sin, cos) = self.direction_rad.sin_cos();
        (0..CORNERS)
            .map(|corner| {
                let angle_rad = std::f64::consts::TAU * f64::from(corner) / f64::from(CORNERS);
                let along_m = self.semi_major_m * angle_rad.cos();
                let across_m = self.semi_minor_m * angle_rad.sin();
                Point2::new(
                    Meters(center.x.0 + along_m * cos - across_m * sin),
                    Meters(center.y.0 + along_m * sin + across_m * cos),
                )
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axes_of_a_known_covariance() {
        // Eigenvalues 9 and 1, longer axis at 30 degrees: P = R diag(9, 1) R'.
        let (sin, cos) = std::f64::consts::FRAC_PI_6.sin_cos();
        let ellipse =
            Ellipse::from_covariance(9.0 * cos * cos + sin * sin, 8.0 * sin * cos, 9.0 * sin * sin + cos * cos, 2.0)
                .unwrap();
        assert!((ellipse.semi_major_m - 6.0).abs() < 1e-12);
        assert!((ellipse.semi_minor_m - 2.0).abs() < 1e-12);
        assert!((ellipse.direction_rad - std::f64::consts::FRAC_PI_6).abs() < 1e-12);
    }

    #[test]
    fn an_upright_ellipse_points_along_y() {
        let ellipse = Ellipse::from_covariance(1.0, 0.0, 4.0, 1.0).unwrap();
        assert!((ellipse.direction_rad.abs() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let first = ellipse.corners(Point2::ORIGIN)[0];
        assert!(first.x.0.abs() < 1e-12 && (first.y.0.abs() - 2.0).abs() < 1e-12);
    }

    #[test]
    fn corners_satisfy_the_quadratic_form() {
        let ellipse = Ellipse::from_covariance(5.0, 2.0, 2.0, 2.0).unwrap();
        for corner in ellipse.corners(Point2::ORIGIN) {
            // P^-1 = [2 -2; -2 5] / 6; a corner of the 2-sigma ellipse has p' P^-1 p = 4.
            let (x, y) = (corner.x.0, corner.y.0);
            let form = (2.0 * x * x - 4.0 * x * y + 5.0 * y * y) / 6.0;
            assert!((form - 4.0).abs() < 1e-9, "{form}");
        }
    }

    #[test]
    fn a_line_is_an_ellipse_but_an_indefinite_matrix_is_not() {
        let line = Ellipse::from_covariance(1.0, 1.0, 1.0, 1.0).unwrap();
        assert_eq!(line.semi_minor_m, 0.0);
        assert_eq!(Ellipse::from_covariance(1.0, 2.0, 1.0, 1.0), None);
        assert_eq!(Ellipse::from_covariance(-1.0, 0.0, -1.0, 1.0), None);
        assert_eq!(Ellipse::from_covariance(f64::NAN, 0.0, 1.0, 1.0), None);
        assert_eq!(Ellipse::from_covariance(f64::INFINITY, 0.0, 1.0, 1.0), None);
    }
}

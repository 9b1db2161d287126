//! Plane perspective: from a tag's modules to pixels.

use nalgebra::{Matrix3, Point2, SMatrix, SVector, Vector3};

/// Maps points of a tag's plane, in modules, to pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Homography(pub(crate) Matrix3<f64>);

impl Homography {
    /// The one that maps the corners (0, 0), (side, 0), (side, side) and (0, side) to those of a quadrilateral.
    pub(crate) fn of_square(side: f64, quad: &[Point2<f64>; 4]) -> Option<Self> {
        let square = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side)];
        let mut system = SMatrix::<f64, 8, 8>::zeros();
        let mut right = SVector::<f64, 8>::zeros();
        for (corner, ((u, v), pixel)) in square.into_iter().zip(quad).enumerate() {
            let (row, x, y) = (2 * corner, pixel.x, pixel.y);
            for (column, value) in [u, v, 1.0].into_iter().enumerate() {
                system[(row, column)] = value;
                system[(row + 1, column + 3)] = value;
            }
            for (column, value) in [u, v].into_iter().enumerate() {
                system[(row, column + 6)] = -x * value;
                system[(row + 1, column + 6)] = -y * value;
            }
            (right[row], right[row + 1]) = (x, y);
        }
        let h = system.lu().solve(&right)?;
        Some(Self(Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0)))
    }

    pub(crate) fn map(&self, u: f64, v: f64) -> Point2<f64> {
        let mapped = self.0 * Vector3::new(u, v, 1.0);
        Point2::new(mapped.x / mapped.z, mapped.y / mapped.z)
    }

    pub(crate) fn inverse(&self) -> Option<Self> {
        self.0.try_inverse().map(Self)
    }
}

//! What a camera does to directions: pinhole and radial distortion (Brown, 1966).

use nalgebra::{Matrix2, Point2, Vector2};

/// Most iterations of the inversion, and the change that ends it.
const MAX_ITERATIONS: usize = 20;
const CONVERGED: f64 = 1e-12;

/// The intrinsics of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraModel {
    /// px, across and down.
    pub focal_px: Vector2<f64>,
    /// Where the axis meets the picture, px; the centre of the first pixel is (0, 0).
    pub centre_px: Point2<f64>,
    /// Coefficients of the second and fourth power of the distance from the axis.
    pub radial: [f64; 2],
}

impl CameraModel {
    /// The pixel of a direction: right and down of the axis per distance along it. `None` where the distortion folds the picture back.
    pub fn project(&self, direction: Vector2<f64>) -> Option<Point2<f64>> {
        let squared = direction.norm_squared();
        let [second, fourth] = self.radial;
        if 1.0 + 3.0 * second * squared + 5.0 * fourth * squared * squared <= 0.0 {
            return None;
        }
        let distorted = direction * (1.0 + second * squared + fourth * squared * squared);
        Some(self.centre_px + self.focal_px.component_mul(&distorted))
    }

    /// The direction of a pixel, and its derivative by the pixel. `None` for a pixel that no direction has.
    pub fn direction(&self, pixel: Point2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let distorted = (pixel - self.centre_px).component_div(&self.focal_px);
        let [second, fourth] = self.radial;
        let far = distorted.norm();
        let mut distance = far;
        for _ in 0..MAX_ITERATIONS {
            let squared = distance * distance;
            let slope = 1.0 + 3.0 * second * squared + 5.0 * fourth * squared * squared;
            if slope <= 0.0 {
                return None;
            }
            let step = (distance * (1.0 + second * squared + fourth * squared * squared) - far) / slope;
            distance -= step;
            if step.abs() < CONVERGED {
                let direction = if far > 0.0 { distorted * (distance / far) } else { distorted };
                return Some((direction, self.derivative(direction)?));
            }
        }
        None
    }

    fn derivative(&self, direction: Vector2<f64>) -> Option<Matrix2<f64>> {
        let squared = direction.norm_squared();
        let [second, fourth] = self.radial;
        let radial = 1.0 + second * squared + fourth * squared * squared;
        let by_distance = 2.0 * second + 4.0 * fourth * squared;
        let distorted = Matrix2::identity() * radial + direction * direction.transpose() * by_distance;
        (Matrix2::from_diagonal(&self.focal_px) * distorted).try_inverse()
    }
}

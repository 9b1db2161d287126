//! Where the pixels of a camera lie on the floor, or above it.

use nalgebra::{Isometry3, Matrix2, Matrix3x2, Point2, Point3, Vector3};

use crate::camera_model::CameraModel;

/// Rays that fall less steeply than this tangent meet the floor far away and nowhere for certain.
const MIN_FALL: f64 = 0.05;

/// A camera at its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorView {
    pub camera: CameraModel,
    /// From the camera's axes (right, down, ahead) to the arena's (x, y, up), m.
    pub pose: Isometry3<f64>,
}

impl FloorView {
    /// The point of the arena that a pixel shows at `height_m` above the floor, and its derivative by the pixel, m/px. `None` above the
    /// horizon or close below it.
    pub fn point_at_height(&self, pixel: Point2<f64>, height_m: f64) -> Option<(Point2<f64>, Matrix2<f64>)> {
        let (direction, by_pixel) = self.camera.direction(pixel)?;
        let rotation = self.pose.rotation.to_rotation_matrix();
        let ray = rotation * Vector3::new(direction.x, direction.y, 1.0);
        let centre = self.pose.translation.vector;
        let distance = (height_m - centre.z) / ray.z;
        if distance <= 0.0 || ray.z.abs() < MIN_FALL * ray.xy().norm() {
            return None;
        }
        let point = centre + ray * distance;
        let by_direction: Matrix3x2<f64> = rotation.matrix().fixed_columns::<2>(0).into_owned();
        // The ray ends at the height, whatever its direction.
        let moved = (by_direction - ray * (by_direction.row(2) / ray.z)) * distance;
        Some((Point2::new(point.x, point.y), moved.fixed_rows::<2>(0) * by_pixel))
    }

    /// The pixel of a point in the arena. `None` behind the camera, or where the distortion folds the picture back.
    pub fn pixel_of(&self, point: Point3<f64>) -> Option<Point2<f64>> {
        let seen = self.pose.inverse_transform_point(&point);
        if seen.z <= 0.0 {
            return None;
        }
        self.camera.project(seen.coords.xy() / seen.z)
    }
}

//! Where the pixels of a camera lie on the floor, or above it.

use nalgebra::{
    Isometry3, Matrix2, Matrix3, Matrix3x2, Point2, Point3, Quaternion, Translation3, UnitQuaternion, Vector3,
};

use crate::camera_model::CameraModel;

/// Rays that fall less steeply than this tangent meet the floor far away and nowhere for certain.
const MIN_FALL: f64 = 0.05;
/// How far the length of a quaternion that somebody wrote may be from one.
const MAX_QUATERNION_ERROR: f64 = 0.01;

/// A camera at its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorView {
    pub camera: CameraModel,
    /// From the camera's axes (right, down, ahead) to the arena's (x, y, up), m.
    pub pose: Isometry3<f64>,
}

impl FloorView {
    /// Of a camera at `position_m`, turned by a quaternion (w, x, y, z) of about unit length. `None` if a number is not finite, the
    /// quaternion is none, a focal length is not above zero or the camera not above the floor.
    pub fn new(camera: CameraModel, position_m: [f64; 3], rotation: [f64; 4]) -> Option<Self> {
        let [w, x, y, z] = rotation;
        let quaternion = Quaternion::new(w, x, y, z);
        let numbers =
            [camera.focal_px.as_slice(), camera.centre_px.coords.as_slice(), &camera.radial, &position_m, &rotation];
        let is_finite = numbers.concat().iter().all(|number| number.is_finite());
        let is_possible = camera.focal_px.iter().all(|focal| *focal > 0.0) && position_m[2] > 0.0;
        (is_finite && is_possible && (quaternion.norm() - 1.0).abs() < MAX_QUATERNION_ERROR).then(|| Self {
            camera,
            pose: Isometry3::from_parts(Translation3::from(position_m), UnitQuaternion::from_quaternion(quaternion)),
        })
    }

    /// Of a camera whose axes (right, down, ahead) have these directions in the arena.
    pub fn from_axes(camera: CameraModel, position_m: [f64; 3], axes: [[f64; 3]; 3]) -> Option<Self> {
        let columns = axes.map(Vector3::from);
        let turned = UnitQuaternion::from_matrix(&Matrix3::from_columns(&columns));
        Self::new(camera, position_m, [turned.w, turned.i, turned.j, turned.k])
    }

    pub fn position_m(&self) -> [f64; 3] {
        self.pose.translation.vector.into()
    }

    /// As a unit quaternion: w, x, y, z.
    pub fn rotation(&self) -> [f64; 4] {
        let rotation = self.pose.rotation;
        [rotation.w, rotation.i, rotation.j, rotation.k]
    }

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

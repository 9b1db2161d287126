//! A camera that is being fitted: how it moves with its parameters, and what they do to the pixel of a point.

use nalgebra::{Matrix2, Matrix2x3, Point2, Point3, SMatrix, UnitQuaternion};

use crate::floor_view::FloorView;

/// Of the pose and the lens: rotation, translation, logarithm of the focal length, two radial terms.
pub(crate) const PARAMETERS: usize = 9;

pub(crate) type NormalMatrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
pub(crate) type ParameterVector = SMatrix<f64, PARAMETERS, 1>;

#[derive(Clone, Copy)]
pub(crate) struct CalibrationFit {
    pub(crate) view: FloorView,
    pub(crate) is_lens_known: bool,
}

impl CalibrationFit {
    pub(crate) fn moved(&self, step: &ParameterVector) -> FloorView {
        let mut view = self.view;
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        view.pose.rotation = turn * view.pose.rotation;
        view.pose.translation.vector += step.fixed_rows::<3>(3);
        if !self.is_lens_known {
            view.camera.focal_px *= step[6].exp();
            view.camera.radial[0] += step[7];
            view.camera.radial[1] += step[8];
        }
        view
    }

    /// The pixel of a point, and its derivative by the parameters.
    pub(crate) fn project(&self, point: Point3<f64>) -> Option<(Point2<f64>, SMatrix<f64, 2, PARAMETERS>)> {
        let FloorView { camera, pose } = &self.view;
        let to_camera = pose.rotation.to_rotation_matrix().inverse();
        let offset = point.coords - pose.translation.vector;
        let seen = to_camera * offset;
        if seen.z <= 1e-6 {
            return None;
        }
        let direction = seen.xy() / seen.z;
        let pixel = camera.project(direction)?;
        let squared = direction.norm_squared();
        let [second, fourth] = camera.radial;
        let radial = 1.0 + second * squared + fourth * squared * squared;
        let distortion =
            Matrix2::identity() * radial + direction * direction.transpose() * (2.0 * second + 4.0 * fourth * squared);
        let focal = Matrix2::from_diagonal(&camera.focal_px);
        let by_seen = Matrix2x3::new(1.0, 0.0, -direction.x, 0.0, 1.0, -direction.y) / seen.z;
        let by_offset = focal * distortion * by_seen * to_camera.matrix();
        let mut jacobian = SMatrix::<f64, 2, PARAMETERS>::zeros();
        // Turning the camera by a small vector turns the offset back.
        jacobian.fixed_columns_mut::<3>(0).copy_from(&(by_offset * offset.cross_matrix()));
        jacobian.fixed_columns_mut::<3>(3).copy_from(&-by_offset);
        if !self.is_lens_known {
            jacobian.set_column(6, &(pixel - camera.centre_px));
            jacobian.set_column(7, &(focal * direction * squared));
            jacobian.set_column(8, &(focal * direction * squared * squared));
        }
        Some((pixel, jacobian))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Translation3, Vector2, Vector3};

    use crate::camera_model::CameraModel;

    use super::*;

    #[test]
    fn derivatives_are_those_of_differences() {
        let camera = CameraModel {
            focal_px: Vector2::new(800.0, 800.0),
            centre_px: Point2::new(639.5, 359.5),
            radial: [-0.2, 0.05],
        };
        let pose = Isometry3::from_parts(
            Translation3::new(0.3, -0.2, 2.0),
            UnitQuaternion::from_scaled_axis(Vector3::new(2.8, 0.4, 0.1)),
        );
        let fit = CalibrationFit { view: FloorView { camera, pose }, is_lens_known: false };
        for point in [Point3::new(0.4, 0.3, 0.0), Point3::new(-0.5, -0.9, 0.2)] {
            let (_, jacobian) = fit.project(point).unwrap();
            for parameter in 0..PARAMETERS {
                let pixel = |by: f64| {
                    let mut step = ParameterVector::zeros();
                    step[parameter] = by;
                    fit.moved(&step).pixel_of(point).unwrap()
                };
                let difference = (pixel(1e-6) - pixel(-1e-6)) / 2e-6;
                let derivative = jacobian.column(parameter);
                assert!((derivative - difference).norm() < 1e-3, "{parameter}: {derivative} {difference}");
            }
        }
    }
}

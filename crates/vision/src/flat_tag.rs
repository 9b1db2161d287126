//! A tag that lies flat at a known height, somewhere on the floor: what it says of the camera that shows it.

use nalgebra::{Matrix2, Matrix3, Point2, Point3, SMatrix, SVector, Vector2, Vector3};

use crate::camera_fit::{CalibrationFit, NormalMatrix, PARAMETERS, ParameterVector};
use crate::floor_view::FloorView;
use crate::seen_point::SeenPoint;
use crate::tag_pose::{CORNERS, FloorTagPose};

/// Degrees of freedom of eight coordinates without a pose on the floor.
pub(crate) const FLAT_TAG_FREEDOM: f64 = 5.0;
/// How well a held pose is known, m and rad: by a robot that stands at its start.
const HELD_SIGMA_M: f64 = 1e-3;
const HELD_SIGMA_RAD: f64 = 2e-3;

/// A tag of a robot in one picture.
#[derive(Clone, Copy, Debug)]
pub struct FlatTag {
    /// Its upper left corner first, clockwise, px.
    pub corners: [Point2<f64>; 4],
    /// Of x and y of each corner, in that order, px².
    pub covariance: SMatrix<f64, 8, 8>,
    /// Of the black rim, m.
    pub side_m: f64,
    /// Above the floor, m.
    pub height_m: f64,
    /// About where it is in the arena: x, y, m, and the heading of its way up, rad.
    pub rough_pose: Vector3<f64>,
    /// Whether it is exactly there: without known points, such tags say where the arena's axes are.
    pub is_held: bool,
}

/// What a tag adds to the camera's normal equations once its pose is eliminated (Schur complement).
pub(crate) struct TagEquations {
    pub(crate) normal: NormalMatrix,
    pub(crate) right: ParameterVector,
    pub(crate) cost: f64,
    /// The pose's step is `own` less `by_camera` times the camera's step.
    own: Vector3<f64>,
    by_camera: SMatrix<f64, 3, PARAMETERS>,
}

impl TagEquations {
    /// The pose's step that goes with a step of the camera.
    pub(crate) fn step(&self, camera: &ParameterVector) -> Vector3<f64> {
        self.own - self.by_camera * camera
    }
}

impl FlatTag {
    /// Its corners where it is about.
    pub(crate) fn rough_points(&self) -> [SeenPoint; 4] {
        let at = corners_at(&self.rough_pose, self.side_m, self.height_m);
        std::array::from_fn(|index| SeenPoint {
            point: at[index].0,
            pixel: self.corners[index],
            covariance: self.covariance.fixed_view::<2, 2>(2 * index, 2 * index).into_owned(),
        })
    }

    /// Where a camera sees it: x, y and heading. `None` near or above its horizon.
    pub(crate) fn pose_in(&self, view: &FloorView) -> Option<Vector3<f64>> {
        let solved = FloorTagPose::solve(view, &self.corners, &self.covariance, self.side_m, self.height_m)?;
        Some(Vector3::new(solved.pose.translation.x, solved.pose.translation.y, solved.pose.rotation.angle()))
    }

    /// Of the camera and a pose; `None` if a corner is behind the camera.
    pub(crate) fn equations(&self, fit: &CalibrationFit, pose: &Vector3<f64>) -> Option<TagEquations> {
        let mut residual = SVector::<f64, 8>::zeros();
        let mut by_camera = SMatrix::<f64, 8, PARAMETERS>::zeros();
        let mut by_pose = SMatrix::<f64, 8, 3>::zeros();
        for (index, (point, moved)) in corners_at(pose, self.side_m, self.height_m).into_iter().enumerate() {
            let (pixel, jacobian) = fit.project(point)?;
            residual.fixed_rows_mut::<2>(2 * index).copy_from(&(self.corners[index] - pixel));
            by_camera.fixed_rows_mut::<2>(2 * index).copy_from(&jacobian);
            // Moving the point is moving the camera the other way.
            let by_point: Matrix2<f64> = -jacobian.fixed_view::<2, 2>(0, 3).into_owned();
            by_pose.fixed_rows_mut::<2>(2 * index).copy_from(&(by_point * moved));
        }
        let weight = self.covariance.cholesky()?.inverse();
        let mut own_normal: Matrix3<f64> = by_pose.transpose() * weight * by_pose;
        let mut own_right: Vector3<f64> = by_pose.transpose() * weight * residual;
        let mut cost = residual.dot(&(weight * residual));
        if self.is_held {
            let away = self.rough_pose - pose;
            let away = Vector3::new(away.x, away.y, away.z.sin());
            let sigmas = Vector3::new(HELD_SIGMA_M, HELD_SIGMA_M, HELD_SIGMA_RAD);
            let information = sigmas.map(|sigma| 1.0 / (sigma * sigma));
            own_normal += Matrix3::from_diagonal(&information);
            own_right += information.component_mul(&away);
            cost += away.component_div(&sigmas).norm_squared();
        }
        let inverse = own_normal.cholesky()?.inverse();
        let coupling = by_pose.transpose() * weight * by_camera;
        let eliminated = inverse * coupling;
        let own = inverse * own_right;
        Some(TagEquations {
            normal: by_camera.transpose() * weight * by_camera - coupling.transpose() * eliminated,
            right: by_camera.transpose() * weight * residual - coupling.transpose() * own,
            cost,
            own,
            by_camera: eliminated,
        })
    }

    /// How far its corners are from those of a square at the pose, root mean square, m.
    pub(crate) fn error_m(&self, view: &FloorView, pose: &Vector3<f64>) -> Option<f64> {
        let mut squares = 0.0;
        for ((point, _), pixel) in corners_at(pose, self.side_m, self.height_m).iter().zip(&self.corners) {
            let (seen, _) = view.point_at_height(*pixel, self.height_m)?;
            squares += (seen - point.xy()).norm_squared();
        }
        Some((squares / 4.0).sqrt())
    }
}

/// The corners of a tag at x, y and heading, and how they move with these.
fn corners_at(pose: &Vector3<f64>, side_m: f64, height_m: f64) -> [(Point3<f64>, SMatrix<f64, 2, 3>); 4] {
    let (sine, cosine) = pose.z.sin_cos();
    CORNERS.map(|(ahead, left)| {
        let (ahead, left) = (ahead * side_m, left * side_m);
        let turned = Vector2::new(cosine * ahead - sine * left, sine * ahead + cosine * left);
        let moved = SMatrix::<f64, 2, 3>::new(1.0, 0.0, -turned.y, 0.0, 1.0, turned.x);
        (Point3::new(pose.x + turned.x, pose.y + turned.y, height_m), moved)
    })
}

//! The place of a camera, and its lens, from points of the arena that it shows.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2, Matrix2x3, Matrix3, Point2, Point3, Rotation3, SMatrix, Translation3,
    UnitQuaternion, Vector2, Vector3,
};

use crate::camera_model::CameraModel;
use crate::floor_view::FloorView;

/// Fewest points: corners of one tag, or four marks.
const MIN_POINTS: usize = 4;
const MAX_ITERATIONS: usize = 60;
/// Relative decrease of the cost that ends it.
const CONVERGED: f64 = 1e-10;
/// Largest and smallest focal length in widths of the picture: telephoto lens and fisheye.
const FOCAL_BOUNDS: (f64, f64) = (0.2, 20.0);
/// Of the pose and the lens: rotation, translation, logarithm of the focal length, two radial terms.
const PARAMETERS: usize = 9;
/// Step of numerical derivatives, rad, m and shares.
const DIFFERENCE: f64 = 1e-5;
/// What a lens may be expected to be before it is measured: standard deviations of its radial terms.
const RADIAL_SIGMAS: [f64; 2] = [0.3, 0.15];

/// A point of the arena and the pixel that shows it.
#[derive(Clone, Copy, Debug)]
pub struct SeenPoint {
    pub point: Point3<f64>,
    pub pixel: Point2<f64>,
    /// Of the pixel, px².
    pub covariance: Matrix2<f64>,
}

/// What is to be found besides the camera's place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LensKnowledge {
    /// The lens is known.
    Known(CameraModel),
    /// Square pixels, axis in the middle of a picture of this size; focal length and distortion are to be found.
    Unknown { width: usize, height: usize },
}

/// A calibrated camera.
#[derive(Clone, Debug)]
pub struct FloorCalibration {
    pub view: FloorView,
    /// Root mean square of the residuals, px.
    pub rms_px: f64,
    /// Of each point, m: how far its pixel is from it on its height.
    pub errors_m: Vec<f64>,
    /// One standard deviation of the focal length, as a share of it; zero for a known lens.
    pub focal_sigma: f64,
    /// One standard deviation of the camera's position, m.
    pub position_sigma_m: Vector3<f64>,
    is_lens_known: bool,
    covariance: NormalMatrix,
}

/// Why a camera could not be calibrated, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    #[error("{0} points are known; a calibration needs {MIN_POINTS} or more that are not on one line")]
    TooFew(usize),
    #[error("the points lie on one line, or their pixels are mixed up: spread them over the picture")]
    Degenerate,
    #[error("these points show nothing of the focal length: tilt the camera, or state `focal_px`")]
    NoFocalLength,
}

impl FloorCalibration {
    /// Finds the camera that shows all points where they were seen. Points of several heights are welcome; most lie on the floor.
    pub fn solve(points: &[SeenPoint], lens: LensKnowledge) -> Result<Self, CalibrationError> {
        if points.len() < MIN_POINTS {
            return Err(CalibrationError::TooFew(points.len()));
        }
        let start = start(points, lens)?;
        let mut fit = CalibrationFit { view: start, is_lens_known: matches!(lens, LensKnowledge::Known(_)) };
        let mut damping = 1e-3;
        let (mut normal, mut right, mut cost) = fit.equations(points, &start).ok_or(CalibrationError::Degenerate)?;
        for _ in 0..MAX_ITERATIONS {
            let mut damped = normal;
            for index in 0..PARAMETERS {
                damped[(index, index)] *= 1.0 + damping;
            }
            let step = damped.cholesky().ok_or(CalibrationError::Degenerate)?.solve(&right);
            let tried = CalibrationFit { view: fit.moved(&step), ..fit };
            match tried.equations(points, &start) {
                Some((next_normal, next_right, next_cost)) if next_cost <= cost => {
                    let is_done = cost - next_cost <= CONVERGED * cost;
                    (fit, normal, right, cost) = (tried, next_normal, next_right, next_cost);
                    damping *= 0.2;
                    if is_done {
                        break;
                    }
                }
                _ => {
                    damping *= 10.0;
                    if damping > 1e9 {
                        break;
                    }
                }
            }
        }
        fit.finish(points, &normal)
    }

    /// How well the floor under a pixel is known: one standard deviation along its worst direction, m. `None` above the horizon.
    pub fn floor_sigma_m(&self, pixel: Point2<f64>) -> Option<f64> {
        let fit = CalibrationFit { view: self.view, is_lens_known: self.is_lens_known };
        let point = |parameter: usize, by: f64| {
            let mut step = ParameterVector::zeros();
            step[parameter] = by;
            Some(fit.moved(&step).point_at_height(pixel, 0.0)?.0)
        };
        let mut jacobian = SMatrix::<f64, 2, PARAMETERS>::zeros();
        for parameter in 0..PARAMETERS {
            let difference = point(parameter, DIFFERENCE)? - point(parameter, -DIFFERENCE)?;
            jacobian.set_column(parameter, &(difference / (2.0 * DIFFERENCE)));
        }
        let covariance = jacobian * self.covariance * jacobian.transpose();
        Some(covariance.symmetric_eigenvalues().max().max(0.0).sqrt())
    }
}

#[derive(Clone, Copy)]
struct CalibrationFit {
    view: FloorView,
    is_lens_known: bool,
}

type NormalMatrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
type ParameterVector = SMatrix<f64, PARAMETERS, 1>;

impl CalibrationFit {
    fn moved(&self, step: &ParameterVector) -> FloorView {
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

    /// The normal equations and the cost; `None` if a point is behind the camera.
    fn equations(&self, points: &[SeenPoint], start: &FloorView) -> Option<(NormalMatrix, ParameterVector, f64)> {
        let mut normal = NormalMatrix::zeros();
        let mut right = ParameterVector::zeros();
        let mut cost = 0.0;
        for seen in points {
            let (pixel, jacobian) = self.project(seen.point)?;
            let weight = seen.covariance.try_inverse()?;
            let residual = seen.pixel - pixel;
            normal += jacobian.transpose() * weight * jacobian;
            right += jacobian.transpose() * weight * residual;
            cost += residual.dot(&(weight * residual));
        }
        if self.is_lens_known {
            for index in 6..PARAMETERS {
                normal[(index, index)] = 1.0;
            }
        } else {
            for (term, sigma) in RADIAL_SIGMAS.into_iter().enumerate() {
                let information = 1.0 / (sigma * sigma);
                let away = self.view.camera.radial[term] - start.camera.radial[term];
                normal[(7 + term, 7 + term)] += information;
                right[7 + term] -= information * away;
                cost += information * away * away;
            }
        }
        Some((normal, right, cost))
    }

    /// The pixel of a point, and its derivative by the parameters.
    fn project(&self, point: Point3<f64>) -> Option<(Point2<f64>, SMatrix<f64, 2, PARAMETERS>)> {
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

    fn finish(&self, points: &[SeenPoint], normal: &NormalMatrix) -> Result<FloorCalibration, CalibrationError> {
        let covariance = normal.cholesky().ok_or(CalibrationError::Degenerate)?.inverse();
        let (mut squares, mut errors_m) = (0.0, Vec::with_capacity(points.len()));
        for seen in points {
            let pixel = self.view.pixel_of(seen.point).ok_or(CalibrationError::Degenerate)?;
            squares += (pixel - seen.pixel).norm_squared();
            let at = self.view.point_at_height(seen.pixel, seen.point.z).ok_or(CalibrationError::Degenerate)?.0;
            errors_m.push((at - seen.point.xy()).norm());
        }
        let sigma = |index: usize| covariance[(index, index)].sqrt();
        Ok(FloorCalibration {
            view: self.view,
            rms_px: (squares / points.len() as f64).sqrt(),
            errors_m,
            focal_sigma: if self.is_lens_known { 0.0 } else { sigma(6) },
            position_sigma_m: Vector3::new(sigma(3), sigma(4), sigma(5)),
            is_lens_known: self.is_lens_known,
            covariance,
        })
    }
}

/// A camera without distortion that shows the points about where they are.
fn start(points: &[SeenPoint], lens: LensKnowledge) -> Result<FloorView, CalibrationError> {
    let (centre, known_focal) = match lens {
        LensKnowledge::Known(camera) => (camera.centre_px, Some(camera)),
        LensKnowledge::Unknown { width, height } => {
            (Point2::new((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0), None)
        }
    };
    // With a known lens in directions, else in pixels from the middle.
    let straight: Option<Vec<_>> = points
        .iter()
        .map(|seen| {
            let at = match known_focal {
                Some(camera) => camera.direction(seen.pixel)?.0,
                None => seen.pixel - centre,
            };
            Some((seen.point.xy(), at))
        })
        .collect();
    let plane = plane_perspective(&straight.ok_or(CalibrationError::Degenerate)?)?;
    let focal = match (known_focal, lens) {
        (Some(_), _) => 1.0,
        (None, LensKnowledge::Unknown { width, .. }) => focal_of(&plane, width as f64)?,
        (None, LensKnowledge::Known(_)) => return Err(CalibrationError::Degenerate),
    };
    let unscaled = Matrix3::from_diagonal(&Vector3::new(1.0 / focal, 1.0 / focal, 1.0)) * plane;
    let scale = 2.0 / (unscaled.column(0).norm() + unscaled.column(1).norm());
    // The floor is in front of the camera.
    let middle = points.iter().map(|seen| seen.point.coords.xy()).sum::<Vector2<f64>>() / points.len() as f64;
    let depth = (unscaled * Vector3::new(middle.x, middle.y, 1.0)).z;
    let scaled = unscaled * scale * depth.signum();
    let (first, second) = (scaled.column(0).into_owned(), scaled.column(1).into_owned());
    let rough = Matrix3::from_columns(&[first, second, first.cross(&second)]);
    let to_camera = Rotation3::from_matrix(&rough);
    let rotation = UnitQuaternion::from_rotation_matrix(&to_camera.inverse());
    let position = -(rotation * scaled.column(2).into_owned());
    let camera = known_focal.unwrap_or(CameraModel {
        focal_px: Vector2::new(focal, focal),
        centre_px: centre,
        radial: [0.0; 2],
    });
    Ok(FloorView { camera, pose: Isometry3::from_parts(Translation3::from(position), rotation) })
}

/// The perspective from the floor to what was seen, without the heights of the points (direct linear transform).
fn plane_perspective(points: &[(Point2<f64>, Vector2<f64>)]) -> Result<Matrix3<f64>, CalibrationError> {
    let normalised = |of: &dyn Fn(usize) -> Vector2<f64>| {
        let count = points.len() as f64;
        let middle = (0..points.len()).map(of).sum::<Vector2<f64>>() / count;
        let spread = (0..points.len()).map(|index| (of(index) - middle).norm()).sum::<f64>() / count;
        let scale = 2_f64.sqrt() / spread.max(1e-12);
        Matrix3::new(scale, 0.0, -scale * middle.x, 0.0, scale, -scale * middle.y, 0.0, 0.0, 1.0)
    };
    let from = normalised(&|index| points[index].0.coords);
    let to = normalised(&|index| points[index].1);
    let mut system = DMatrix::<f64>::zeros(2 * points.len(), 9);
    for (index, (point, seen)) in points.iter().enumerate() {
        let p = from * Vector3::new(point.x, point.y, 1.0);
        let q = to * Vector3::new(seen.x, seen.y, 1.0);
        for column in 0..3 {
            system[(2 * index, column)] = p[column];
            system[(2 * index, column + 6)] = -q.x * p[column];
            system[(2 * index + 1, column + 3)] = p[column];
            system[(2 * index + 1, column + 6)] = -q.y * p[column];
        }
    }
    let squares = system.transpose() * &system;
    let eigen = squares.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|one, other| eigen.eigenvalues[*one].total_cmp(&eigen.eigenvalues[*other]));
    // Points on a line leave a second direction open.
    if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
        return Err(CalibrationError::Degenerate);
    }
    let solution: DVector<f64> = eigen.eigenvectors.column(order[0]).into_owned();
    let normal = Matrix3::from_row_slice(solution.as_slice());
    Ok(to.try_inverse().ok_or(CalibrationError::Degenerate)? * normal * from)
}

/// The focal length of a camera with square pixels whose axis meets the middle: the axes of the floor are perpendicular and of one length.
fn focal_of(plane: &Matrix3<f64>, width: f64) -> Result<f64, CalibrationError> {
    let (one, two) = (plane.column(0).into_owned(), plane.column(1).into_owned());
    // one.xy · two.xy / f² + one.z two.z = 0, and |one.xy|² / f² + one.z² = |two.xy|² / f² + two.z².
    let candidates = [
        (one.xy().dot(&two.xy()), -one.z * two.z),
        (one.xy().norm_squared() - two.xy().norm_squared(), two.z * two.z - one.z * one.z),
    ];
    let (squares, weights) = candidates.into_iter().fold((0.0, 0.0), |(squares, weights), (above, below)| {
        // Least squares over both: above = f² below.
        (squares + above * below, weights + below * below)
    });
    let focal = (squares / weights).sqrt();
    let bounds = FOCAL_BOUNDS.0 * width..FOCAL_BOUNDS.1 * width;
    if bounds.contains(&focal) { Ok(focal) } else { Err(CalibrationError::NoFocalLength) }
}

#[cfg(test)]
mod tests {
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

//! The place of a camera, and its lens, from points of the arena that it shows.

use nalgebra::{Matrix2, Matrix2x3, Point2, Point3, SMatrix, UnitQuaternion, Vector3};

use crate::camera_model::CameraModel;
use crate::flat_tag::{FLAT_TAG_FREEDOM, FlatTag, TagEquations};
use crate::floor_view::FloorView;
use crate::rough_view::{rough_view, rough_view_with_focal};

/// Fewest points: corners of one tag, or four marks.
const MIN_POINTS: usize = 4;
const MAX_ITERATIONS: usize = 60;
/// Relative decrease of the cost that ends it.
const CONVERGED: f64 = 1e-10;
/// Of the pose and the lens: rotation, translation, logarithm of the focal length, two radial terms.
pub(crate) const PARAMETERS: usize = 9;
/// Step of numerical derivatives, rad, m and shares.
const DIFFERENCE: f64 = 1e-5;
/// Focal lengths to begin with where nothing tells it, in widths of the picture.
const FOCAL_GUESSES: [f64; 4] = [0.5, 0.8, 1.3, 2.5];
/// A tag whose misfit is so many times the usual one is left out: it was not flat, half hidden, or not found well.
const OUTLIER_RATIO: f64 = 9.0;
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

impl SeenPoint {
    /// A mark on the floor; `sigma_px` is how well each coordinate of its pixel is known.
    pub fn on_floor([x_m, y_m]: [f64; 2], pixel: [f64; 2], sigma_px: f64) -> Self {
        let covariance = Matrix2::identity() * sigma_px.powi(2);
        Self { point: Point3::new(x_m, y_m, 0.0), pixel: pixel.into(), covariance }
    }
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
    /// Root mean square of the residuals of the points, px.
    pub rms_px: f64,
    /// Of each point, m: how far its pixel is from it on its height.
    pub errors_m: Vec<f64>,
    /// Of each flat tag, m: how far its corners are from those of a square of its side, root mean square; `None` if it was left out.
    pub tag_errors_m: Vec<Option<f64>>,
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
    #[error("these points show nothing of the focal length: tilt the camera, or state its lens")]
    NoFocalLength,
}

impl FloorCalibration {
    /// Finds the camera that shows all points where they were seen. Points of several heights are welcome; most lie on the floor.
    /// `tags` have unknown places: that they are squares of a known side says how the lens draws where they are. Those that fit much
    /// worse than the others are left out. Without points the tags' rough poses are where they start, and those that are held say
    /// where the arena's axes are.
    pub fn solve(points: &[SeenPoint], tags: &[FlatTag], lens: LensKnowledge) -> Result<Self, CalibrationError> {
        let rough;
        let beginning = if points.is_empty() && !tags.is_empty() {
            rough = tags.iter().flat_map(FlatTag::rough_points).collect::<Vec<_>>();
            rough.as_slice()
        } else {
            points
        };
        if beginning.len() < MIN_POINTS {
            return Err(CalibrationError::TooFew(beginning.len()));
        }
        let starts = rough_view(beginning, lens).map(|view| vec![view]).or_else(|error| match (&error, lens) {
            // A camera that looks straight down: the tags above the floor, and their sides, tell the focal length.
            (CalibrationError::NoFocalLength, LensKnowledge::Unknown { width, .. }) if !tags.is_empty() => {
                FOCAL_GUESSES
                    .iter()
                    .map(|widths| rough_view_with_focal(beginning, lens, widths * width as f64))
                    .collect()
            }
            _ => Err(error),
        })?;
        let fits = starts.iter().filter_map(|view| {
            let fit = CalibrationFit { view: *view, is_lens_known: matches!(lens, LensKnowledge::Known(_)) };
            fit.converge(points, tags)
        });
        let best = fits.min_by(|one, other| one.cost.total_cmp(&other.cost)).ok_or(CalibrationError::Degenerate)?;
        best.finish(points, tags)
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
pub(crate) struct CalibrationFit {
    view: FloorView,
    is_lens_known: bool,
}

/// A fit with the poses of the tags.
struct ConvergedFit {
    fit: CalibrationFit,
    /// x, y and heading of each tag; `None` if it was left out.
    poses: Vec<Option<Vector3<f64>>>,
    normal: NormalMatrix,
    cost: f64,
}

pub(crate) type NormalMatrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
pub(crate) type ParameterVector = SMatrix<f64, PARAMETERS, 1>;

/// The normal equations of the camera without the poses of the tags, which follow from its step.
struct CameraEquations {
    normal: NormalMatrix,
    right: ParameterVector,
    cost: f64,
    tags: Vec<Option<TagEquations>>,
}

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

    /// The best camera near this one, first with all tags, then without those that fit badly.
    fn converge(self, points: &[SeenPoint], tags: &[FlatTag]) -> Option<ConvergedFit> {
        let poses = tags.iter().map(|tag| tag.pose_in(&self.view)).collect();
        let mut found = self.iterate(points, tags, poses)?;
        let misfits: Vec<Option<f64>> =
            tags.iter().zip(&found.poses).map(|(tag, pose)| Some(tag.equations(&found.fit, &(*pose)?)?.cost)).collect();
        let mut sorted: Vec<f64> = misfits.iter().flatten().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let usual = sorted.get(sorted.len() / 2).copied().unwrap_or_default().max(FLAT_TAG_FREEDOM);
        let is_outlier = |misfit: &Option<f64>| misfit.is_some_and(|misfit| misfit > OUTLIER_RATIO * usual);
        if misfits.iter().any(is_outlier) {
            let left = found.poses.iter().zip(&misfits).map(|(pose, misfit)| pose.filter(|_| !is_outlier(misfit)));
            found = found.fit.iterate(points, tags, left.collect())?;
        }
        Some(found)
    }

    fn iterate(self, points: &[SeenPoint], tags: &[FlatTag], poses: Vec<Option<Vector3<f64>>>) -> Option<ConvergedFit> {
        let (start, mut fit, mut poses) = (self.view, self, poses);
        let mut damping = 1e-3;
        let mut equations = fit.equations(points, tags, &poses, &start)?;
        for _ in 0..MAX_ITERATIONS {
            let mut damped = equations.normal;
            for index in 0..PARAMETERS {
                damped[(index, index)] *= 1.0 + damping;
            }
            let step = damped.cholesky()?.solve(&equations.right);
            let tried = Self { view: fit.moved(&step), ..fit };
            let moved = poses.iter().zip(&equations.tags).map(|(pose, tag)| Some((*pose)? + tag.as_ref()?.step(&step)));
            let moved: Vec<Option<Vector3<f64>>> = moved.collect();
            match tried.equations(points, tags, &moved, &start) {
                Some(next) if next.cost <= equations.cost => {
                    let is_done = equations.cost - next.cost <= CONVERGED * equations.cost;
                    (fit, poses, equations) = (tried, moved, next);
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
        Some(ConvergedFit { fit, poses, normal: equations.normal, cost: equations.cost })
    }

    /// `None` if something is behind the camera.
    fn equations(
        &self,
        points: &[SeenPoint],
        tags: &[FlatTag],
        poses: &[Option<Vector3<f64>>],
        start: &FloorView,
    ) -> Option<CameraEquations> {
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
        let mut tag_equations = Vec::with_capacity(tags.len());
        for (tag, pose) in tags.iter().zip(poses) {
            let Some(pose) = pose else {
                tag_equations.push(None);
                continue;
            };
            let tag = tag.equations(self, pose)?;
            normal += tag.normal;
            right += tag.right;
            cost += tag.cost;
            tag_equations.push(Some(tag));
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
        Some(CameraEquations { normal, right, cost, tags: tag_equations })
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

impl ConvergedFit {
    fn finish(&self, points: &[SeenPoint], tags: &[FlatTag]) -> Result<FloorCalibration, CalibrationError> {
        let Self { fit, poses, normal, .. } = self;
        let covariance = normal.cholesky().ok_or(CalibrationError::Degenerate)?.inverse();
        let (mut squares, mut errors_m) = (0.0, Vec::with_capacity(points.len()));
        for seen in points {
            let pixel = fit.view.pixel_of(seen.point).ok_or(CalibrationError::Degenerate)?;
            squares += (pixel - seen.pixel).norm_squared();
            let at = fit.view.point_at_height(seen.pixel, seen.point.z).ok_or(CalibrationError::Degenerate)?.0;
            errors_m.push((at - seen.point.xy()).norm());
        }
        let sigma = |index: usize| covariance[(index, index)].sqrt();
        Ok(FloorCalibration {
            view: fit.view,
            rms_px: (squares / points.len().max(1) as f64).sqrt(),
            errors_m,
            tag_errors_m: tags.iter().zip(poses).map(|(tag, pose)| tag.error_m(&fit.view, &(*pose)?)).collect(),
            focal_sigma: if fit.is_lens_known { 0.0 } else { sigma(6) },
            position_sigma_m: Vector3::new(sigma(3), sigma(4), sigma(5)),
            is_lens_known: fit.is_lens_known,
            covariance,
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Translation3, Vector2};

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

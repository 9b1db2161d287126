//! The place of a camera, and its lens, from points of the arena that it shows.

use nalgebra::{Point2, SMatrix, Vector3};

use crate::camera_fit::{CalibrationFit, NormalMatrix, PARAMETERS, ParameterVector};
use crate::flat_tag::{FLAT_TAG_FREEDOM, FlatTag, TagEquations};
use crate::floor_view::FloorView;
use crate::rough_view::{rough_view, rough_view_with_focal};
use crate::seen_point::{CalibrationError, LensKnowledge, MIN_POINTS, SeenPoint};

const MAX_ITERATIONS: usize = 60;
/// Relative decrease of the cost that ends it.
const CONVERGED: f64 = 1e-10;
/// Step of numerical derivatives, rad, m and shares.
const DIFFERENCE: f64 = 1e-5;
/// Focal lengths to begin with where nothing tells it, in widths of the picture.
const FOCAL_GUESSES: [f64; 4] = [0.5, 0.8, 1.3, 2.5];
/// A tag whose misfit is so many times the usual one is left out: it was not flat, half hidden, or not found well.
const OUTLIER_RATIO: f64 = 9.0;
/// What a lens may be expected to be before it is measured: standard deviations of its radial terms.
const RADIAL_SIGMAS: [f64; 2] = [0.3, 0.15];

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

/// A fit with the poses of the tags.
struct ConvergedFit {
    fit: CalibrationFit,
    /// x, y and heading of each tag; `None` if it was left out.
    poses: Vec<Option<Vector3<f64>>>,
    normal: NormalMatrix,
    cost: f64,
}

/// The normal equations of the camera without the poses of the tags, which follow from its step.
struct CameraEquations {
    normal: NormalMatrix,
    right: ParameterVector,
    cost: f64,
    tags: Vec<Option<TagEquations>>,
}

impl CalibrationFit {
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

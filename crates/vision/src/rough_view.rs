//! A camera that shows points about where they are: what a calibration begins with.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};

use crate::camera_model::CameraModel;
use crate::floor_view::FloorView;
use crate::seen_point::{CalibrationError, LensKnowledge, SeenPoint};

/// Largest and smallest focal length in widths of the picture: telephoto lens and fisheye.
const FOCAL_BOUNDS: (f64, f64) = (0.2, 20.0);

/// A camera without distortion that shows the points about where they are.
pub(crate) fn rough_view(points: &[SeenPoint], lens: LensKnowledge) -> Result<FloorView, CalibrationError> {
    view_of(points, lens, focal_of)
}

/// The same with a given focal length, px.
pub(crate) fn rough_view_with_focal(
    points: &[SeenPoint],
    lens: LensKnowledge,
    focal: f64,
) -> Result<FloorView, CalibrationError> {
    view_of(points, lens, |_plane, _width| Ok(focal))
}

fn view_of(
    points: &[SeenPoint],
    lens: LensKnowledge,
    focal_of: impl Fn(&Matrix3<f64>, f64) -> Result<f64, CalibrationError>,
) -> Result<FloorView, CalibrationError> {
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

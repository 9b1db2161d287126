//! The pose of a tag that lies flat at a known height, by its corners.

use nalgebra::{Isometry2, Matrix3, Point2, SMatrix, SVector, Vector2};

use crate::floor_view::FloorView;

const MAX_ITERATIONS: usize = 10;
const CONVERGED: f64 = 1e-9;

/// A tag in the arena.
#[derive(Clone, Copy, Debug)]
pub struct FloorTagPose {
    /// Its middle, m, and its way up: heading counter-clockwise from x, rad.
    pub pose: Isometry2<f64>,
    /// Of x, y and heading, m and rad.
    pub covariance: Matrix3<f64>,
    /// Sum of the squared residuals of the corners, in units of their covariance: of five degrees of freedom, if side and height are right.
    pub misfit: f64,
    /// Mean side as seen over the given one.
    pub side_ratio: f64,
}

/// The corners of a tag, upper left one first, clockwise, in parts of its side: way up along x, left along y.
pub(crate) const CORNERS: [(f64, f64); 4] = [(0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5)];

impl FloorTagPose {
    /// Of a tag with a black rim of `side_m`, flat at `height_m` above the floor. `covariance` is that of the corners' pixels. `None` if
    /// a corner is near the horizon.
    pub fn solve(
        view: &FloorView,
        corners: &[Point2<f64>; 4],
        covariance: &SMatrix<f64, 8, 8>,
        side_m: f64,
        height_m: f64,
    ) -> Option<Self> {
        let mut seen = SVector::<f64, 8>::zeros();
        let mut to_floor = SMatrix::<f64, 8, 8>::zeros();
        for (index, corner) in corners.iter().enumerate() {
            let (point, by_pixel) = view.point_at_height(*corner, height_m)?;
            seen.fixed_rows_mut::<2>(2 * index).copy_from(&point.coords);
            to_floor.fixed_view_mut::<2, 2>(2 * index, 2 * index).copy_from(&by_pixel);
        }
        let point = |index: usize| Vector2::new(seen[2 * index], seen[2 * index + 1]);
        let weight = (to_floor * covariance * to_floor.transpose()).cholesky()?.inverse();
        let up = (point(0) + point(1) - point(2) - point(3)) / 2.0;
        let middle = (0..4).map(point).sum::<Vector2<f64>>() / 4.0;
        let mut state = SVector::<f64, 3>::new(middle.x, middle.y, up.y.atan2(up.x));
        for _ in 0..MAX_ITERATIONS {
            let (residual, jacobian) = residual_of(&seen, &state, side_m);
            let normal = (jacobian.transpose() * weight * jacobian).cholesky()?;
            let step = normal.solve(&(jacobian.transpose() * weight * residual));
            state += step;
            if step.norm() < CONVERGED {
                break;
            }
        }
        let (residual, jacobian) = residual_of(&seen, &state, side_m);
        let covariance = (jacobian.transpose() * weight * jacobian).cholesky()?.inverse();
        let sides = (0..4).map(|index| (point((index + 1) % 4) - point(index)).norm());
        Some(Self {
            pose: Isometry2::new(Vector2::new(state.x, state.y), state.z),
            covariance,
            misfit: (residual.transpose() * weight * residual)[0],
            side_ratio: sides.sum::<f64>() / (4.0 * side_m),
        })
    }
}

/// The corners as seen less those of a tag at x, y and heading, and how the latter change with these.
fn residual_of(seen: &SVector<f64, 8>, state: &SVector<f64, 3>, side_m: f64) -> (SVector<f64, 8>, SMatrix<f64, 8, 3>) {
    let (sine, cosine) = state.z.sin_cos();
    let mut residual = *seen;
    let mut jacobian = SMatrix::<f64, 8, 3>::zeros();
    for (index, (ahead, left)) in CORNERS.into_iter().enumerate() {
        let (ahead, left) = (ahead * side_m, left * side_m);
        let turned = Vector2::new(cosine * ahead - sine * left, sine * ahead + cosine * left);
        residual[2 * index] -= state.x + turned.x;
        residual[2 * index + 1] -= state.y + turned.y;
        (jacobian[(2 * index, 0)], jacobian[(2 * index + 1, 1)]) = (1.0, 1.0);
        (jacobian[(2 * index, 2)], jacobian[(2 * index + 1, 2)]) = (-turned.y, turned.x);
    }
    (residual, jacobian)
}

//! Calibration of an overhead camera: a homography from the image to the floor by known points, with residuals.
//!
//! # Model
//! ```text
//! (x, y, 1)' ~ H (u, v, 1)'        H: 3 x 3 up to a factor; eight numbers, four points without three on a line
//! first guess   the linear system x (h31 u + h32 v + 1) = h11 u + h12 v + h13, y likewise, points centred and scaled
//! then          minimise sum |(x, y) - H(u, v)|^2 on the floor, where the tape was
//! ```
//! A camera that outputs metres may still be turned, shifted and scaled against the arena: [`Similarity`] by two points or more.
//!
//! # Sources
//! Hartley and Zisserman (2004), Multiple View Geometry, 2nd edition, sections 4.1 and 4.4 (normalisation); Umeyama (1991), IEEE
//! PAMI 13(4), equations 40 to 43 in the plane.

use nalgebra::{DMatrix, DVector};
use posebridge_estimator::numerics::statistics::{mean, root_mean_square};

use super::CalibrationError;
use super::least_squares::{ScaledCholesky, fit};
use crate::statistics::{PairedVectors, centroid};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationPoint {
    /// Image position in the camera's unit (pixels or metres).
    pub measured: [f64; 2],
    pub floor_m: [f64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography {
    /// Row by row; the last number is one.
    pub rows: [[f64; 3]; 3],
}

impl Homography {
    /// Position on the floor; not finite for points on the horizon.
    pub fn to_floor(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let [x, y, w] = self.rows.map(|[a, b, c]| a * u + b * v + c);
        [x / w, y / w]
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct CameraFit {
    pub homography: Homography,
    /// Of each point: floor by the image minus floor by the tape.
    pub residuals_m: Vec<[f64; 2]>,
    pub rms_m: f64,
    /// `rms_m` of the others without each point; empty with fewer than six points, because four always fit. Leaving out a mistyped
    /// point makes the others fit well.
    pub rms_without_m: Vec<f64>,
}

pub const MIN_POINTS: usize = 4;

pub fn fit_homography(points: &[CalibrationPoint]) -> Result<CameraFit, CalibrationError> {
    validate_points(points, MIN_POINTS)?;
    let found = solve_homography(points)?;
    let residuals_m: Vec<[f64; 2]> = points.iter().map(|point| residual(&found, point)).collect();
    let rms_without_m = if points.len() > MIN_POINTS + 1 {
        (0..points.len()).map(|index| rms_without(points, index)).collect()
    } else {
        Vec::new()
    };
    Ok(CameraFit { homography: found, rms_m: rms(&residuals_m), residuals_m, rms_without_m })
}

fn rms(residuals_m: &[[f64; 2]]) -> f64 {
    let distances: Vec<f64> = residuals_m.iter().map(|[x, y]| x.hypot(*y)).collect();
    root_mean_square(&distances).unwrap_or(0.0)
}

fn validate_points(points: &[CalibrationPoint], needed: usize) -> Result<(), CalibrationError> {
    if points.len() < needed {
        return Err(CalibrationError::TooFewData { what: "known points", found: points.len(), needed });
    }
    let numbers = points.iter().flat_map(|p| p.measured.into_iter().chain(p.floor_m));
    match numbers.into_iter().find(|number| !number.is_finite()) {
        Some(value) => Err(CalibrationError::ImplausibleValue { what: "a coordinate of a known point", value }),
        None => Ok(()),
    }
}

fn residual(found: &Homography, point: &CalibrationPoint) -> [f64; 2] {
    let floor = found.to_floor(point.measured);
    [floor[0] - point.floor_m[0], floor[1] - point.floor_m[1]]
}

fn rms_without(points: &[CalibrationPoint], index: usize) -> f64 {
    let mut others = points.to_vec();
    others.remove(index);
    solve_homography(&others).map_or(f64::NAN, |found| {
        let residuals: Vec<[f64; 2]> = others.iter().map(|point| residual(&found, point)).collect();
        rms(&residuals)
    })
}

/// Centroid and mean distance from it, at least a small positive number.
fn normalization(points: &[CalibrationPoint], of: fn(&CalibrationPoint) -> [f64; 2]) -> ([f64; 2], f64) {
    let points: Vec<[f64; 2]> = points.iter().map(of).collect();
    let centre = centroid(&points);
    let spread = mean(points.iter().map(|p| (p[0] - centre[0]).hypot(p[1] - centre[1])));
    (centre, spread.unwrap_or_default().max(f64::MIN_POSITIVE))
}

fn solve_homography(points: &[CalibrationPoint]) -> Result<Homography, CalibrationError> {
    let (from, from_size) = normalization(points, |p| p.measured);
    let (to, to_size) = normalization(points, |p| p.floor_m);
    let scaled: Vec<([f64; 2], [f64; 2])> = points
        .iter()
        .map(|p| {
            let normalized = [0, 1].map(|axis| (p.measured[axis] - from[axis]) / from_size);
            (normalized, [0, 1].map(|axis| (p.floor_m[axis] - to[axis]) / to_size))
        })
        .collect();
    let collinear = |_| CalibrationError::Undetermined("three of the four points lie on a line");
    let guess = linear_homography(&scaled).map_err(collinear)?;
    let best = fit(&guess, &[1e-6; 8], |h| {
        let at = Homography { rows: rows_of(h) };
        vec![
            scaled
                .iter()
                .map(|(normalized, floor)| {
                    let found = at.to_floor(*normalized);
                    [found[0] - floor[0], found[1] - floor[1]]
                })
                .collect(),
        ]
    });
    let best = best.map_err(collinear)?;
    // Undo both scalings: H = T_to^-1 H' T_from.
    let inner = rows_of(&best.values);
    let after = inner.map(|[a, b, c]| {
        let (a, b) = (a / from_size, b / from_size);
        [a, b, c - a * from[0] - b * from[1]]
    });
    let up = |row: [f64; 3], centre: f64| {
        let [a, b, c] = after[2];
        [to_size * row[0] + centre * a, to_size * row[1] + centre * b, to_size * row[2] + centre * c]
    };
    let rows = [up(after[0], to[0]), up(after[1], to[1]), after[2]];
    let last = rows[2][2];
    Ok(Homography { rows: rows.map(|row| row.map(|number| number / last)) })
}

fn rows_of(h: &[f64]) -> [[f64; 3]; 3] {
    [[h[0], h[1], h[2]], [h[3], h[4], h[5]], [h[6], h[7], 1.0]]
}

/// The eight parameters by linear least squares; in coordinates about the centroid the ninth is not zero.
fn linear_homography(points: &[([f64; 2], [f64; 2])]) -> Result<Vec<f64>, CalibrationError> {
    let mut normal = DMatrix::zeros(8, 8);
    let mut right = DVector::zeros(8);
    for ([u, v], [x, y]) in points {
        for (row, target) in
            [([*u, *v, 1.0, 0.0, 0.0, 0.0, -x * u, -x * v], x), ([0.0, 0.0, 0.0, *u, *v, 1.0, -y * u, -y * v], y)]
        {
            let row = DVector::from_row_slice(&row);
            right.axpy(*target, &row, 1.0);
            normal.ger(1.0, &row, &row, 1.0);
        }
    }
    Ok(ScaledCholesky::new(&normal)?.solve(&right).iter().copied().collect())
}

/// Rotation, translation and scale from the camera's space to the arena.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    pub origin_m: [f64; 2],
    pub heading_rad: f64,
    /// Metres of the floor per unit of the camera.
    pub scale: f64,
    pub rms_m: f64,
}

pub fn fit_similarity(points: &[CalibrationPoint]) -> Result<Similarity, CalibrationError> {
    validate_points(points, 2)?;
    let (from, size) = normalization(points, |p| p.measured);
    let (to, _) = normalization(points, |p| p.floor_m);
    if size <= f64::MIN_POSITIVE {
        return Err(CalibrationError::Undetermined("all points are one"));
    }
    let sums = PairedVectors::about([from, to], points.iter().map(|point| [point.measured, point.floor_m]));
    let heading_rad = sums.angle_rad();
    let scale = sums.cross.hypot(sums.dot) / sums.squares[0];
    let (sin, cos) = heading_rad.sin_cos();
    let turned = |[x, y]: [f64; 2]| [scale * (cos * x - sin * y), scale * (sin * x + cos * y)];
    let at = turned(from);
    let origin_m = [to[0] - at[0], to[1] - at[1]];
    let square = mean(points.iter().map(|point| {
        let [x, y] = turned(point.measured);
        let [dx, dy] = [x + origin_m[0] - point.floor_m[0], y + origin_m[1] - point.floor_m[1]];
        dx * dx + dy * dy
    }));
    Ok(Similarity { origin_m, heading_rad, scale, rms_m: square.unwrap_or_default().sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that looks down at a slant: 640 by 480 pixels onto 2 m by 1.5 m.
    const TRUE: Homography =
        Homography { rows: [[0.0031, 0.0002, -0.1], [-0.0001, 0.0034, 0.2], [0.000_08, 0.000_12, 1.0]] };

    fn calibration_points(pixels: &[[f64; 2]]) -> Vec<CalibrationPoint> {
        pixels.iter().map(|pixel| CalibrationPoint { measured: *pixel, floor_m: TRUE.to_floor(*pixel) }).collect()
    }

    const CORNERS: [[f64; 2]; 4] = [[20.0, 30.0], [610.0, 25.0], [600.0, 450.0], [35.0, 460.0]];

    #[test]
    fn four_points_give_the_camera_back() {
        let found = fit_homography(&calibration_points(&CORNERS)).unwrap();
        let somewhere = [333.0, 222.0];
        let ([x, y], [true_x, true_y]) = (found.homography.to_floor(somewhere), TRUE.to_floor(somewhere));
        assert!((x - true_x).abs() < 1e-9 && (y - true_y).abs() < 1e-9);
        assert!(found.rms_m < 1e-9 && found.rms_without_m.is_empty());
    }

    #[test]
    fn without_a_mistyped_point_the_others_fit() {
        let mut pixels = CORNERS.to_vec();
        pixels.extend([[300.0, 200.0], [150.0, 350.0], [450.0, 120.0]]);
        let mut points = calibration_points(&pixels);
        points[4].floor_m[0] += 0.1;
        let found = fit_homography(&points).unwrap();
        assert!(found.rms_m > 0.02 && found.rms_without_m[4] < 1e-9, "{found:?}");
        for (index, rms_m) in found.rms_without_m.iter().enumerate() {
            assert!(index == 4 || *rms_m > 0.01, "{found:?}");
        }
    }

    #[test]
    fn points_on_a_line_and_too_few_are_refused() {
        let line: Vec<[f64; 2]> = (0..6).map(|i| [f64::from(i) * 100.0, 50.0]).collect();
        assert!(matches!(fit_homography(&calibration_points(&line)), Err(CalibrationError::Undetermined(_))));
        assert!(fit_homography(&calibration_points(&CORNERS[..3])).is_err());
        let mut broken = calibration_points(&CORNERS);
        broken[2].measured[0] = f64::INFINITY;
        assert!(fit_homography(&broken).is_err());
    }

    #[test]
    fn a_camera_that_speaks_of_metres_is_turned_into_the_arena() {
        let (sin, cos) = 0.7_f64.sin_cos();
        let points: Vec<CalibrationPoint> = [[0.0, 0.0], [1.0, 0.2], [-0.4, 2.0]]
            .iter()
            .map(|[u, v]| CalibrationPoint {
                measured: [*u, *v],
                floor_m: [1.5 + 1.02 * (cos * u - sin * v), -0.5 + 1.02 * (sin * u + cos * v)],
            })
            .collect();
        let found = fit_similarity(&points).unwrap();
        assert!((found.heading_rad - 0.7).abs() < 1e-12 && (found.scale - 1.02).abs() < 1e-12);
        assert!((found.origin_m[0] - 1.5).abs() < 1e-12 && (found.origin_m[1] + 0.5).abs() < 1e-12);
        assert!(found.rms_m < 1e-12);
        let same = [points[0], points[0]];
        assert!(fit_similarity(&same).is_err());
    }
}

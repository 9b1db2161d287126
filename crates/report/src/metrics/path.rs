//! How far a robot strays from the path that it should follow: the cross-track error.
//!
//! The distance goes to the nearest point of a polyline, whichever leg that is on. It says nothing about being early or
//! late along the path.

use posebridge_estimator::numerics::statistics::root_mean_square;
use posebridge_telemetry::{Arena, Point2};

/// How far positions lie from a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathError {
    /// Positions that were scored.
    pub samples: usize,
    /// Positions left out because they are not finite.
    pub dropped: usize,
    /// Root mean square distance, in metres.
    pub rms_m: Option<f64>,
    /// Largest distance, in metres.
    pub max_m: Option<f64>,
}

/// The cross-track error of positions against a polyline. Without a finite vertex every position is dropped.
pub fn path_error(positions: &[Point2<Arena>], path: &[Point2<Arena>]) -> PathError {
    summarise_deviations(&deviations_from_path(positions, path))
}

/// The distance of each position from the nearest point of the polyline, in metres, in the order of the positions;
/// NaN where the position is not finite or the path has no finite vertex. Vertices that are not finite are left out.
pub fn deviations_from_path(positions: &[Point2<Arena>], path: &[Point2<Arena>]) -> Vec<f64> {
    let path: Vec<Point2<Arena>> = path.iter().copied().filter(is_finite).collect();
    positions.iter().map(|position| deviation_m(*position, &path).unwrap_or(f64::NAN)).collect()
}

pub(super) fn summarise_deviations(deviations_m: &[f64]) -> PathError {
    let finite: Vec<f64> = deviations_m.iter().copied().filter(|deviation| deviation.is_finite()).collect();
    PathError {
        samples: finite.len(),
        dropped: deviations_m.len() - finite.len(),
        rms_m: root_mean_square(&finite),
        max_m: finite.iter().copied().reduce(f64::max),
    }
}

fn is_finite(point: &Point2<Arena>) -> bool {
    point.x.0.is_finite() && point.y.0.is_finite()
}

fn deviation_m(position: Point2<Arena>, path: &[Point2<Arena>]) -> Option<f64> {
    let first = path.first()?;
    if !is_finite(&position) {
        return None;
    }
    let nearest_m = path
        .windows(2)
        .map(|leg| distance_to_leg_m(position, leg[0], leg[1]))
        .fold(position.distance(*first).0, f64::min);
    Some(nearest_m)
}

/// The distance from a point to the nearest point of the leg from `a` to `b`.
fn distance_to_leg_m(point: Point2<Arena>, a: Point2<Arena>, b: Point2<Arena>) -> f64 {
    let (leg_x, leg_y) = (b.x.0 - a.x.0, b.y.0 - a.y.0);
    let length_squared = leg_x * leg_x + leg_y * leg_y;
    if length_squared == 0.0 {
        return point.distance(a).0;
    }
    let along = ((point.x.0 - a.x.0) * leg_x + (point.y.0 - a.y.0) * leg_y) / length_squared;
    let along = along.clamp(0.0, 1.0);
    (point.x.0 - a.x.0 - along * leg_x).hypot(point.y.0 - a.y.0 - along * leg_y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Meters;

    fn point(x_m: f64, y_m: f64) -> Point2<Arena> {
        Point2::new(Meters(x_m), Meters(y_m))
    }

    #[test]
    fn the_nearest_leg_counts_and_ends_are_round() {
        let path = [point(0.0, 0.0), point(3.0, 0.0), point(3.0, 3.0)];
        let positions = [point(1.0, 0.3), point(3.4, 2.0), point(-3.0, -4.0), point(2.9, 1.0)];
        let deviations = deviations_from_path(&positions, &path);
        for (deviation, by_hand) in deviations.iter().zip([0.3, 0.4, 5.0, 0.1]) {
            assert!((deviation - by_hand).abs() < 1e-12);
        }
    }

    #[test]
    fn rms_and_max_of_a_worked_example() {
        let path = [point(0.0, 0.0), point(10.0, 0.0)];
        let positions = [point(1.0, 3.0), point(2.0, -4.0), point(f64::NAN, 0.0)];
        let error = path_error(&positions, &path);
        assert_eq!((error.samples, error.dropped, error.max_m), (2, 1, Some(4.0)));
        assert!((error.rms_m.unwrap() - 12.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_path_of_one_point_or_none_is_no_trouble() {
        let positions = [point(3.0, 4.0)];
        assert_eq!(path_error(&positions, &[point(0.0, 0.0)]).max_m, Some(5.0));
        assert_eq!(path_error(&positions, &[]).dropped, 1);
        let twice = [point(0.0, 0.0), point(0.0, 0.0), point(f64::NAN, 9.0)];
        assert_eq!(path_error(&positions, &twice).max_m, Some(5.0));
    }
}

//! The error of a pose: estimated minus true, in the arena.
//!
//! All accuracy metrics use this type, for the estimate, the brick's own odometry and foreign programs. It holds the claimed covariance
//! beside the error, because a consistency test needs both.

use posebridge_estimator::numerics::statistics::{mean, root_mean_square};
use posebridge_telemetry::{Arena, Estimate, Heading, Point2, Pose};

use super::consistency::{Anees, nees};
use crate::track::PoseTrack;

/// Estimated minus true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Along the arena's x.
    pub dx_m: f64,
    /// Along the arena's y.
    pub dy_m: f64,
    /// In (-pi, pi]; `None` if one of the two poses has no heading.
    pub heading_rad: Option<f64>,
    /// Claimed covariance of x, y and heading, in m², m rad and rad²; `None` without a claim.
    pub covariance: Option<[[f64; 3]; 3]>,
}

impl PoseError {
    /// Without a claimed covariance.
    pub fn between(estimated: Pose<Arena>, truth: Pose<Arena>) -> Self {
        Self {
            dx_m: estimated.x.0 - truth.x.0,
            dy_m: estimated.y.0 - truth.y.0,
            heading_rad: Some((estimated.heading - truth.heading).0),
            covariance: None,
        }
    }

    /// With the claimed covariance. Without a valid heading neither heading nor covariance is tested.
    pub fn of_estimate(estimate: &Estimate, truth: Pose<Arena>) -> Self {
        let error = Self::between(estimate.pose, truth);
        if !estimate.validity.heading {
            return Self { heading_rad: None, ..error };
        }
        let claimed = std::array::from_fn(|row| std::array::from_fn(|column| estimate.covariance[row][column]));
        Self { covariance: Some(claimed), ..error }
    }

    pub fn position_m(&self) -> f64 {
        self.dx_m.hypot(self.dy_m)
    }

    /// Position and heading; the covariance is checked separately.
    pub fn is_finite(&self) -> bool {
        self.position_m().is_finite() && self.heading_rad.is_none_or(f64::is_finite)
    }
}

/// Errors at the estimates' own timestamps. Estimates without a valid position and instants without truth are left out.
pub fn errors_of_estimates(estimates: &[Estimate], truth: &PoseTrack) -> Vec<PoseError> {
    estimates
        .iter()
        .filter(|estimate| estimate.validity.position)
        .filter_map(|estimate| {
            let true_pose = truth.at(estimate.stamp)?;
            Some(PoseError::of_estimate(estimate, true_pose))
        })
        .collect()
}

/// Errors of a track without covariance, such as the brick's own odometry, at its own timestamps.
pub fn errors_of_track(track: &PoseTrack, truth: &PoseTrack) -> Vec<PoseError> {
    track.samples().iter().filter_map(|sample| Some(PoseError::between(sample.pose, truth.at(sample.time)?))).collect()
}

const POSE_ROWS: usize = 3;

/// Mean of the normalised errors over 3, over all samples with heading and covariance.
pub fn anees(errors: &[PoseError]) -> Anees {
    let mut sum = 0.0;
    let mut outcome = Anees::default();
    for error in errors.iter().filter(|error| error.is_finite()) {
        let (Some(heading_rad), Some(covariance)) = (error.heading_rad, error.covariance) else {
            continue;
        };
        let wrapped_rad = Heading::from_rad(heading_rad).rad();
        match nees([error.dx_m, error.dy_m, wrapped_rad], &covariance) {
            Ok(value) => {
                sum += value;
                outcome.samples += 1;
            }
            Err(_) => outcome.refused += 1,
        }
    }
    if outcome.samples > 0 {
        outcome.value = Some(sum / (outcome.samples * POSE_ROWS) as f64);
    }
    outcome
}

/// Accuracy of one run, or the mean over several.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorSummary {
    pub samples: usize,
    /// Omitted because they are not finite.
    pub dropped: usize,
    /// Covariances that are not positive definite or not finite.
    pub refused_covariances: usize,
    /// Root mean square distance between estimated and true position.
    pub position_rms_m: Option<f64>,
    pub position_max_m: Option<f64>,
    pub position_end_m: Option<f64>,
    /// Root mean square of the wrapped heading errors.
    pub heading_rms_rad: Option<f64>,
    /// Average normalised estimation error squared over 3; 1 is consistent.
    pub anees: Option<f64>,
}

/// Errors must be in time order. Each heading error is wrapped into (-pi, pi] first.
pub fn summarise(errors: &[PoseError]) -> ErrorSummary {
    let finite = || errors.iter().filter(|error| error.is_finite());
    let distances_m: Vec<f64> = finite().map(PoseError::position_m).collect();
    let turns_rad = finite().filter_map(|error| error.heading_rad).map(|turn_rad| Heading::from_rad(turn_rad).rad());
    let claims = anees(errors);
    ErrorSummary {
        samples: distances_m.len(),
        dropped: errors.len() - distances_m.len(),
        refused_covariances: claims.refused,
        position_rms_m: root_mean_square(&distances_m),
        position_max_m: distances_m.iter().copied().reduce(f64::max),
        position_end_m: distances_m.last().copied(),
        heading_rms_rad: root_mean_square(&turns_rad.collect::<Vec<f64>>()),
        anees: claims.value,
    }
}

/// Averages each figure over the runs that have it (so `position_max_m` is the mean of the runs' maxima); the counts are summed.
pub fn mean_over_runs(runs: &[ErrorSummary]) -> ErrorSummary {
    let mean = |figure: fn(&ErrorSummary) -> Option<f64>| mean(runs.iter().filter_map(figure));
    ErrorSummary {
        samples: runs.iter().map(|run| run.samples).sum(),
        dropped: runs.iter().map(|run| run.dropped).sum(),
        refused_covariances: runs.iter().map(|run| run.refused_covariances).sum(),
        position_rms_m: mean(|run| run.position_rms_m),
        position_max_m: mean(|run| run.position_max_m),
        position_end_m: mean(|run| run.position_end_m),
        heading_rms_rad: mean(|run| run.heading_rms_rad),
        anees: mean(|run| run.anees),
    }
}

/// Distances of positions from a path.
///
/// The cross-track error: the distance goes to the nearest point of a polyline, whichever leg that is on. It says nothing about being
/// early or late along the path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathError {
    pub samples: usize,
    /// Omitted because they are not finite.
    pub dropped: usize,
    pub rms_m: Option<f64>,
    pub max_m: Option<f64>,
}

/// The cross-track error of positions against a polyline, whose non-finite vertices are ignored. Without a finite one every position is
/// dropped.
pub fn path_error(positions: &[Point2<Arena>], path: &[Point2<Arena>]) -> PathError {
    let path: Vec<Point2<Arena>> = path.iter().copied().filter(is_finite).collect();
    let deviations_m = positions.iter().filter_map(|position| deviation_m(*position, &path));
    let finite: Vec<f64> = deviations_m.filter(|deviation| deviation.is_finite()).collect();
    PathError {
        samples: finite.len(),
        dropped: positions.len() - finite.len(),
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

/// Distance from `point` to the segment from `a` to `b`.
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
    use posebridge_telemetry::Meters;

    use super::*;

    fn error(dx_m: f64, dy_m: f64, heading_rad: Option<f64>) -> PoseError {
        PoseError { dx_m, dy_m, heading_rad, covariance: None }
    }

    #[test]
    fn a_run_of_three_errors_by_hand() {
        let summary = summarise(&[
            error(3.0, 4.0, Some(0.3)),
            error(f64::NAN, 0.0, Some(9.0)),
            error(0.0, 1.0, Some(0.4 + std::f64::consts::TAU)),
        ]);
        assert_eq!((summary.samples, summary.dropped), (2, 1));
        assert!((summary.position_rms_m.unwrap() - 13.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(summary.position_max_m, Some(5.0));
        assert_eq!(summary.position_end_m, Some(1.0));
        assert!((summary.heading_rms_rad.unwrap() - 0.125_f64.sqrt()).abs() < 1e-12);
        assert_eq!(summary.anees, None);
    }

    #[test]
    fn broken_claims_are_counted_beside_the_mean() {
        let sample = |covariance| PoseError { dx_m: 3.0, dy_m: 0.0, heading_rad: Some(0.0), covariance };
        let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let outcome = anees(&[sample(Some(unit)), sample(Some([[0.0; 3]; 3])), sample(None)]);
        assert_eq!(outcome, Anees { value: Some(3.0), samples: 1, refused: 1 });
    }

    #[test]
    fn the_end_of_a_run_is_its_last_finite_error() {
        let summary = summarise(&[error(0.0, 2.0, None), error(f64::INFINITY, 0.0, None)]);
        assert_eq!(summary.position_end_m, Some(2.0));
        assert_eq!(summary.heading_rms_rad, None);
    }

    #[test]
    fn nothing_gives_nothing() {
        assert_eq!(summarise(&[]), ErrorSummary::default());
        assert_eq!(mean_over_runs(&[]), ErrorSummary::default());
    }

    #[test]
    fn the_mean_over_runs_is_a_mean_of_figures_and_skips_runs_without_them() {
        let one = summarise(&[error(1.0, 0.0, Some(0.2))]);
        let three = summarise(&[error(3.0, 0.0, None), error(3.0, 0.0, None)]);
        let mean = mean_over_runs(&[one, three]);
        assert_eq!(mean.samples, 3);
        assert_eq!(mean.position_rms_m, Some(2.0));
        assert_eq!(mean.heading_rms_rad, Some(0.2));
    }

    fn point(x_m: f64, y_m: f64) -> Point2<Arena> {
        Point2::new(Meters(x_m), Meters(y_m))
    }

    #[test]
    fn the_nearest_leg_counts_and_ends_are_round() {
        let path = [point(0.0, 0.0), point(3.0, 0.0), point(3.0, 3.0)];
        let positions = [point(1.0, 0.3), point(3.4, 2.0), point(-3.0, -4.0), point(2.9, 1.0)];
        for (position, by_hand) in positions.iter().zip([0.3, 0.4, 5.0, 0.1]) {
            assert!((path_error(&[*position], &path).max_m.unwrap() - by_hand).abs() < 1e-12);
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

//! End errors of estimates: errors in x and y at the end of a course, over many runs.
//!
//! A closed course is scored by its end point alone, as in the source papers.

use posebridge_estimator::Filter;
use posebridge_estimator::numerics::statistics::{quantile, root_mean_square};
use posebridge_report::metrics::{PoseError, anees};
use posebridge_telemetry::{Arena, Estimate, Observation, Pose};

use crate::statistics::uncertain_mean;

const HIGH_QUANTILE: f64 = 0.95;

/// The result of a filter over a course: end error and estimated path.
#[derive(Clone, Debug, PartialEq)]
pub struct FilteredDrive {
    /// Estimated minus true at the end; `None` without an estimate.
    pub end: Option<PoseError>,
    /// After each observation that changed it.
    pub track: Vec<TrackPoint>,
}

/// A place of an estimated path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// By the clock of the drive.
    pub at_s: f64,
    pub x_m: f64,
    pub y_m: f64,
}

/// Runs a filter over observations in turn; returns its last estimate, and the places after each observation that changed them.
pub(crate) fn track_of<'a>(
    filter: &mut dyn Filter,
    observations: impl Iterator<Item = &'a Observation>,
) -> (Option<Estimate>, Vec<TrackPoint>) {
    let mut track: Vec<TrackPoint> = Vec::new();
    let mut last = None;
    for observation in observations {
        filter.observe(observation);
        let Some(estimate) = filter.latest_time().and_then(|at| filter.estimate_at(at)) else { continue };
        let (x_m, y_m) = (estimate.pose.x.0, estimate.pose.y.0);
        if track.last().is_none_or(|last| (last.x_m, last.y_m) != (x_m, y_m)) {
            track.push(TrackPoint { at_s: estimate.stamp.as_secs_f64(), x_m, y_m });
        }
        last = Some(estimate);
    }
    (last, track)
}

/// `truth` is the pose at the end of the course.
pub fn run_filter<'a>(
    filter: &mut dyn Filter,
    observations: impl Iterator<Item = &'a Observation>,
    truth: Pose<Arena>,
) -> FilteredDrive {
    let (last, track) = track_of(filter, observations);
    FilteredDrive { end: last.map(|estimate| PoseError::of_estimate(&estimate, truth)), track }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EndErrorSummary {
    pub runs: usize,
    /// In x and y.
    pub rms_m: (f64, f64),
    /// 95 % quantile of the absolute errors in x and y.
    pub p95_m: (f64, f64),
    /// Of the distance from the true end.
    pub median_m: f64,
    /// Runs within the limits in x, in y, and in both.
    pub within: (usize, usize, usize),
    /// Mean of e' P^-1 e / 3 at the end; 1 is consistent.
    pub anees: Option<f64>,
}

/// `limits_m` are the limits in x and y for `EndErrorSummary::within`.
pub fn summarise_ends(ends: &[Option<PoseError>], limits_m: (f64, f64)) -> EndErrorSummary {
    let ends: Vec<PoseError> = ends.iter().flatten().copied().collect();
    let of = |value: &dyn Fn(&PoseError) -> f64| -> Vec<f64> { ends.iter().map(value).collect() };
    let x = of(&|end| end.dx_m.abs());
    let y = of(&|end| end.dy_m.abs());
    let rms = |values: &[f64]| root_mean_square(values).unwrap_or(0.0);
    let high = |values: &[f64]| quantile(values, HIGH_QUANTILE).unwrap_or(0.0);
    let count = |fits: &dyn Fn(&PoseError) -> bool| ends.iter().filter(|end| fits(end)).count();
    let in_x = |end: &PoseError| end.dx_m.abs() <= limits_m.0;
    let in_y = |end: &PoseError| end.dy_m.abs() <= limits_m.1;
    EndErrorSummary {
        runs: ends.len(),
        rms_m: (rms(&x), rms(&y)),
        p95_m: (high(&x), high(&y)),
        median_m: quantile(&of(&PoseError::position_m), 0.5).unwrap_or(0.0),
        within: (count(&in_x), count(&in_y), count(&|end| in_x(end) && in_y(end))),
        anees: anees(&ends).value,
    }
}

/// Number of runs in which the first ends nearer to the truth than the second; a run without an end is not near.
pub fn count_nearer(ours: &[Option<PoseError>], theirs: &[Option<PoseError>]) -> usize {
    let pairs = ours.iter().zip(theirs);
    let wins = pairs.filter(|(ours, theirs)| match (ours, theirs) {
        (Some(ours), Some(theirs)) => ours.position_m() < theirs.position_m(),
        (Some(_), None) => true,
        (None, _) => false,
    });
    wins.count()
}

/// Difference of the squared errors of two estimators, run by run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairedDifference {
    /// Mean of theirs minus ours, in x and y; positive if ours is nearer.
    pub mean_m2: (f64, f64),
    pub sigma_m2: (f64, f64),
}

/// Compares two estimators over the same runs. The random numbers of a run are common to both, so that the difference is known better
/// than either error; `None` with fewer than two runs in which both have an end.
pub fn paired_difference(ours: &[Option<PoseError>], theirs: &[Option<PoseError>]) -> Option<PairedDifference> {
    let pairs = ours.iter().zip(theirs);
    let both: Vec<(f64, f64)> = pairs
        .filter_map(|(ours, theirs)| {
            let (ours, theirs) = (ours.as_ref()?, theirs.as_ref()?);
            Some((theirs.dx_m.powi(2) - ours.dx_m.powi(2), theirs.dy_m.powi(2) - ours.dy_m.powi(2)))
        })
        .collect();
    let x = uncertain_mean(&both.iter().map(|pair| pair.0).collect::<Vec<_>>())?;
    let y = uncertain_mean(&both.iter().map(|pair| pair.1).collect::<Vec<_>>())?;
    Some(PairedDifference { mean_m2: (x.value, y.value), sigma_m2: (x.sigma, y.sigma) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(dx_m: f64, dy_m: f64) -> PoseError {
        PoseError { dx_m, dy_m, heading_rad: None, covariance: None }
    }

    #[test]
    fn ninety_five_of_a_hundred_stay_below_the_figure() {
        let ends: Vec<_> = (1..=100).map(|run| Some(end(-0.01 * f64::from(run), 0.0))).collect();
        let found = summarise_ends(&ends, (0.235, 0.32));
        assert!((found.p95_m.0 - 0.95).abs() < 1e-12);
        assert!((found.median_m - 0.5).abs() < 1e-12);
        assert_eq!(found.within, (23, 100, 23));
        // Sum of squares of 1 to 100 is 338350.
        assert!((found.rms_m.0 - 0.01 * 3_383.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(found.anees, None);
        assert_eq!(summarise_ends(&[None], (1.0, 1.0)).runs, 0);
    }

    #[test]
    fn nearer_counts_run_by_run() {
        let ours = [Some(end(0.1, 0.0)), Some(end(0.3, 0.4)), None, Some(end(9.0, 9.0))];
        let theirs = [Some(end(0.0, 0.2)), Some(end(0.4, 0.2)), Some(end(5.0, 5.0)), None];
        assert_eq!(count_nearer(&ours, &theirs), 2);
    }

    #[test]
    fn paired_errors_are_compared_run_by_run() {
        let ours = [Some(end(0.1, 0.0)), None, Some(end(0.2, 0.3))];
        let theirs = [Some(end(0.3, 0.1)), Some(end(9.0, 9.0)), Some(end(-0.4, 0.0))];
        let found = paired_difference(&ours, &theirs).unwrap();
        // x: 0.08 and 0.12; y: 0.01 and -0.09.
        assert!((found.mean_m2.0 - 0.10).abs() < 1e-12 && (found.mean_m2.1 + 0.04).abs() < 1e-12);
        assert!((found.sigma_m2.0 - 0.02).abs() < 1e-12 && (found.sigma_m2.1 - 0.05).abs() < 1e-12);
        assert_eq!(paired_difference(&ours[..2], &theirs[..2]), None);
    }
}

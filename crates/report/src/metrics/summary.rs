//! The accuracy of one run in six numbers, and the mean of such numbers over runs.

use super::anees::{Anees, anees};
use super::consistency::Consistency;
use super::error::PoseError;
use super::{heading, position};
use posebridge_estimator::numerics::statistics;

/// The accuracy of one run, or the mean over several.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorSummary {
    /// Errors that were scored.
    pub samples: usize,
    /// Errors left out because they are not finite.
    pub dropped: usize,
    /// Covariances that could not be tested: not positive definite, or not finite.
    pub refused_covariances: usize,
    /// Root mean square distance between estimated and true position, in metres.
    pub position_rms_m: Option<f64>,
    /// Largest such distance, in metres.
    pub position_max_m: Option<f64>,
    /// Such distance at the end of the run, in metres.
    pub position_end_m: Option<f64>,
    /// Root mean square heading error, each the short way, in radians.
    pub heading_rms_rad: Option<f64>,
    /// Average normalised estimation error squared over 3; 1 is honest.
    pub anees: Option<f64>,
}

impl ErrorSummary {
    /// The verdict on the claimed covariance over this number of independent runs (1 for a single run).
    pub fn consistency(&self, runs: u64) -> Consistency {
        let outcome = Anees { value: self.anees, samples: self.samples, refused: self.refused_covariances };
        Consistency::of_anees(&outcome, runs)
    }
}

/// The figures of one run; errors in the order of time.
pub fn summarise(errors: &[PoseError]) -> ErrorSummary {
    let samples = errors.iter().filter(|error| error.is_finite()).count();
    let honesty = anees(errors);
    ErrorSummary {
        samples,
        dropped: errors.len() - samples,
        refused_covariances: honesty.refused,
        position_rms_m: position::rms_m(errors),
        position_max_m: position::max_m(errors),
        position_end_m: position::end_m(errors),
        heading_rms_rad: heading::rms_rad(errors),
        anees: honesty.value,
    }
}

/// Each figure averaged over the runs that have it (so `position_max_m` is the mean of the runs' maxima); the counts
/// are summed.
pub fn mean_over_runs(runs: &[ErrorSummary]) -> ErrorSummary {
    let mean = |figure: fn(&ErrorSummary) -> Option<f64>| statistics::mean(runs.iter().filter_map(figure));
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

#[cfg(test)]
mod tests {
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
}

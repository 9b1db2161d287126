//! The offline smoother over a known drive: what a report can know, where a filter must answer at once.

use posebridge_estimator::FilterConfig;
use posebridge_estimator::smoother::{OfflineError, SmoothedTrajectory};
use posebridge_report::metrics::SourceTally;
use posebridge_report::smoothed::SmoothedPath;
use posebridge_telemetry::{Observation, ObservationKind};

use super::{FilterScore, ReferenceDrive};

/// The score of one drive in hindsight.
#[derive(Clone, Debug, PartialEq)]
pub struct SmootherScore {
    /// Of every step that counts; without a path, of steps without an estimate.
    pub score: FilterScore,
    /// Why there is no path.
    pub error: Option<OfflineError>,
}

/// A way to smooth a whole run: [`posebridge_estimator::smoother::batch()`] or [`posebridge_estimator::smoother::rts()`].
pub type SmootherFn = fn(&FilterConfig, &[Observation]) -> Result<SmoothedTrajectory, OfflineError>;

/// Smooths a whole drive and scores the path at the steps at which a filter is scored.
///
/// The path at a step knows what was observed after it. Of the observations only the fixes are tallied, all under the sensor of the
/// first one: a fix that the path leaves out counts as gated.
pub fn score_smoother(drive: &ReferenceDrive, config: &FilterConfig, smoother: SmootherFn) -> SmootherScore {
    let observations: Vec<Observation> = drive.arrivals.iter().map(|arrival| arrival.observation).collect();
    let (path, tally, refusal) = match smoother(config, &observations) {
        Ok(smoothed) => {
            let tally = fixes_of(&smoothed, &observations);
            (SmoothedPath::new(smoothed.poses), tally, None)
        }
        Err(refusal) => (SmoothedPath::default(), None, Some(refusal)),
    };
    let mut score = FilterScore::default();
    if let Some(tally) = tally {
        score.add_tally(&tally);
    }
    for truth in drive.truth.iter().skip(drive.scored_from) {
        score.add_step(truth.pose, path.at(truth.time).as_ref());
    }
    score.end_run();
    SmootherScore { score, error: refusal }
}

fn fixes_of(smoothed: &SmoothedTrajectory, observations: &[Observation]) -> Option<SourceTally> {
    let first = observations.iter().find(|observation| matches!(observation.measurement, ObservationKind::Fix(_)))?;
    let mut tally = SourceTally::new(first.sensor);
    tally.used = smoothed.fixes_used as u64;
    tally.gated = smoothed.fixes_rejected as u64;
    Some(tally)
}

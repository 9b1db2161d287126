//! How a filter gets over what happens to its robot: kidnaps, an unknown start, and wheels that spin.
//!
//! ```text
//! recovery   from a landing until the first step from which the pose is right for a second
//! right      within 0.2 m and 15 degrees
//! ```
//! A robot that sees landmarks alone cannot know its pose before it has seen two of them, so its time begins then.

use std::collections::BTreeSet;

use posebridge_estimator::numerics::statistics::quantile;
use posebridge_report::metrics::PoseError;
use posebridge_report::track::TimedPose;
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Estimate, FusionOutcome, FusionRecord, LandmarkId, ObservationKind};

use super::drive::{ObservationArrival, ReferenceDrive};

const RIGHT_M: f64 = 0.2;
const RIGHT_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
const RIGHT_FOR_S: f64 = 1.0;
/// A slip has its effect on the fixes within this time.
const SLIP_EFFECT_S: f64 = 5.0;

/// How an estimator got over what happened to its robot, over all runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DisturbanceScore {
    /// Of each landing, s; infinite where the pose never became right.
    pub recoveries_s: Vec<f64>,
    /// Times at which the filter moved its pose to what observations say, the first pose of an unknown start included.
    pub resets: u64,
    /// Fixes within five seconds after a slip that were refused; the first one after it is not counted.
    pub fixes_gated_after_slips: u64,
}

impl DisturbanceScore {
    pub(super) fn merge(&mut self, other: &Self) {
        self.recoveries_s.extend_from_slice(&other.recoveries_s);
        self.resets += other.resets;
        self.fixes_gated_after_slips += other.fixes_gated_after_slips;
    }

    /// Of the recoveries; `None` without one.
    pub fn recovery_s(&self, share: f64) -> Option<f64> {
        quantile(&self.recoveries_s, share)
    }
}

/// Watches one drive.
pub(super) struct DisturbanceScorer<'a> {
    drive: &'a ReferenceDrive,
    /// From where each recovery counts.
    begins: Vec<usize>,
    right_since: Option<usize>,
    /// The landing that is not yet recovered from.
    lost: Option<usize>,
    /// The slip burst after which a fix has come.
    fix_after: Option<usize>,
    score: DisturbanceScore,
}

impl<'a> DisturbanceScorer<'a> {
    pub(super) fn new(drive: &'a ReferenceDrive) -> Self {
        let begins = drive.landings.iter().map(|landing| observable_from(drive, *landing)).collect();
        let score = DisturbanceScore::default();
        Self { drive, begins, right_since: None, lost: None, fix_after: None, score }
    }

    pub(super) fn add_record(&mut self, arrival: &ObservationArrival, record: &FusionRecord) {
        if record.outcome == FusionOutcome::PoseReset {
            self.score.resets += 1;
        }
        if !matches!(arrival.observation.measurement, ObservationKind::Fix(_)) {
            return;
        }
        let slip = self.drive.slip_bursts.iter().rev().find(|slip| **slip <= arrival.measured_step).copied();
        let Some(slip) = slip.filter(|slip| self.seconds(*slip, arrival.measured_step) <= SLIP_EFFECT_S) else {
            return;
        };
        let is_first = self.fix_after.replace(slip) != Some(slip);
        if record.outcome == FusionOutcome::Gated && !is_first {
            self.score.fixes_gated_after_slips += 1;
        }
    }

    pub(super) fn add_step(&mut self, step: usize, truth: &TimedPose, estimate: Option<&Estimate>) {
        if let Some(index) = self.drive.landings.iter().position(|landing| *landing == step) {
            // One that is not recovered from when the next one comes is lost for good.
            if self.lost.replace(index).is_some() {
                self.score.recoveries_s.push(f64::INFINITY);
            }
            self.right_since = None;
        }
        let Some(lost) = self.lost else { return };
        if !estimate.is_some_and(|estimate| is_right(estimate, truth)) {
            self.right_since = None;
            return;
        }
        let since = *self.right_since.get_or_insert(step);
        if self.seconds(since, step) >= RIGHT_FOR_S {
            self.end_recovery(lost, since);
        }
    }

    fn end_recovery(&mut self, lost: usize, since: usize) {
        self.score.recoveries_s.push(self.seconds(self.begins[lost], since.max(self.begins[lost])));
        self.lost = None;
    }

    pub(super) fn end(mut self) -> DisturbanceScore {
        match (self.lost, self.right_since) {
            (Some(lost), Some(since)) => self.end_recovery(lost, since),
            (Some(_), None) => self.score.recoveries_s.push(f64::INFINITY),
            (None, _) => {}
        }
        self.score
    }

    fn seconds(&self, from: usize, to: usize) -> f64 {
        (self.drive.truth[to].time - self.drive.truth[from].time).as_secs_f64()
    }
}

/// The step at which the pose can be known again: the landing itself, and without fixes the arrival of a second landmark.
fn observable_from(drive: &ReferenceDrive, landing: usize) -> usize {
    let is_fix = |arrival: &ObservationArrival| matches!(arrival.observation.measurement, ObservationKind::Fix(_));
    if drive.arrivals.iter().any(is_fix) {
        return landing;
    }
    let mut seen: BTreeSet<LandmarkId> = BTreeSet::new();
    for arrival in drive.arrivals.iter().filter(|arrival| arrival.measured_step >= landing) {
        if let ObservationKind::Landmark { id, .. } = arrival.observation.measurement {
            seen.insert(id);
            if seen.len() > 1 {
                return arrival.step;
            }
        }
    }
    landing
}

fn is_right(estimate: &Estimate, truth: &TimedPose) -> bool {
    let error = PoseError::of_estimate(estimate, truth.pose);
    let is_turned_right = error.heading_rad.is_some_and(|heading_rad| wrap_rad(heading_rad).abs() <= RIGHT_RAD);
    estimate.validity.position && error.position_m() <= RIGHT_M && is_turned_right
}

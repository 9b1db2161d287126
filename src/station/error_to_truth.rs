//! How far off odometry and estimate are at this moment, where a simulated brick sends the truth.

use std::collections::VecDeque;

use posebridge_report::{PoseTrack, TimedPose};
use posebridge_sim::TruthSample;
use posebridge_telemetry::{Estimate, RobotId, TimeDelta};

use super::event_collector::MAX_INTERPOLATION_GAP;
use super::simulator::truth_tap::TruthTap;

/// So much truth is kept: an estimate to steer by is newer.
const TRUTH_WINDOW: TimeDelta = TimeDelta::from_millis(2_000);

/// How far off odometry and estimate are, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentErrors {
    /// Of the brick's own odometry.
    pub odometry_m: f64,
    /// Of the estimate; `None` while none can be compared.
    pub estimate_m: Option<f64>,
}

/// A line for people about one robot or several; `None` before anything is known.
pub fn error_line(errors: &[CurrentErrors]) -> Option<String> {
    let largest = |values: &mut dyn Iterator<Item = f64>| values.reduce(f64::max);
    let odometry_m = largest(&mut errors.iter().map(|errors| errors.odometry_m))?;
    let estimate_m = largest(&mut errors.iter().filter_map(|errors| errors.estimate_m));
    let at_most = if errors.len() > 1 { " at most" } else { "" };
    let estimate = estimate_m
        .map_or_else(|| "estimate not known".to_owned(), |off_m| format!("estimate {off_m:.3} m off{at_most}"));
    let line = format!("odometry {odometry_m:.2} m off{at_most}, {estimate}");
    Some(if errors.len() > 1 { format!("{} robots: {line}", errors.len()) } else { line })
}

/// Holds estimates against the truth as it comes.
pub struct ErrorToTruth {
    tap: TruthTap,
    truth: VecDeque<TruthSample>,
    /// Of the same time; some of them are ahead of the truth, which comes at its own instants.
    estimates: VecDeque<TimedPose>,
}

/// Most estimates that are kept: 2 s of a brick that is as fast as any.
const MAX_ESTIMATES: usize = 1_024;

impl ErrorToTruth {
    /// Of a brick that is watched.
    pub const fn new(tap: TruthTap) -> Self {
        Self { tap, truth: VecDeque::new(), estimates: VecDeque::new() }
    }

    /// The errors of now; `None` before anything is known.
    pub fn errors(&mut self) -> Option<CurrentErrors> {
        self.drain_truth();
        let newest = self.truth.back()?;
        let odometry_m = newest.odometry.origin().distance(newest.pose.origin()).0;
        Some(CurrentErrors { odometry_m, estimate_m: self.estimate_m() })
    }

    /// Takes note of an estimate of any robot.
    pub fn push_estimate(&mut self, robot: RobotId, estimate: &Estimate) {
        if self.tap.robot().is_none_or(|own| own == robot) && estimate.validity.position {
            if self.estimates.len() >= MAX_ESTIMATES {
                self.estimates.pop_front();
            }
            self.estimates.push_back(TimedPose { time: estimate.stamp, pose: estimate.pose });
        }
    }

    /// How far the last estimate whose instant the truth has reached was off then, in metres.
    fn estimate_m(&self) -> Option<f64> {
        let samples = self.truth.iter().map(|sample| TimedPose { time: sample.brick_time, pose: sample.pose });
        let really = PoseTrack::new(samples, MAX_INTERPOLATION_GAP);
        self.estimates.iter().rev().find_map(|estimate| {
            let pose = really.at(estimate.time)?;
            Some(pose.origin().distance(estimate.pose.origin()).0)
        })
    }

    fn drain_truth(&mut self) {
        self.truth.extend(self.tap.drain().into_iter().map(|live| live.sample));
        let newest = self.truth.back().map(|sample| sample.sim_time);
        while let (Some(newest), Some(oldest)) = (newest, self.truth.front())
            && newest - oldest.sim_time > TRUTH_WINDOW
        {
            self.truth.pop_front();
        }
    }
}

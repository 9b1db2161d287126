//! How far off odometry and estimate are at this moment, where a simulated brick tells the truth.

use std::collections::VecDeque;

use posebridge_analysis::{TimedPose, Track};
use posebridge_sim::TruthSample;
use posebridge_telemetry::{Estimate, Span};

use crate::collect::LONGEST_GAP;
use crate::tasks::truth_tap::TruthTap;

/// So much truth is kept: an estimate is younger, or it is none that anybody steers by.
const KEPT: Span = Span::from_millis(2_000);

/// Holds estimates against the truth as it comes.
pub struct Off {
    tap: TruthTap,
    truth: VecDeque<TruthSample>,
    /// Of the same time; some of them are ahead of the truth, which is told at its own instants.
    estimates: VecDeque<TimedPose>,
}

/// So many estimates are kept at most: 2 s of a brick that is as fast as any.
const MOST_ESTIMATES: usize = 1_024;

impl Off {
    /// Of a brick that is watched.
    #[must_use]
    pub const fn new(tap: TruthTap) -> Self {
        Self { tap, truth: VecDeque::new(), estimates: VecDeque::new() }
    }

    /// A line for people; `None` before anything is known.
    pub fn line(&mut self) -> Option<String> {
        self.follow();
        let newest = self.truth.back()?;
        let odometry_m = newest.odometry.origin().distance(newest.pose.origin()).0;
        let estimate = self
            .estimate_m()
            .map_or_else(|| "estimate not known".to_owned(), |off_m| format!("estimate {off_m:.3} m off"));
        Some(format!("odometry {odometry_m:.2} m off, {estimate}"))
    }

    /// Takes note of an estimate.
    pub fn note(&mut self, estimate: &Estimate) {
        if estimate.validity.position {
            if self.estimates.len() >= MOST_ESTIMATES {
                self.estimates.pop_front();
            }
            self.estimates.push_back(TimedPose { stamp: estimate.stamp, pose: estimate.pose });
        }
    }

    /// How far the last estimate whose instant the truth has reached was off then, in metres.
    fn estimate_m(&self) -> Option<f64> {
        let samples = self.truth.iter().map(|sample| TimedPose { stamp: sample.brick, pose: sample.pose });
        let really = Track::new(samples, LONGEST_GAP);
        self.estimates.iter().rev().find_map(|estimate| {
            let pose = really.at(estimate.stamp)?;
            Some(pose.origin().distance(estimate.pose.origin()).0)
        })
    }

    fn follow(&mut self) {
        self.truth.extend(self.tap.take().into_iter().map(|live| live.sample));
        let newest = self.truth.back().map(|sample| sample.world);
        while let (Some(newest), Some(oldest)) = (newest, self.truth.front())
            && newest - oldest.world > KEPT
        {
            self.truth.pop_front();
        }
    }
}

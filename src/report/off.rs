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
}

impl Off {
    /// Of a brick that is watched.
    #[must_use]
    pub const fn new(tap: TruthTap) -> Self {
        Self {
            tap,
            truth: VecDeque::new(),
        }
    }

    /// A line for people; `None` before anything is known.
    pub fn line(&mut self, estimate: Option<&Estimate>) -> Option<String> {
        self.follow();
        let newest = self.truth.back()?;
        let odometry_m = newest.odometry.origin().distance(newest.pose.origin()).0;
        let estimate_m = estimate
            .filter(|estimate| estimate.validity.position)
            .and_then(|estimate| self.distance_m(estimate));
        let estimate = estimate_m.map_or_else(
            || "estimate not known".to_owned(),
            |off_m| format!("estimate {off_m:.3} m off"),
        );
        Some(format!("odometry {odometry_m:.2} m off, {estimate}"))
    }

    /// How far an estimate was off at its own instant, in metres; `None` if the truth of that instant is not at hand.
    fn distance_m(&self, estimate: &Estimate) -> Option<f64> {
        let samples = self.truth.iter().map(|sample| TimedPose {
            stamp: sample.brick,
            pose: sample.pose,
        });
        let really = Track::new(samples, LONGEST_GAP).at(estimate.stamp)?;
        Some(really.origin().distance(estimate.pose.origin()).0)
    }

    fn follow(&mut self) {
        self.truth
            .extend(self.tap.take().into_iter().map(|live| live.sample));
        let newest = self.truth.back().map(|sample| sample.world);
        while let (Some(newest), Some(oldest)) = (newest, self.truth.front())
            && newest - oldest.world > KEPT
        {
            self.truth.pop_front();
        }
    }
}

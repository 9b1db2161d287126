//! The last samples of a simulated robot's truth, and its position between them.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, BrickClock, Meters, Point2, Pose, TimeDelta, Timestamp};

use crate::feed::SimulatedTruth;
use crate::model::Number;

/// Twelve seconds at 20 Hz, and no estimate is later.
const MAX_SAMPLES: usize = 256;
/// The true position is unknown between samples that are further apart.
const MAX_GAP: TimeDelta = TimeDelta::from_millis(1_000);

pub(super) struct TruthSamples {
    samples: VecDeque<SimulatedTruth>,
}

/// A sample against the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SampleOrder {
    Later,
    /// It was there already.
    Repeated,
    /// The brick's clock started again: the samples before were dropped.
    Restarted,
}

impl TruthSamples {
    pub(super) const fn new() -> Self {
        Self { samples: VecDeque::new() }
    }

    pub(super) fn push(&mut self, sample: &SimulatedTruth) -> SampleOrder {
        let last = self.latest();
        if last == Some(sample.time) {
            return SampleOrder::Repeated;
        }
        let is_restarted = last.is_some_and(|last| sample.time < last);
        if is_restarted {
            self.samples.clear();
        }
        if self.samples.len() >= MAX_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(*sample);
        if is_restarted { SampleOrder::Restarted } else { SampleOrder::Later }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    pub(super) fn latest(&self) -> Option<Timestamp<BrickClock>> {
        self.samples.back().map(|sample| sample.time)
    }

    /// True position and odometry error, interpolated linearly between samples.
    pub(super) fn at(&self, stamp: Timestamp<BrickClock>) -> Option<(Point2<Arena>, Number)> {
        let after = self.samples.partition_point(|sample| sample.time < stamp);
        let next = self.samples.get(after)?;
        let before = after.checked_sub(1);
        let Some(before) = before.and_then(|index| self.samples.get(index)) else {
            let off_m = odometry_error(next).unwrap_or(f64::NAN);
            return (next.time == stamp).then(|| (next.pose.origin(), off_m.into()));
        };
        let gap = next.time - before.time;
        if gap > MAX_GAP {
            return None;
        }
        let share = (stamp - before.time).as_secs_f64() / gap.as_secs_f64();
        let really = interpolate_position(before.pose, next.pose, share);
        let odometry = before.odometry.zip(next.odometry);
        let off_m = odometry.map_or(f64::NAN, |(from, to)| interpolate_position(from, to, share).distance(really).0);
        Some((really, off_m.into()))
    }
}

fn interpolate_position(from: Pose<Arena>, to: Pose<Arena>, share: f64) -> Point2<Arena> {
    let between = |from: Meters, to: Meters| Meters(from.0 + share * (to.0 - from.0));
    Point2::new(between(from.x, to.x), between(from.y, to.y))
}

pub(super) fn odometry_error(sample: &SimulatedTruth) -> Option<f64> {
    let odometry = sample.odometry?;
    Some(odometry.origin().distance(sample.pose.origin()).0)
}

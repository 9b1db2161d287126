//! Where the simulated robot really was, and how far off odometry and estimate are.

use std::collections::VecDeque;

use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Event, HostClock, Meters, Point2, Pose, Span, Stamp,
};

use super::trail::{Trail, Weight};
use super::{Pace, Setting, Told, View};
use crate::feed::TruthSample;
use crate::model::{ErrorsRow, Frame, Number, TruthPoint, seconds_of};

/// So many samples are kept to be compared with estimates: at 20 Hz twelve seconds, and no estimate is later.
const MOST_SAMPLES: usize = 256;
/// So many estimates wait for the sample behind their instant, which comes within 50 ms.
const MOST_WAITING: usize = 32;
/// Between samples that are further apart nobody knows where the robot was.
const LONGEST_GAP: Span = Span::from_millis(1_000);

/// The truth.
pub(super) struct Truth {
    trail: Trail<TruthPoint>,
    samples: VecDeque<TruthSample>,
    /// Estimates of instants behind the last sample.
    waiting: VecDeque<(Stamp<BrickClock>, Point2<Arena>)>,
    odometry_m: f64,
    estimate_m: f64,
}

impl Truth {
    pub(super) const fn new(setting: &Setting) -> Self {
        Self {
            trail: Trail::new(setting.keep),
            samples: VecDeque::new(),
            waiting: VecDeque::new(),
            odometry_m: f64::NAN,
            estimate_m: f64::NAN,
        }
    }

    fn take_sample(&mut self, sample: &TruthSample) {
        let is_restarted = self
            .samples
            .back()
            .is_some_and(|last| sample.stamp <= last.stamp);
        if is_restarted {
            self.samples.clear();
            self.waiting.clear();
        }
        if self.samples.len() >= MOST_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(*sample);
        if let Some(odometry) = sample.odometry {
            self.odometry_m = odometry.origin().distance(sample.pose.origin()).0;
        }
        let point = point_of(sample);
        self.trail.push(sample.now, point, Weight::Usual);
        while let Some(estimated) = self.waiting.front().copied()
            && estimated.0 <= sample.stamp
        {
            self.waiting.pop_front();
            self.compare(estimated);
        }
    }

    fn take_estimate(&mut self, estimate: &Estimate) {
        if !estimate.validity.position || self.samples.is_empty() {
            return;
        }
        let estimated = (estimate.stamp, estimate.pose.origin());
        let last = self.samples.back().map(|sample| sample.stamp);
        if last.is_some_and(|last| estimate.stamp <= last) {
            self.compare(estimated);
            return;
        }
        if self.waiting.len() >= MOST_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(estimated);
    }

    fn compare(&mut self, (stamp, place): (Stamp<BrickClock>, Point2<Arena>)) {
        if let Some(really) = self.at(stamp) {
            self.estimate_m = place.distance(really).0;
        }
    }

    /// Where the robot was at an instant, on the straight line between the samples around it.
    fn at(&self, stamp: Stamp<BrickClock>) -> Option<Point2<Arena>> {
        let after = self.samples.partition_point(|sample| sample.stamp < stamp);
        let (next, before) = (self.samples.get(after)?, after.checked_sub(1));
        let Some(before) = before.and_then(|index| self.samples.get(index)) else {
            return (next.stamp == stamp).then(|| next.pose.origin());
        };
        let gap = next.stamp - before.stamp;
        if gap > LONGEST_GAP {
            return None;
        }
        let share = (stamp - before.stamp).as_secs_f64() / gap.as_secs_f64();
        let between = |from: Meters, to: Meters| Meters(from.0 + share * (to.0 - from.0));
        Some(Point2::new(
            between(before.pose.x, next.pose.x),
            between(before.pose.y, next.pose.y),
        ))
    }

    fn errors(&self) -> Option<ErrorsRow> {
        let is_known = !self.samples.is_empty();
        is_known.then(|| ErrorsRow {
            odometry_m: self.odometry_m.into(),
            estimate_m: self.estimate_m.into(),
        })
    }
}

impl View for Truth {
    fn take(&mut self, _now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Truth(sample) => self.take_sample(sample),
            Told::Event(Event::Estimated { estimate, .. }) => self.take_estimate(estimate),
            Told::Event(_) | Told::Standing(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        frame.truth = self.trail.take_news();
        if !frame.truth.is_empty() {
            frame.errors = self.errors();
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.truth = self.trail.kept();
        history.errors = self.errors();
    }

    fn dropped(&self) -> u64 {
        self.trail.dropped()
    }
}

fn point_of(sample: &TruthSample) -> TruthPoint {
    let numbers = |pose: Pose<Arena>| [pose.x.0, pose.y.0, pose.heading.rad()].map(Number::from);
    let [x_m, y_m, heading_rad] = numbers(sample.pose);
    TruthPoint {
        t_s: seconds_of(sample.now),
        x_m,
        y_m,
        heading_rad,
        odometry: sample.odometry.map(numbers),
    }
}

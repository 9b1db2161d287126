//! Ground truth of simulated robots, and the errors of their odometry and estimates.
//!
//! A sample names its robot, except where the station has one simulated brick: then it is of the first robot.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, BrickClock, Event, HostClock, Point2, Pose, RobotId, TimeDelta, Timestamp};

use super::retained_series::{BoundedMap, MAX_ROBOTS, OlderPolicy, PointPriority, RetainedSeries};
use super::robots::estimate_point;
use super::truth_samples::{SampleOrder, TruthSamples, odometry_error};
use super::view::{FrameContent, RetentionPolicy, View, ViewConfig, ViewInput, robot_name};
use crate::feed::SimulatedTruth;
use crate::model::{ErrorsRow, Frame, Number, ScorePoint, TruthPoint, seconds_of};

/// Estimates that wait for the sample after their instant, which comes within 50 ms.
const MAX_WAITING_ESTIMATES: usize = 32;
/// Before the last minute of a live session.
const OLDER_SCORES: usize = 400;
/// Without a comparable estimate for this long, its error is unknown: the link or the robot is down.
const MAX_SILENCE: TimeDelta = TimeDelta::from_millis(1_000);

pub(super) struct Truth {
    policy: RetentionPolicy,
    /// Keyed by the robot in the samples.
    robots: BoundedMap<Option<RobotId>, RobotTruth>,
    /// The first robot with an estimate: samples without a robot belong to it.
    first: Option<RobotId>,
}

impl Truth {
    pub(super) const fn new(setting: &ViewConfig) -> Self {
        Self { policy: setting.retention, robots: BoundedMap::new(MAX_ROBOTS), first: None }
    }

    fn push_sample(&mut self, sample: &SimulatedTruth) {
        self.robots.get_or_insert(sample.robot, || RobotTruth::new(self.policy));
        if let Some(truth) = self.robot(sample.robot) {
            truth.push_sample(sample);
        }
    }

    fn robot(&mut self, key: Option<RobotId>) -> Option<&mut RobotTruth> {
        let robots = self.robots.entries.len();
        let policy = self.policy.shared_by(robots);
        let truth = self.robots.entries.get_mut(&key)?;
        truth.points.set_policy(policy);
        truth.scores.set_policy(policy);
        truth.scores.share_older(robots);
        Some(truth)
    }

    fn push_estimate(&mut self, now: Timestamp<HostClock>, robot: RobotId, estimated: PendingEstimate) {
        let is_first = *self.first.get_or_insert(robot) == robot;
        let is_named = self.robots.entries.contains_key(&Some(robot)) || !is_first;
        if let Some(truth) = self.robot(is_named.then_some(robot)) {
            truth.push_estimate(now, estimated);
        }
    }

    fn add_errors(&self, frame: &mut Frame, is_selected: impl Fn(&RobotTruth) -> bool) {
        for (robot, truth) in &self.robots.entries {
            let errors = truth.errors();
            if !is_selected(truth) || errors.is_none() {
                continue;
            }
            if let Some(robot) = robot.or(self.first) {
                frame.robot(&robot_name(robot)).errors.clone_from(&errors);
            }
            if Some(robot) == self.robots.entries.keys().next() {
                frame.errors = errors;
            }
        }
    }
}

struct RobotTruth {
    points: RetainedSeries<TruthPoint>,
    scores: RetainedSeries<ScorePoint>,
    samples: TruthSamples,
    /// Estimates of instants after the last sample.
    waiting: VecDeque<PendingEstimate>,
    odometry_m: f64,
    estimate_m: f64,
    last_compared: Option<Timestamp<HostClock>>,
    /// Dropped because too many waited.
    unscored: u64,
}

#[derive(Clone, Copy)]
struct PendingEstimate {
    received: Timestamp<HostClock>,
    /// The estimated instant.
    time: Timestamp<BrickClock>,
    position: Point2<Arena>,
    claim_m: Number,
}

impl RobotTruth {
    fn new(policy: RetentionPolicy) -> Self {
        let older = OlderPolicy {
            max_points: OLDER_SCORES,
            weight: |score: &ScorePoint| score.estimate_m.get().unwrap_or(f64::NAN),
        };
        Self {
            points: RetainedSeries::new(policy),
            scores: RetainedSeries::new(policy).with_older(Some(older)),
            samples: TruthSamples::new(),
            waiting: VecDeque::new(),
            odometry_m: f64::NAN,
            estimate_m: f64::NAN,
            last_compared: None,
            unscored: 0,
        }
    }

    fn push_sample(&mut self, sample: &SimulatedTruth) {
        match self.samples.push(sample) {
            SampleOrder::Repeated => return,
            SampleOrder::Restarted => self.waiting.clear(),
            SampleOrder::Later => {}
        }
        self.odometry_m = odometry_error(sample).unwrap_or(self.odometry_m);
        let point = point_of(sample);
        self.points.push(sample.now, point, PointPriority::Normal);
        while let Some(estimated) = self.waiting.front().copied()
            && estimated.time <= sample.time
        {
            self.waiting.pop_front();
            self.compare(sample.now, &estimated);
        }
        self.check_silence(sample.now);
    }

    /// While no estimate can be compared, the plot of the odometry error continues and that of the estimate has a gap.
    fn check_silence(&mut self, now: Timestamp<HostClock>) {
        if self.last_compared.is_none_or(|compared| now - compared <= MAX_SILENCE) {
            return;
        }
        self.estimate_m = f64::NAN;
        let score = ScorePoint { t_s: seconds_of(now), odometry_m: self.odometry_m.into(), ..ScorePoint::default() };
        self.scores.push(now, score, PointPriority::Normal);
    }

    fn push_estimate(&mut self, now: Timestamp<HostClock>, estimated: PendingEstimate) {
        let Some(last) = self.samples.latest() else {
            return;
        };
        if estimated.time <= last {
            self.compare(now, &estimated);
            return;
        }
        if self.waiting.len() >= MAX_WAITING_ESTIMATES {
            self.waiting.pop_front();
            self.unscored += 1;
        }
        self.waiting.push_back(estimated);
    }

    fn compare(&mut self, now: Timestamp<HostClock>, estimated: &PendingEstimate) {
        let Some((really, odometry_m)) = self.samples.at(estimated.time) else {
            return;
        };
        let estimate_m = estimated.position.distance(really).0;
        self.estimate_m = estimate_m;
        self.last_compared = Some(now);
        let score = ScorePoint {
            t_s: seconds_of(estimated.received),
            odometry_m,
            estimate_m: estimate_m.into(),
            claim_m: estimated.claim_m,
        };
        self.scores.push(estimated.received, score, PointPriority::Normal);
    }

    fn has_pending(&self) -> bool {
        self.points.has_pending() || self.scores.has_pending()
    }

    fn errors(&self) -> Option<ErrorsRow> {
        let is_known = !self.samples.is_empty();
        is_known.then(|| ErrorsRow { odometry_m: self.odometry_m.into(), estimate_m: self.estimate_m.into() })
    }
}

impl View for Truth {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        match input {
            ViewInput::Truth(sample) => self.push_sample(sample),
            ViewInput::Event(Event::EstimateUpdated { robot, estimate }) if estimate.validity.position => {
                let estimated = PendingEstimate {
                    received: now,
                    time: estimate.stamp,
                    position: estimate.pose.origin(),
                    claim_m: estimate_point(now, estimate).major_m,
                };
                self.push_estimate(now, *robot, estimated);
            }
            ViewInput::Event(_) | ViewInput::Status(_) => {}
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        self.add_errors(frame, RobotTruth::has_pending);
        for (robot, truth) in &mut self.robots.entries {
            frame.truth.extend(truth.points.take_pending());
            let scores = truth.scores.take_pending();
            if let (Some(robot), false) = (robot.or(self.first), scores.is_empty()) {
                frame.robot(&robot_name(robot)).scores = scores;
            }
        }
    }

    fn add_history(&self, history: &mut Frame) {
        self.add_errors(history, |_| true);
        for (robot, truth) in &self.robots.entries {
            history.truth.extend(truth.points.retained());
            let scores = truth.scores.retained();
            if let (Some(robot), false) = (robot.or(self.first), scores.is_empty()) {
                history.robot(&robot_name(robot)).scores = scores;
            }
        }
    }

    fn dropped(&self) -> u64 {
        let robots = self.robots.entries.values();
        let each = robots.map(|truth| truth.points.dropped() + truth.scores.dropped() + truth.unscored);
        each.sum::<u64>() + self.robots.ignored
    }
}

fn point_of(sample: &SimulatedTruth) -> TruthPoint {
    let numbers = |pose: Pose<Arena>| [pose.x.0, pose.y.0, pose.heading.rad()].map(Number::from);
    let [x_m, y_m, heading_rad] = numbers(sample.pose);
    TruthPoint {
        robot: sample.robot.map(robot_name),
        t_s: seconds_of(sample.now),
        robot_s: sample.time.as_secs_f64(),
        x_m,
        y_m,
        heading_rad,
        odometry: sample.odometry.map(numbers),
    }
}

#[cfg(test)]
mod tests;

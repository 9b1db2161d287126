//! Where the simulated robot really was, and how far off odometry and estimate are.

use std::collections::VecDeque;

use posebridge_telemetry::{Arena, BrickClock, Event, HostClock, Meters, Point2, Pose, RobotId, Span, Stamp};

use super::estimates;
use super::trail::{MOST_ROBOTS, Trail, Trails, Weight};
use super::{Pace, Setting, Told, View, robot_name};
use crate::feed::TruthSample;
use crate::model::{ErrorsRow, Frame, Number, ScorePoint, TruthPoint, seconds_of};

/// So many samples are kept to be compared with estimates: at 20 Hz twelve seconds, and no estimate is later.
const MOST_SAMPLES: usize = 256;
/// So many estimates wait for the sample behind their instant, which comes within 50 ms.
const MOST_WAITING: usize = 32;
/// Between samples that are further apart nobody knows where the robot was.
const LONGEST_GAP: Span = Span::from_millis(1_000);
/// After so long without an estimate that could be compared nobody knows how far off it is: the link is out, or the robot.
const LONGEST_SILENCE: Span = Span::from_millis(1_000);

/// The truth, and how far estimates and odometry are from it.
pub(super) struct Truth {
    trail: Trail<TruthPoint>,
    scores: Trails<(), ScorePoint>,
    samples: VecDeque<TruthSample>,
    /// Estimates of instants behind the last sample.
    waiting: VecDeque<Estimated>,
    odometry_m: f64,
    estimate_m: f64,
    /// When which robot's estimate was compared last.
    compared: Option<(Stamp<HostClock>, RobotId)>,
    /// Estimates that found no room to wait.
    unscored: u64,
}

/// An estimate that is to be compared.
#[derive(Clone, Copy)]
struct Estimated {
    robot: RobotId,
    /// When it was made.
    made: Stamp<HostClock>,
    /// For which instant.
    stamp: Stamp<BrickClock>,
    place: Point2<Arena>,
    claim_m: Number,
}

impl Truth {
    pub(super) fn new(setting: &Setting) -> Self {
        Self {
            trail: Trail::new(setting.keep),
            scores: Trails::new(setting.keep, MOST_ROBOTS),
            samples: VecDeque::new(),
            waiting: VecDeque::new(),
            odometry_m: f64::NAN,
            estimate_m: f64::NAN,
            compared: None,
            unscored: 0,
        }
    }

    fn take_sample(&mut self, sample: &TruthSample) {
        let last = self.samples.back().map(|last| last.stamp);
        if last == Some(sample.stamp) {
            return;
        }
        let is_restarted = last.is_some_and(|last| sample.stamp < last);
        if is_restarted {
            self.samples.clear();
            self.waiting.clear();
        }
        if self.samples.len() >= MOST_SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(*sample);
        self.odometry_m = odometry_off(sample).unwrap_or(self.odometry_m);
        let point = point_of(sample);
        self.trail.push(sample.now, point, Weight::Usual);
        while let Some(estimated) = self.waiting.front().copied()
            && estimated.stamp <= sample.stamp
        {
            self.waiting.pop_front();
            self.compare(sample.now, &estimated);
        }
        self.note_silence(sample.now);
    }

    /// While no estimate can be compared the line of the odometry goes on, and that of the estimate has a gap.
    fn note_silence(&mut self, now: Stamp<HostClock>) {
        let Some((compared, robot)) = self.compared else {
            return;
        };
        if now - compared <= LONGEST_SILENCE {
            return;
        }
        self.estimate_m = f64::NAN;
        let score = ScorePoint { t_s: seconds_of(now), odometry_m: self.odometry_m.into(), ..ScorePoint::default() };
        self.scores.push(now, (robot, ()), (score, Weight::Usual));
    }

    fn take_estimate(&mut self, now: Stamp<HostClock>, estimated: Estimated) {
        let Some(last) = self.samples.back().map(|sample| sample.stamp) else {
            return;
        };
        if estimated.stamp <= last {
            self.compare(now, &estimated);
            return;
        }
        if self.waiting.len() >= MOST_WAITING {
            self.waiting.pop_front();
            self.unscored += 1;
        }
        self.waiting.push_back(estimated);
    }

    fn compare(&mut self, now: Stamp<HostClock>, estimated: &Estimated) {
        let Some((really, odometry_m)) = self.at(estimated.stamp) else {
            return;
        };
        let estimate_m = estimated.place.distance(really).0;
        self.estimate_m = estimate_m;
        self.compared = Some((now, estimated.robot));
        let score = ScorePoint {
            t_s: seconds_of(estimated.made),
            odometry_m,
            estimate_m: estimate_m.into(),
            claim_m: estimated.claim_m,
        };
        let key = (estimated.robot, ());
        self.scores.push(estimated.made, key, (score, Weight::Usual));
    }

    /// Where the robot was at an instant and how far off its odometry, on the straight line between the samples around it.
    fn at(&self, stamp: Stamp<BrickClock>) -> Option<(Point2<Arena>, Number)> {
        let after = self.samples.partition_point(|sample| sample.stamp < stamp);
        let next = self.samples.get(after)?;
        let before = after.checked_sub(1);
        let Some(before) = before.and_then(|index| self.samples.get(index)) else {
            let off_m = odometry_off(next).unwrap_or(f64::NAN);
            return (next.stamp == stamp).then(|| (next.pose.origin(), off_m.into()));
        };
        let gap = next.stamp - before.stamp;
        if gap > LONGEST_GAP {
            return None;
        }
        let share = (stamp - before.stamp).as_secs_f64() / gap.as_secs_f64();
        let really = between(before.pose, next.pose, share);
        let odometry = before.odometry.zip(next.odometry);
        let off_m = odometry.map_or(f64::NAN, |(from, to)| between(from, to, share).distance(really).0);
        Some((really, off_m.into()))
    }

    fn errors(&self) -> Option<ErrorsRow> {
        let is_known = !self.samples.is_empty();
        is_known.then(|| ErrorsRow { odometry_m: self.odometry_m.into(), estimate_m: self.estimate_m.into() })
    }
}

fn between(from: Pose<Arena>, to: Pose<Arena>, share: f64) -> Point2<Arena> {
    let between = |from: Meters, to: Meters| Meters(from.0 + share * (to.0 - from.0));
    Point2::new(between(from.x, to.x), between(from.y, to.y))
}

fn odometry_off(sample: &TruthSample) -> Option<f64> {
    let odometry = sample.odometry?;
    Some(odometry.origin().distance(sample.pose.origin()).0)
}

impl View for Truth {
    fn take(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        match told {
            Told::Truth(sample) => self.take_sample(sample),
            Told::Event(Event::Estimated { robot, estimate }) if estimate.validity.position => {
                let estimated = Estimated {
                    robot: *robot,
                    made: now,
                    stamp: estimate.stamp,
                    place: estimate.pose.origin(),
                    claim_m: estimates::point_of(now, estimate).major_m,
                };
                self.take_estimate(now, estimated);
            }
            Told::Event(_) | Told::Standing(_) => {}
        }
    }

    fn add_news(&mut self, frame: &mut Frame, _pace: Pace) {
        frame.truth = self.trail.take_news();
        let scores = self.scores.take_news();
        if !frame.truth.is_empty() || !scores.is_empty() {
            frame.errors = self.errors();
        }
        for (robot, scores) in scores {
            frame.robot(&robot_name(robot)).scores = scores;
        }
    }

    fn add_history(&self, history: &mut Frame) {
        history.truth = self.trail.kept();
        history.errors = self.errors();
        for (robot, scores) in self.scores.kept() {
            history.robot(&robot_name(robot)).scores = scores;
        }
    }

    fn dropped(&self) -> u64 {
        self.trail.dropped() + self.scores.dropped() + self.unscored
    }
}

fn point_of(sample: &TruthSample) -> TruthPoint {
    let numbers = |pose: Pose<Arena>| [pose.x.0, pose.y.0, pose.heading.rad()].map(Number::from);
    let [x_m, y_m, heading_rad] = numbers(sample.pose);
    TruthPoint { t_s: seconds_of(sample.now), x_m, y_m, heading_rad, odometry: sample.odometry.map(numbers) }
}

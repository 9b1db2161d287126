//! An estimator against what it was not told: truth, or fixes that were withheld.
//!
//! The estimate for an instant is taken as soon as the motion up to that instant has been observed, with the fixes that had come
//! by then: the filter's own history interpolates the motion inside an encoder interval.

use posebridge_analysis::PoseError;
use posebridge_pipeline::Pipeline;
use posebridge_recording::dataset::{Run, TruthPose, Withheld};
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Heading, Meters, Observed, Point2, Pose, Stamp, Transform2,
};

/// What an estimator is held against at one instant.
#[derive(Clone, Copy, Debug)]
struct Yardstick {
    stamp: Stamp<BrickClock>,
    position: Point2<Arena>,
    heading: Option<Heading>,
    /// Where on the robot that point is.
    body_from_point: Transform2<posebridge_telemetry::Body, posebridge_telemetry::Tag>,
    is_truth: bool,
}

/// Scores one estimator over one run.
pub struct Scorer {
    yardsticks: std::vec::IntoIter<Yardstick>,
    next: Option<Yardstick>,
    /// The motion is known up to here.
    moved_to: Option<Stamp<BrickClock>>,
    /// Errors so far.
    pub errors: Vec<PoseError>,
}

impl Scorer {
    /// Truth where there is some, else the withheld fixes.
    #[must_use]
    pub fn new(run: &Run) -> Self {
        let mut yardsticks: Vec<Yardstick> = if run.truth.is_empty() {
            run.withheld.iter().map(of_withheld).collect()
        } else {
            run.truth.iter().map(of_truth).collect()
        };
        yardsticks.sort_by_key(|yardstick| yardstick.stamp);
        let mut yardsticks = yardsticks.into_iter();
        let next = yardsticks.next();
        Self {
            yardsticks,
            next,
            moved_to: None,
            errors: Vec::new(),
        }
    }

    /// After an observation was handled.
    pub fn observed(&mut self, observed: &Observed, stamp: Stamp<BrickClock>, pipeline: &Pipeline) {
        let is_motion = matches!(
            observed,
            Observed::WheelAngles { .. }
                | Observed::OdometerPose(_)
                | Observed::BodyVelocity { .. }
        );
        if is_motion {
            self.moved_to = self.moved_to.max(Some(stamp));
            self.score_until(stamp, pipeline);
        }
    }

    /// At the end: what lies behind the last motion, as far as anything was observed.
    pub fn finish(&mut self, pipeline: &Pipeline) {
        if let Some(latest) = pipeline.latest() {
            self.score_until(latest, pipeline);
        }
    }

    fn score_until(&mut self, until: Stamp<BrickClock>, pipeline: &Pipeline) {
        while let Some(yardstick) = self.next.filter(|next| next.stamp <= until) {
            if let Some(estimate) = pipeline.estimate_at(yardstick.stamp) {
                self.errors.extend(error(&estimate, &yardstick));
            }
            self.next = self.yardsticks.next();
        }
    }
}

fn of_truth(truth: &TruthPose) -> Yardstick {
    Yardstick {
        stamp: truth.stamp,
        position: truth.position,
        heading: truth.heading,
        body_from_point: Transform2::default(),
        is_truth: true,
    }
}

fn of_withheld(withheld: &Withheld) -> Yardstick {
    let tag = withheld.fix.tag_in_body;
    Yardstick {
        stamp: withheld.stamp,
        position: withheld.fix.position,
        heading: withheld.fix.heading,
        body_from_point: Transform2::new(tag.x, tag.y, Heading::default()),
        is_truth: false,
    }
}

/// The error of the observed point, and of the heading where the yardstick has one. Only real truth can judge a covariance: a
/// withheld fix has an error of its own.
fn error(estimate: &Estimate, yardstick: &Yardstick) -> Option<PoseError> {
    if !estimate.validity.position {
        return None;
    }
    let seen = (estimate.pose * yardstick.body_from_point).origin();
    let heading = yardstick.heading.unwrap_or_default();
    let truth = Pose::<Arena>::new(yardstick.position.x, yardstick.position.y, heading);
    let of_point = Estimate {
        pose: Pose::new(seen.x, seen.y, estimate.pose.heading),
        ..*estimate
    };
    let mut error = PoseError::of_estimate(&of_point, truth);
    if yardstick.heading.is_none() {
        error.heading_rad = None;
    }
    if !yardstick.is_truth || yardstick.heading.is_none() {
        error.covariance = None;
    }
    Some(error)
}

/// A point of the arena as the figures want it.
#[must_use]
pub fn pose_at(position: Point2<Arena>, heading: Option<Heading>) -> Pose<Arena> {
    Pose::new(
        Meters(position.x.0),
        Meters(position.y.0),
        heading.unwrap_or_default(),
    )
}

//! An estimator against what it was not told: truth, or fixes that were withheld.
//!
//! The estimate for an instant is taken as soon as the motion up to that instant has been observed, with the fixes that had come
//! by then: the filter's own history interpolates the motion inside an encoder interval.
//!
//! A camera that stamps its fixes late stamps the withheld ones late, too. An estimator that learns the delay is scored at the
//! stamp less the delay that it believes in at that moment; what it would have got at the stamp itself is kept beside it.

use posebridge_analysis::PoseError;
use posebridge_pipeline::Pipeline;
use posebridge_recording::dataset::{Run, TruthPose, Withheld};
use posebridge_telemetry::{
    Arena, Body, BrickClock, Calibration, Estimate, Heading, Meters, Observed, Point2, Pose, Span, Stamp, Tag,
    Transform2,
};

/// What an estimator is held against at one instant.
#[derive(Clone, Copy, Debug)]
struct Yardstick {
    stamp: Stamp<BrickClock>,
    position: Point2<Arena>,
    heading: Option<Heading>,
    /// Where on the robot that point is.
    body_from_point: Transform2<Body, Tag>,
    is_truth: bool,
}

/// What is scored.
pub trait Belief {
    /// The belief for an instant.
    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate>;
    /// What it has learned so far.
    fn calibration(&self) -> Option<Calibration>;
    /// The latest instant that was observed.
    fn latest(&self) -> Option<Stamp<BrickClock>>;
}

impl Belief for Pipeline {
    fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        self.estimate_at(stamp)
    }
    fn calibration(&self) -> Option<Calibration> {
        self.calibration()
    }
    fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.latest()
    }
}

/// Scores one estimator over one run.
pub struct Scorer {
    yardsticks: std::vec::IntoIter<Yardstick>,
    next: Option<Yardstick>,
    /// Withheld fixes come late by what the estimator learns.
    delay: Delay,
    /// Errors so far.
    pub errors: Vec<PoseError>,
    /// Errors at the fixes' own stamps; empty unless the others are corrected for a delay.
    pub uncorrected: Vec<PoseError>,
    /// What the errors are between, in their order.
    pub pairs: Vec<Pair>,
}

/// What was believed of one instant, and what it is held against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The instant of the yardstick.
    pub stamp: Stamp<BrickClock>,
    /// The truth, or the withheld fix; heading 0 where it has none.
    pub expected: Pose<Arena>,
    /// The same point of the robot as it was believed.
    pub believed: Pose<Arena>,
}

/// Whether the stamps of the withheld fixes are taken as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Delay {
    /// As they are.
    None,
    /// Less what the estimator has learned.
    Learned,
}

impl Scorer {
    /// Truth where there is some, else the withheld fixes; `prior` is what the estimator knew of systematic errors before the run.
    #[must_use]
    pub fn new(run: &Run, prior: &Calibration) -> Self {
        let has_truth = !run.truth.is_empty();
        let mut yardsticks: Vec<Yardstick> = if has_truth {
            run.truth.iter().map(of_truth).collect()
        } else {
            run.withheld.iter().map(of_withheld).collect()
        };
        yardsticks.sort_by_key(|yardstick| yardstick.stamp);
        let mut yardsticks = yardsticks.into_iter();
        let next = yardsticks.next();
        let is_learned = !has_truth && prior.fix_delay_s.sigma > 0.0;
        Self {
            yardsticks,
            next,
            delay: if is_learned { Delay::Learned } else { Delay::None },
            errors: Vec::new(),
            uncorrected: Vec::new(),
            pairs: Vec::new(),
        }
    }

    /// After an observation was handled.
    pub fn observed(&mut self, observed: &Observed, stamp: Stamp<BrickClock>, belief: &impl Belief) {
        let is_motion = matches!(
            observed,
            Observed::WheelAngles { .. } | Observed::OdometerPose(_) | Observed::BodyVelocity { .. }
        );
        if is_motion {
            self.score_until(stamp, belief);
        }
    }

    /// Leaves out what was scored so far.
    pub fn forget(&mut self) {
        self.errors.clear();
        self.uncorrected.clear();
        self.pairs.clear();
    }

    /// At the end: what lies behind the last motion, as far as anything was observed.
    pub fn finish(&mut self, belief: &impl Belief) {
        if let Some(latest) = belief.latest() {
            self.score_until(latest, belief);
        }
    }

    /// Scores what has been observed: a delay that is believed to be negative must not ask for what lies ahead.
    fn score_until(&mut self, until: Stamp<BrickClock>, belief: &impl Belief) {
        let delay = self.learned_delay(belief);
        let true_at = |yardstick: &Yardstick| yardstick.stamp - delay.unwrap_or(Span::ZERO);
        while let Some(yardstick) = self.next.filter(|next| next.stamp.max(true_at(next)) <= until) {
            let scored_at = |stamp| {
                let estimate = belief.estimate_at(stamp)?;
                error(&estimate, &yardstick)
            };
            if let Some((error, pair)) = scored_at(true_at(&yardstick)) {
                self.errors.push(error);
                self.pairs.push(pair);
            }
            if delay.is_some() {
                let uncorrected = scored_at(yardstick.stamp);
                self.uncorrected.extend(uncorrected.map(|(error, _)| error));
            }
            self.next = self.yardsticks.next();
        }
    }

    fn learned_delay(&self, belief: &impl Belief) -> Option<Span> {
        match self.delay {
            Delay::None => None,
            Delay::Learned => {
                let learned = belief.calibration()?.fix_delay_s.value;
                Some(Span::from_secs_f64(learned))
            }
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
fn error(estimate: &Estimate, yardstick: &Yardstick) -> Option<(PoseError, Pair)> {
    if !estimate.validity.position {
        return None;
    }
    let seen = (estimate.pose * yardstick.body_from_point).origin();
    let heading = yardstick.heading.unwrap_or_default();
    let truth = Pose::<Arena>::new(yardstick.position.x, yardstick.position.y, heading);
    let of_point = Estimate { pose: Pose::new(seen.x, seen.y, estimate.pose.heading), ..*estimate };
    let mut error = PoseError::of_estimate(&of_point, truth);
    if yardstick.heading.is_none() {
        error.heading_rad = None;
    }
    if !yardstick.is_truth || yardstick.heading.is_none() {
        error.covariance = None;
    }
    let pair = Pair { stamp: yardstick.stamp, expected: truth, believed: of_point.pose };
    Some((error, pair))
}

/// A point of the arena as the figures want it.
#[must_use]
pub fn pose_at(position: Point2<Arena>, heading: Option<Heading>) -> Pose<Arena> {
    Pose::new(Meters(position.x.0), Meters(position.y.0), heading.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use posebridge_analysis::TimedPose;
    use posebridge_telemetry::{Fix, Known, Odom};

    use super::*;

    /// Drives along x at 1 m/s and knows it, but believes that the camera is late by so much.
    struct Driver {
        delay: Span,
        /// The latest instant that it was asked for.
        asked: Cell<Stamp<BrickClock>>,
        latest: Stamp<BrickClock>,
    }

    impl Belief for Driver {
        fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
            self.asked.set(self.asked.get().max(stamp));
            let pose = Pose::new(Meters(stamp.as_secs_f64()), Meters(0.0), Heading::default());
            Some(TimedPose { stamp, pose }.believed([[0.0; 5]; 5]))
        }
        fn calibration(&self) -> Option<Calibration> {
            Some(Calibration {
                fix_delay_s: Known { value: self.delay.as_secs_f64(), sigma: 0.01 },
                ..Calibration::default()
            })
        }
        fn latest(&self) -> Option<Stamp<BrickClock>> {
            Some(self.latest)
        }
    }

    /// Ten fixes of a camera whose stamps are late by so much: one each second.
    fn run(late_s: f64) -> Run {
        let withheld = (1..=10).map(|second| Withheld {
            stamp: Stamp::from_secs_f64(f64::from(second)),
            fix: Fix {
                position: Point2::new(Meters(f64::from(second) - late_s), Meters(0.0)),
                heading: None,
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            },
        });
        Run { withheld: withheld.collect(), ..Run::default() }
    }

    fn prior(sigma: f64) -> Calibration {
        Calibration { fix_delay_s: Known { value: 0.0, sigma }, ..Calibration::default() }
    }

    fn drive(scorer: &mut Scorer, driver: &mut Driver, until_s: f64) {
        driver.latest = Stamp::from_secs_f64(until_s);
        let motion = Observed::OdometerPose(Pose::<Odom>::default());
        scorer.observed(&motion, driver.latest, driver);
    }

    fn driver(delay_s: f64) -> Driver {
        Driver { delay: Span::from_secs_f64(delay_s), asked: Cell::new(Stamp::ZERO), latest: Stamp::ZERO }
    }

    fn rms(errors: &[PoseError]) -> f64 {
        posebridge_analysis::metrics::summarise(errors).position_rms_m.unwrap()
    }

    #[test]
    fn a_late_camera_is_forgiven_who_has_learned_its_delay_and_the_plain_error_is_kept() {
        let (mut scorer, mut driver) = (Scorer::new(&run(0.2), &prior(0.15)), driver(0.2));
        drive(&mut scorer, &mut driver, 12.0);
        assert_eq!((scorer.errors.len(), scorer.uncorrected.len()), (10, 10));
        assert!(rms(&scorer.errors) < 1e-9);
        assert!((rms(&scorer.uncorrected) - 0.2).abs() < 1e-9);
    }

    #[test]
    fn without_a_prior_that_lets_it_learn_nothing_is_corrected() {
        let (mut scorer, mut driver) = (Scorer::new(&run(0.2), &prior(0.0)), driver(0.2));
        drive(&mut scorer, &mut driver, 12.0);
        assert!((rms(&scorer.errors) - 0.2).abs() < 1e-9);
        assert!(scorer.uncorrected.is_empty());
    }

    #[test]
    fn truth_is_never_late() {
        let mut run = run(0.2);
        run.truth = vec![TruthPose {
            stamp: Stamp::from_secs_f64(1.0),
            position: Point2::new(Meters(1.0), Meters(0.0)),
            heading: None,
        }];
        let (mut scorer, mut driver) = (Scorer::new(&run, &prior(0.15)), driver(0.2));
        drive(&mut scorer, &mut driver, 12.0);
        assert_eq!((scorer.errors.len(), scorer.uncorrected.len()), (1, 0));
        assert!(rms(&scorer.errors) < 1e-9);
    }

    #[test]
    fn a_delay_that_is_believed_to_be_negative_asks_for_nothing_that_lies_ahead() {
        let (mut scorer, mut driver) = (Scorer::new(&run(-0.5), &prior(0.15)), driver(-0.5));
        drive(&mut scorer, &mut driver, 3.2);
        assert_eq!(scorer.errors.len(), 2, "the third is true at 3.5 s");
        assert!(driver.asked.get() <= driver.latest);
        drive(&mut scorer, &mut driver, 10.1);
        scorer.finish(&driver);
        assert_eq!(scorer.errors.len(), 9);
        assert!(driver.asked.get() <= driver.latest);
        assert!(rms(&scorer.errors) < 1e-9);
    }
}

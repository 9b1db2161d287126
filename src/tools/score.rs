//! Scores an estimator against data that it did not get: ground truth, or withheld fixes. The estimate for an instant is taken as soon
//! as the motion until then has been observed. A camera with a timestamp delay also delays the withheld fixes: an estimator of the
//! delay is scored at the timestamp minus its present estimate of the delay; the score at the timestamp itself is kept as well.

use posebridge_recording::dataset::{DatasetRun, TruthPose, WithheldFix};
use posebridge_report::PoseError;
use posebridge_station::Station;
use posebridge_telemetry::{
    Arena, Body, BrickClock, Calibration, Estimate, Heading, Meters, ObservationKind, Point2, Pose, Tag, TimeDelta,
    Timestamp, Transform2,
};

#[derive(Clone, Copy, Debug)]
struct ErrorReference {
    time: Timestamp<BrickClock>,
    position: Point2<Arena>,
    heading: Option<Heading>,
    body_from_point: Transform2<Body, Tag>,
    is_truth: bool,
}

pub trait EstimateSource {
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate>;
    /// The present calibration; `None` if it is not adaptive.
    fn calibration(&self) -> Option<Calibration>;
    /// The latest observed instant.
    fn latest(&self) -> Option<Timestamp<BrickClock>>;
}

impl EstimateSource for Station {
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.first_robot().estimate_at(stamp)
    }
    fn calibration(&self) -> Option<Calibration> {
        self.first_robot().calibration()
    }
    fn latest(&self) -> Option<Timestamp<BrickClock>> {
        self.first_robot().latest_time()
    }
}

pub struct Scorer {
    references: std::vec::IntoIter<ErrorReference>,
    next: Option<ErrorReference>,
    /// Whether the timestamps of withheld fixes are corrected by the estimated delay.
    is_delay_learned: bool,
    pub errors: Vec<PoseError>,
    /// Errors at the fixes' own timestamps; empty unless the others are corrected for a delay.
    pub uncorrected: Vec<PoseError>,
    /// The compared poses, in the order of the errors.
    pub pairs: Vec<PosePair>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePair {
    pub time: Timestamp<BrickClock>,
    /// Truth or withheld fix; heading 0 if it has none.
    pub expected: Pose<Arena>,
    /// The same point of the robot by the estimate.
    pub estimated: Pose<Arena>,
}

impl Scorer {
    /// Uses truth if available, else the withheld fixes; `prior` is the estimator's calibration before the run.
    pub fn new(run: &DatasetRun, prior: &Calibration) -> Self {
        let has_truth = !run.truth.is_empty();
        let mut all_references: Vec<ErrorReference> = if has_truth {
            run.truth.iter().map(reference_from_truth).collect()
        } else {
            run.withheld.iter().map(reference_from_withheld).collect()
        };
        all_references.sort_by_key(|reference| reference.time);
        let mut references = all_references.into_iter();
        let next = references.next();
        Self {
            references,
            next,
            is_delay_learned: !has_truth && prior.fix_delay_s.sigma > 0.0,
            errors: Vec::new(),
            uncorrected: Vec::new(),
            pairs: Vec::new(),
        }
    }

    pub fn on_observation(
        &mut self,
        observed: &ObservationKind,
        stamp: Timestamp<BrickClock>,
        estimates: &impl EstimateSource,
    ) {
        let is_motion = matches!(
            observed,
            ObservationKind::WheelAngles { .. }
                | ObservationKind::OdometerPose(_)
                | ObservationKind::BodyVelocity { .. }
        );
        if is_motion {
            self.score_until(stamp, estimates);
        }
    }

    pub fn reset(&mut self) {
        self.errors.clear();
        self.uncorrected.clear();
        self.pairs.clear();
    }

    /// At the end: scores references after the last motion, up to the last observation.
    pub fn finish(&mut self, estimates: &impl EstimateSource) {
        if let Some(latest) = estimates.latest() {
            self.score_until(latest, estimates);
        }
    }

    /// Scores observed references: a negative estimate of the delay must not require future data.
    fn score_until(&mut self, until: Timestamp<BrickClock>, estimates: &impl EstimateSource) {
        let delay = self.learned_delay(estimates);
        let true_at = |reference: &ErrorReference| reference.time - delay.unwrap_or(TimeDelta::ZERO);
        while let Some(reference) = self.next.filter(|next| next.time.max(true_at(next)) <= until) {
            let scored_at = |stamp| {
                let estimate = estimates.estimate_at(stamp)?;
                error(&estimate, &reference)
            };
            if let Some((error, pair)) = scored_at(true_at(&reference)) {
                self.errors.push(error);
                self.pairs.push(pair);
            }
            if delay.is_some() {
                let uncorrected = scored_at(reference.time);
                self.uncorrected.extend(uncorrected.map(|(error, _)| error));
            }
            self.next = self.references.next();
        }
    }

    fn learned_delay(&self, estimates: &impl EstimateSource) -> Option<TimeDelta> {
        let learned = self.is_delay_learned.then(|| estimates.calibration()).flatten()?;
        Some(TimeDelta::from_secs_f64(learned.fix_delay_s.value))
    }
}

fn reference_from_truth(truth: &TruthPose) -> ErrorReference {
    ErrorReference {
        time: truth.time,
        position: truth.position,
        heading: truth.heading,
        body_from_point: Transform2::default(),
        is_truth: true,
    }
}

fn reference_from_withheld(withheld: &WithheldFix) -> ErrorReference {
    let tag = withheld.fix.tag_in_body;
    ErrorReference {
        time: withheld.time,
        position: withheld.fix.position,
        heading: withheld.fix.heading,
        body_from_point: Transform2::new(tag.x, tag.y, Heading::default()),
        is_truth: false,
    }
}

/// The error of the observed point, and of the heading if the reference has one. A covariance can only be tested against truth: a
/// withheld fix has an error of its own.
fn error(estimate: &Estimate, reference: &ErrorReference) -> Option<(PoseError, PosePair)> {
    if !estimate.validity.position {
        return None;
    }
    let observed_point = (estimate.pose * reference.body_from_point).origin();
    let heading = reference.heading.unwrap_or_default();
    let truth = Pose::<Arena>::new(reference.position.x, reference.position.y, heading);
    let of_point = Estimate { pose: Pose::new(observed_point.x, observed_point.y, estimate.pose.heading), ..*estimate };
    let mut error = PoseError::of_estimate(&of_point, truth);
    if reference.heading.is_none() {
        error.heading_rad = None;
    }
    if !reference.is_truth || reference.heading.is_none() {
        error.covariance = None;
    }
    let pair = PosePair { time: reference.time, expected: truth, estimated: of_point.pose };
    Some((error, pair))
}

/// A position as a pose; heading 0 if there is none.
pub fn pose_at(position: Point2<Arena>, heading: Option<Heading>) -> Pose<Arena> {
    Pose::new(Meters(position.x.0), Meters(position.y.0), heading.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use posebridge_report::TimedPose;
    use posebridge_telemetry::{Fix, Odom, UncertainValue};

    use super::*;

    /// Drives along x at 1 m/s and knows it, but estimates this delay of the camera.
    struct Driver {
        delay: TimeDelta,
        /// The latest instant that it was asked for.
        latest_request: Cell<Timestamp<BrickClock>>,
        latest: Timestamp<BrickClock>,
    }

    impl EstimateSource for Driver {
        fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
            self.latest_request.set(self.latest_request.get().max(stamp));
            let pose = Pose::new(Meters(stamp.as_secs_f64()), Meters(0.0), Heading::default());
            Some(TimedPose { time: stamp, pose }.with_covariance([[0.0; 5]; 5]))
        }
        fn calibration(&self) -> Option<Calibration> {
            Some(Calibration {
                fix_delay_s: UncertainValue { value: self.delay.as_secs_f64(), sigma: 0.01 },
                ..Calibration::default()
            })
        }
        fn latest(&self) -> Option<Timestamp<BrickClock>> {
            Some(self.latest)
        }
    }

    /// Ten fixes of a camera whose stamps are late by so much: one each second.
    fn run(late_s: f64) -> DatasetRun {
        let withheld = (1..=10).map(|second| WithheldFix {
            time: Timestamp::from_secs_f64(f64::from(second)),
            fix: Fix {
                position: Point2::new(Meters(f64::from(second) - late_s), Meters(0.0)),
                heading: None,
                covariance: None,
                tag_in_body: Point2::ORIGIN,
                reset_counter: 0,
            },
        });
        DatasetRun { withheld: withheld.collect(), ..DatasetRun::default() }
    }

    fn prior(sigma: f64) -> Calibration {
        Calibration { fix_delay_s: UncertainValue { value: 0.0, sigma }, ..Calibration::default() }
    }

    fn drive(scorer: &mut Scorer, driver: &mut Driver, until_s: f64) {
        driver.latest = Timestamp::from_secs_f64(until_s);
        let motion = ObservationKind::OdometerPose(Pose::<Odom>::default());
        scorer.on_observation(&motion, driver.latest, driver);
    }

    fn driver(delay_s: f64) -> Driver {
        Driver {
            delay: TimeDelta::from_secs_f64(delay_s),
            latest_request: Cell::new(Timestamp::ZERO),
            latest: Timestamp::ZERO,
        }
    }

    fn rms(errors: &[PoseError]) -> f64 {
        posebridge_report::metrics::summarise(errors).position_rms_m.unwrap()
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
            time: Timestamp::from_secs_f64(1.0),
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
        assert!(driver.latest_request.get() <= driver.latest);
        drive(&mut scorer, &mut driver, 10.1);
        scorer.finish(&driver);
        assert_eq!(scorer.errors.len(), 9);
        assert!(driver.latest_request.get() <= driver.latest);
        assert!(rms(&scorer.errors) < 1e-9);
    }
}

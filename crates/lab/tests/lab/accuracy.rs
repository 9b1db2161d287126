//! The scoring of drives with known truth: a toy estimator with a known error gives the known figures.

use posebridge_estimator::{Filter, RestoreError};
use posebridge_lab::accuracy::{FilterScore, ObservationArrival, ReferenceDrive, score};
use posebridge_report::{Consistency, TimedPose};
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, FusionOutcome, FusionRecord, Heading, Meters, Observation, ObservationKind, Pose,
    StartPose, Timestamp,
};

use crate::support::{fix, wheels};

/// Believes to be at a fixed pose, with a fixed covariance, from the first observation on.
struct ToyFilter {
    pose: Pose<Arena>,
    variance: f64,
    latest: Option<Timestamp<BrickClock>>,
}

impl ToyFilter {
    fn at(x_m: f64, y_m: f64, heading_rad: f64, variance: f64) -> Self {
        Self { pose: pose(x_m, y_m, heading_rad), variance, latest: None }
    }
}

impl Filter for ToyFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        self.latest = self.latest.max(Some(observation.stamp));
        let kind = observation.measurement.kind();
        let record = FusionRecord::new(observation.sensor, kind, observation.stamp, FusionOutcome::Accepted);
        FusionRecord { nis: 1.5, degrees_of_freedom: 1, ..record }
    }

    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        self.pose = start.pose;
        FusionOutcome::PoseReset
    }

    fn save(&self) -> Vec<u8> {
        Vec::new()
    }

    fn restore(&mut self, _saved: &[u8]) -> Result<(), RestoreError> {
        Err(RestoreError::Unsupported)
    }

    fn restart_clock(&mut self) {}

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.latest
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.latest?;
        let mut covariance = [[0.0; 5]; 5];
        for (index, row) in covariance.iter_mut().enumerate() {
            row[index] = self.variance;
        }
        let pose = self.pose;
        Some(TimedPose { time: stamp, pose }.with_covariance(covariance))
    }
}

fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> Pose<Arena> {
    Pose::new(Meters(x_m), Meters(y_m), Heading::from_rad(heading_rad))
}

fn stamp(step: usize) -> Timestamp<BrickClock> {
    Timestamp::from_millis(step as i64 * 50)
}

/// Ten steps at rest at the origin, pointing west; one observation arrives at step 3.
fn at_rest() -> ReferenceDrive {
    let truth = (0..=10).map(|step| TimedPose { time: stamp(step), pose: pose(0.0, 0.0, 3.1) });
    ReferenceDrive {
        truth: truth.collect(),
        arrivals: vec![ObservationArrival { step: 3, measured_step: 3, observation: wheels(100, 0.0, 0.0) }],
        scored_from: 1,
        ..ReferenceDrive::default()
    }
}

#[test]
fn a_constant_error_is_its_own_root_mean_square() {
    // 5 m away, and 0.1 rad off across the seam of the circle.
    let result = score(&at_rest(), &mut ToyFilter::at(3.0, 4.0, 3.2, 0.25));
    assert_eq!((result.runs, result.steps(), result.steps_without_estimate), (1, 8, 2));
    assert_eq!(result.position_rms_m(), Some(5.0));
    assert_eq!(result.position_mean_m(), Some(5.0));
    assert_eq!(result.position_max_m, Some(5.0));
    assert_eq!(result.run_rms_m, [5.0]);
    assert!((result.heading_rms_rad().unwrap() - 0.1).abs() < 1e-12);
    // By hand: (9 + 16 + 0.01) / 0.25 / 3.
    assert!((result.anees().unwrap() - 25.01 / 0.75).abs() < 1e-9);
    assert_eq!(result.claimed_rms_m(), Some(0.5_f64.sqrt()));
    assert_eq!(result.verdict().finding, Consistency::OverConfident);
    assert_eq!(result.sources[0].mean_nis_per_dof(), Some(1.5));
}

#[test]
fn runs_merge_over_all_their_steps_and_not_over_their_means() {
    let long = score(&at_rest(), &mut ToyFilter::at(1.0, 0.0, 3.1, 1.0));
    let short = ReferenceDrive { scored_from: 9, ..at_rest() };
    let mut merged = score(&short, &mut ToyFilter::at(0.0, -7.0, 3.1, 1.0));
    merged.merge(&long);
    assert_eq!((merged.runs, merged.steps()), (2, 10));
    // By hand: 8 steps of 1 and 2 of 7.
    assert!((merged.position_rms_m().unwrap() - (106.0_f64 / 10.0).sqrt()).abs() < 1e-12);
    assert!((merged.position_mean_m().unwrap() - 2.2).abs() < 1e-12);
    assert!((merged.anees().unwrap() - 106.0 / 30.0).abs() < 1e-12);
    assert_eq!(merged.position_max_m, Some(7.0));
    assert_eq!(merged.run_rms_m, [7.0, 1.0]);
    assert_eq!(merged.sources[0].used, 2);
    let mut from_nothing = FilterScore::default();
    from_nothing.merge(&merged);
    assert_eq!(from_nothing, merged);
}

#[test]
fn an_honest_estimator_is_called_consistent() {
    let mut all = FilterScore::default();
    // Nine runs of unit errors on one axis each: e' P^-1 e is 3 in the mean with a variance of 1/3.
    for run in 0..9 {
        let error = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)][run % 3];
        let mut toy = ToyFilter::at(error.0, error.1, 3.1, 1.0 / 3.0);
        all.merge(&score(&at_rest(), &mut toy));
    }
    assert!((all.anees().unwrap() - 1.0).abs() < 1e-12);
    assert_eq!(all.verdict().finding, Consistency::Consistent);
    let (_, band) = all.verdict().anees.unwrap();
    assert!(band.low < 1.0 && band.high > 1.0 && band.high < 1.7);
}

#[test]
fn what_cannot_be_scored_is_counted_and_said() {
    let mut lost = score(&at_rest(), &mut ToyFilter::at(f64::NAN, 0.0, 3.1, 1.0));
    assert_eq!((lost.steps(), lost.steps_not_finite), (0, 8));
    assert_eq!((lost.position_rms_m(), lost.anees()), (None, None));
    assert_eq!(lost.run_rms_m, [0.0; 0]);
    let far = score(&at_rest(), &mut ToyFilter::at(1e200, 0.0, 3.1, 1.0));
    assert_eq!(far.steps_not_finite, 8);
    let boast = score(&at_rest(), &mut ToyFilter::at(0.0, 0.0, 3.1, 0.0));
    assert_eq!((boast.steps(), boast.refused_covariances), (8, 8));
    assert_eq!(boast.verdict().finding, Consistency::OverConfident);
    lost.merge(&boast);
    let footnotes = [
        "toy: steps left out, no estimate: 4",
        "toy: steps left out, not finite: 8",
        "toy: steps left out of its claim and its ANEES, covariance not positive definite: 8",
    ];
    assert_eq!(lost.footnotes("toy"), footnotes);
}

#[test]
fn the_error_is_told_as_a_multiple_of_the_bound() {
    let score = score(&at_rest(), &mut ToyFilter::at(3.0, 4.0, 3.1, 1.0));
    let ratios = [Some(4.0), None, Some(0.0)].map(|bound_m| score.ratio_to_bound(bound_m));
    assert_eq!(ratios, [Some(1.25), None, None]);
}

/// Takes fixes but refuses those from `refuses_from` until `resets_at`, which moves it.
struct StubbornFilter {
    toy: ToyFilter,
    refuses_from: usize,
    resets_at: usize,
}

impl Filter for StubbornFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        let record = self.toy.observe(observation);
        let ObservationKind::Fix(fix) = observation.measurement else { return record };
        let outcome = if observation.stamp == stamp(self.resets_at) {
            FusionOutcome::PoseReset
        } else if (stamp(self.refuses_from)..stamp(self.resets_at)).contains(&observation.stamp) {
            return FusionRecord { outcome: FusionOutcome::Gated, ..record };
        } else {
            FusionOutcome::Accepted
        };
        self.toy.pose = pose(fix.position.x.0, 0.0, 3.1);
        FusionRecord { outcome, ..record }
    }

    fn save(&self) -> Vec<u8> {
        Vec::new()
    }

    fn restore(&mut self, _saved: &[u8]) -> Result<(), RestoreError> {
        Err(RestoreError::Unsupported)
    }

    fn restart_clock(&mut self) {}

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.toy.latest
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.toy.estimate_at(stamp)
    }
}

/// 8 s at rest, but for a jump of 5 m at 2 s; a fix every half second.
fn kidnapped() -> ReferenceDrive {
    let x_m = |step: usize| if step < 40 { 0.0 } else { 5.0 };
    let truth = (0..=160).map(|step| TimedPose { time: stamp(step), pose: pose(x_m(step), 0.0, 3.1) });
    let arrivals = (0..=16).map(|number| {
        let step = 10 * number;
        let observation = fix(50 * step as i64, x_m(step), 0.0, None);
        ObservationArrival { step, measured_step: step, observation }
    });
    ReferenceDrive {
        truth: truth.collect(),
        arrivals: arrivals.collect(),
        scored_from: 150,
        landings: vec![40],
        ..ReferenceDrive::default()
    }
}

#[test]
fn recovery_lasts_from_the_landing_until_the_pose_is_right_and_stays_so() {
    let disturbed = |drive: &ReferenceDrive, refuses_from, resets_at| {
        let toy = ToyFilter::at(0.0, 0.0, 3.1, 1.0);
        score(drive, &mut StubbornFilter { toy, refuses_from, resets_at }).disturbances
    };
    let found = disturbed(&kidnapped(), 40, 70);
    assert_eq!((found.recoveries_s, found.resets), (vec![1.5], 1));
    // Never, and only the last half second.
    let lost = disturbed(&kidnapped(), 40, 1_000);
    assert_eq!((lost.recovery_s(1.0), lost.resets), (Some(f64::INFINITY), 0));
    assert_eq!(disturbed(&kidnapped(), 40, 150).recovery_s(0.5), Some(5.5));
    // Of a second landing the first one was not recovered from.
    let twice = ReferenceDrive { landings: vec![40, 60], ..kidnapped() };
    assert_eq!(disturbed(&twice, 40, 70).recoveries_s, [f64::INFINITY, 0.5]);
    // After a slip at 2.05 s the fixes from 3 s on are refused but for the one that is first.
    let slipped = ReferenceDrive { landings: Vec::new(), slip_bursts: vec![41], ..kidnapped() };
    assert_eq!(disturbed(&slipped, 50, 1_000).fixes_gated_after_slips, 9);
    assert_eq!(disturbed(&slipped, 20, 60).fixes_gated_after_slips, 0);
}

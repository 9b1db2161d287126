//! A pose that is initialized by a fix, at first or after a reset, while tag and delay are not what the fix says.

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::{SMALL_STATES, StateLayout};
use posebridge_estimator::observations::StateTerm;
use posebridge_estimator::observations::fix::{FixMeasurement, fix_noise};
use posebridge_estimator::observations::sensor_frame::Exposure;
use posebridge_estimator::{EstimatedQuantity, FILTERS, Filter, FilterConfig};
use posebridge_telemetry::{
    Fix, FusionOutcome, Heading, Meters, Point2, PositionCovariance, ResetCause, TimeDelta, UncertainValue,
};

use crate::support::alter::{
    CAMERA, CORNER, altered_fixes, at, error_at, fixes, share_accepted, with_tag_moved, without_headings,
};
use crate::support::filters::{started_at, without_start};
use crate::support::observe::{fix as fix_at, fix_of, ms as stamp_of, wheels};
use crate::support::robot::{DEGREE, RADIUS_M, config};
use crate::support::score::play;
use crate::support::simulation::{Camera, Drive, RobotSimulation, STEP_S, drive_lap, drive_steps, stamp};

const LATE: TimeDelta = TimeDelta::from_millis(150);
const TAG_M: (f64, f64) = (0.2, -0.1);

fn exactly(value: f64) -> UncertainValue {
    UncertainValue { value, sigma: 0.0 }
}

/// The robot, configured with its tag's offset from the fixes' lever, and their delay.
fn with_known_tag_and_delay(mut config: FilterConfig) -> FilterConfig {
    config.calibration.tag_forward_m = exactly(TAG_M.0);
    config.calibration.tag_left_m = exactly(TAG_M.1);
    config.calibration.fix_delay_s = exactly(LATE.as_secs_f64());
    config
}

/// Fixes of that tag, that late, from a step on.
fn drive_with_fixes_from(first: usize, seed: u64) -> Drive {
    let camera = Camera { delay: 5, spread: 0, ..CAMERA };
    let drive = with_tag_moved(drive_lap(Some(camera), seed), TAG_M, LATE);
    altered_fixes(drive, |step, fix| (step >= first).then_some(fix))
}

#[test]
fn a_first_fix_sets_the_pose_by_the_known_tag_and_delay() {
    // At rest, on the straight, and while it turns on the spot.
    for first in [0, 100, CORNER.start + 18] {
        for seed in 0..5 {
            let drive = drive_with_fixes_from(first, seed);
            let played = play(&drive, &with_known_tag_and_delay(without_start()));
            let end = first + 60;
            let share = share_accepted(&fixes(&played, &(first..end)));
            assert!(share > 0.9, "from {first}, seed {seed}: {share}");
            assert_eq!(at(&played, end).reset_counter, 1, "from {first}");
            let (position_m, heading_rad) = error_at(&drive, &played, end);
            assert!(position_m < 0.02, "from {first}, seed {seed}: {position_m}");
            assert!(heading_rad < 3.0 * DEGREE, "from {first}, seed {seed}");
        }
    }
}

#[test]
fn a_first_fix_without_a_heading_does_the_same() {
    for seed in 0..5 {
        let drive = without_headings(drive_with_fixes_from(0, seed));
        let played = play(&drive, &with_known_tag_and_delay(without_start()));
        let share = share_accepted(&fixes(&played, &(0..200)));
        assert!(share > 0.95, "seed {seed}: {share}");
        assert_eq!(at(&played, 200).reset_counter, 1, "seed {seed}");
        assert!(error_at(&drive, &played, 200).0 < 0.02, "seed {seed}");
    }
}

/// A camera that is up before the robot sees it stand at its start, and must not make that less certain.
#[test]
fn a_fix_before_the_first_wheel_reading_leaves_the_heading_as_well_known_as_it_was() {
    let mut filter = PoseFilter::<SMALL_STATES>::new(&started_at(0.0, 0.0, 0.0));
    let start_sigma_rad = 0.02;
    for millis in [0, 400] {
        let seen = fix_of(0.001, -0.001, None);
        assert_eq!(filter.observe(&fix_at(millis, seen)).outcome, FusionOutcome::Accepted, "{millis}");
    }
    filter.observe(&wheels(1_300, 0.0, 0.0));
    filter.observe(&wheels(1_350, 0.0, 0.0));
    let estimate = filter.estimate_at(stamp_of(1_350)).unwrap();
    assert!(estimate.heading_sigma_rad() <= 1.001 * start_sigma_rad, "{}", estimate.heading_sigma_rad());
    assert_eq!(estimate.reset_counter, 0);
}

/// A robot whose wheels nobody hears is followed by its fixes all the same.
#[test]
fn a_robot_that_is_only_seen_is_followed() {
    let mut filter = PoseFilter::<SMALL_STATES>::new(&started_at(0.0, 0.0, 0.0));
    let mut accepted = 0;
    for k in 0..100 {
        let x_m = 0.02 * f64::from(k);
        let outcome = filter.observe(&fix_at(i64::from(100 * k), fix_of(x_m, 0.0, 0.0))).outcome;
        accepted += i32::from(outcome == FusionOutcome::Accepted);
    }
    let estimate = filter.estimate_at(stamp_of(9_900)).unwrap();
    assert!(accepted > 90, "{accepted}");
    assert!((estimate.pose.x.0 - 1.98).abs() < 0.05, "{estimate:?}");
}

/// Until the robot is found, its pose counts from where it stood; the covariance is that of its motion.
#[test]
fn a_robot_that_nobody_has_seen_has_a_pose_relative_to_its_start() {
    for (name, mut filter) in FILTERS
        .iter()
        .filter(|entry| entry.quantity == EstimatedQuantity::Pose)
        .map(|entry| (entry.name, (entry.build)(&without_start())))
    {
        for k in 0..40 {
            let turned = 0.05 * f64::from(k);
            filter.observe(&wheels(i64::from(50 * k), turned, turned));
        }
        let driven = filter.estimate_at(stamp_of(1_950)).unwrap();
        let way_m = 0.05 * 39.0 * RADIUS_M;
        assert!(driven.is_relative() && !driven.validity.position, "{name}");
        // The filters of paper 1 smooth the speed from rest and lag behind it.
        assert!((driven.pose.x.0 - way_m).abs() < 0.2 * way_m && driven.pose.y.0.abs() < 1e-3, "{name}: {driven:?}");
        // Those of the papers claim what their printed matrices say.
        let is_own = name == "pose";
        assert!(
            !is_own || (driven.x_sigma_m() < 0.2 * way_m && driven.heading_sigma_rad() < 0.2),
            "{name}: {driven:?}"
        );
        if filter.observe(&fix_at(1_950, fix_of(5.0, 6.0, 1.0))).outcome == FusionOutcome::Unused {
            continue;
        }
        let found = filter.estimate_at(stamp_of(1_950)).unwrap();
        assert!(!found.is_relative() && found.validity.heading, "{name}");
        assert_eq!(found.reset_counter, 1, "{name}: one announced reset");
        assert_eq!(found.last_correction.map(|jump| jump.cause), Some(ResetCause::Located), "{name}");
    }
}

#[test]
fn one_reset_is_enough_for_a_robot_whose_tag_is_known_to_be_elsewhere() {
    for seed in 0..5 {
        let drive = drive_with_fixes_from(0, seed);
        let played = play(&drive, &with_known_tag_and_delay(started_at(1.0, -0.5, 0.1)));
        assert_eq!(at(&played, 200).reset_counter, 1, "seed {seed}");
        assert!(error_at(&drive, &played, 200).0 < 0.02, "seed {seed}");
    }
}

fn with_unknown_tag() -> FilterConfig {
    let unknown = |sigma| UncertainValue { value: 0.03, sigma };
    let mut config = without_start();
    config.calibration.tag_forward_m = unknown(0.02);
    config.calibration.tag_left_m = unknown(0.01);
    config
}

fn initialized_from(first_fix: Fix) -> PoseFilter<SMALL_STATES> {
    let mut filter = PoseFilter::new(&with_unknown_tag());
    assert_eq!(filter.observe(&fix_at(0, first_fix)).outcome, FusionOutcome::Accepted);
    filter
}

/// A fix far out on the robot, with a noise that is no circle.
fn lopsided(heading: Option<Heading>) -> Fix {
    Fix {
        position: Point2::new(Meters(1.3), Meters(-0.4)),
        heading,
        covariance: Some(PositionCovariance { xx_m2: 4e-4, xy_m2: 1e-4, yy_m2: 9e-4, heading_rad2: 1e-2 }),
        tag_in_body: Point2::new(Meters(0.4), Meters(-0.3)),
        reset_counter: 0,
    }
}

#[test]
fn after_initialization_the_predicted_fix_has_the_covariance_of_the_observed_one() {
    for heading in [Some(Heading::from_rad(2.2)), None] {
        let first_fix = lopsided(heading);
        let filter = initialized_from(first_fix);
        let state = filter.state();
        let layout = StateLayout::new(&with_unknown_tag(), SMALL_STATES);
        let noise = fix_noise(&first_fix, &config().noise, [1.0, 1.0], &Exposure::default(), 0.0);
        let measured = FixMeasurement { fix: &first_fix, noise, exposure: Exposure::default(), source: None };
        let found = layout.linearize::<SMALL_STATES, 2>(&measured.position_model(&state.view(&layout)));
        assert!(found.innovation.amax() < 1e-12, "{heading:?}");
        let predicted = found.jacobian * state.covariance * found.jacobian.transpose();
        let off = (predicted - found.noise).amax();
        assert!(off < 1e-12, "{heading:?}: {off:e}");
        let [forward, left] = [StateTerm::TagForward, StateTerm::TagLeft].map(|of| layout.row(of).unwrap());
        // Nothing was learned about the tag, and where the robot is hangs on where the tag is.
        assert!((state.covariance[(forward, forward)] - 4e-4).abs() < 1e-15);
        assert!((state.covariance[(left, left)] - 1e-4).abs() < 1e-15);
        assert!((state.covariance[(0, forward)] + 4e-4).abs() < 1e-15);
    }
}

#[test]
fn late_fixes_that_agree_are_accepted_while_the_robot_turns_now_and_then() {
    // Half a second of turning, half a second of rest: the body's space of half a second ago is another than that of now.
    let late = TimeDelta::from_millis(500);
    for seed in 0..5 {
        let mut world = RobotSimulation::new(seed);
        let camera = Camera { every: 2, delay: 12, spread: 0, outliers: 0.0 };
        let steps = (0..200).map(|k| (0.0, if k % 20 < 10 { 0.0 } else { 2.0 * STEP_S }));
        let drive = with_tag_moved(drive_steps(&mut world, steps, Some(camera)), (0.0, 0.0), late);
        let mut config = started_at(1.0, -0.5, 0.0);
        config.calibration.fix_delay_s = exactly(late.as_secs_f64());
        config.params.adapt_gain = 0.0;
        let played = play(&drive, &config);
        let reset = played
            .records
            .iter()
            .find(|record| record.outcome == FusionOutcome::PoseReset)
            .map(|record| record.stamp - stamp(12));
        let waited = reset.unwrap_or(TimeDelta::from_millis(i64::MAX));
        assert!(waited < TimeDelta::from_millis(5_300), "seed {seed}: {reset:?}");
    }
}

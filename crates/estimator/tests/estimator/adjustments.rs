//! What a person changes about a filter that runs: tunables, the pose, what is learned.

use posebridge_estimator::filters::pose::PoseFilter;
use posebridge_estimator::filters::pose::layout::{CORE_STATES, RADIUS};
use posebridge_estimator::{FILTERS, Filter, FilterCommand, FilterConfig, PARAMS, Params};
use posebridge_telemetry::{Calibration, FusionOutcome, OnlineCalibration, ResetCause, UncertainValue};

use crate::support::filters::{drive_straight, for_each, latest, start, state_text};
use crate::support::observe::{fix, fix_of, gyro, wheels};
use crate::support::robot::{RADIUS_M, config, unknown};

const TAKES_PARAMS: [&str; 2] = ["odometry", "pose"];

fn tuned(key: &str, value: f64) -> Params {
    let mut params = Params::default();
    params.set(key, value).expect("a value in its range");
    params
}

/// A filter with constants to learn.
fn learning() -> PoseFilter<CORE_STATES> {
    PoseFilter::new(&FilterConfig {
        calibration: Calibration {
            radius_scale: unknown(0.05),
            radius_difference: unknown(0.02),
            track_scale: unknown(0.05),
            ..Calibration::default()
        },
        ..config()
    })
}

/// Goes on straight ahead from one instant to another with wheels that are three per cent larger than configured, a fix
/// twice a second.
fn drive_on(filter: &mut dyn Filter, (from_ms, until_ms): (i64, i64)) {
    for millis in (from_ms..until_ms).step_by(50) {
        let forward_m = 0.2e-3 * millis as f64;
        filter.observe(&gyro(millis, 0.0));
        let rad = forward_m / (1.03 * RADIUS_M);
        filter.observe(&wheels(millis, rad, rad));
        if millis % 500 == 0 {
            filter.observe(&fix(millis, fix_of(forward_m, 0.0, 0.0)));
        }
    }
}

fn radius_scale(filter: &dyn Filter) -> UncertainValue {
    filter.calibration().expect("it learns").radius_scale
}

#[test]
fn every_filter_reports_whether_it_takes_tunables_and_is_unchanged_where_it_does_not() {
    for entry in FILTERS {
        let mut filter = (entry.build)(&config());
        drive_straight(filter.as_mut(), 1_000);
        let before = state_text(filter.as_ref());
        let verdict = filter.apply_command(&FilterCommand::SetParams(tuned("gate_prob", 0.6)));
        let expected = if TAKES_PARAMS.contains(&entry.name) { FusionOutcome::Accepted } else { FusionOutcome::Unused };
        assert_eq!(verdict, expected, "{}", entry.name);
        // Neither loses what it knows.
        assert_eq!(state_text(filter.as_ref()), before, "{}", entry.name);
    }
}

#[test]
fn tunables_that_are_set_first_are_those_that_a_filter_is_built_with() {
    for row in PARAMS {
        let other = 0.25 * row.range.start() + 0.75 * row.range.end();
        let params = tuned(row.key, other);
        let built = FilterConfig { params, ..config() };
        for entry in FILTERS.iter().filter(|entry| TAKES_PARAMS.contains(&entry.name)) {
            let mut built = (entry.build)(&built);
            let mut set = (entry.build)(&config());
            let _ = set.apply_command(&FilterCommand::SetParams(params));
            for filter in [&mut built, &mut set] {
                drive_on(filter.as_mut(), (0, 2_000));
                // What came too late, too far and from wheels too fast is used or refused by the same rules.
                filter.observe(&fix(200, fix_of(0.04, 0.0, 0.0)));
                filter.observe(&fix(2_000, fix_of(0.43, 0.02, 0.1)));
                filter.observe(&wheels(2_050, 40.0, 40.0));
            }
            assert_eq!(state_text(set.as_ref()), state_text(built.as_ref()), "{} {}", entry.name, row.key);
        }
    }
}

#[test]
fn a_gate_that_is_narrowed_refuses_the_next_fix_and_keeps_the_state() {
    let offset = fix(2_050, fix_of(0.41, 0.012, 0.0));
    let verdict_after = |probability: f64| {
        // With the noise as configured, so that 12 mm are a little more than two sigma.
        let unlearned = tuned("adapt_gain", 0.0);
        let mut filter = PoseFilter::<CORE_STATES>::new(&FilterConfig { params: unlearned, ..config() });
        drive_straight(&mut filter, 2_000);
        filter.observe(&fix(2_000, fix_of(0.4, 0.0, 0.0)));
        let before = latest(&filter);
        let narrowed = Params { gate_probability: probability, ..unlearned };
        let _ = filter.apply_command(&FilterCommand::SetParams(narrowed));
        assert_eq!(latest(&filter), before);
        filter.observe(&offset).outcome
    };
    assert_eq!(verdict_after(0.999), FusionOutcome::Accepted);
    assert_eq!(verdict_after(0.5), FusionOutcome::Gated);
}

#[test]
fn a_pose_reset_is_undone_by_the_next_fix_and_both_are_reported() {
    for_each(&config(), |entry, mut filter| {
        drive_straight(filter.as_mut(), 1_000);
        let before = latest(filter.as_ref());
        if filter.apply_command(&FilterCommand::ResetPose) == FusionOutcome::Unused {
            assert_eq!(latest(filter.as_ref()), before, "{}", entry.name);
            return;
        }
        let lost = latest(filter.as_ref());
        assert!(!lost.validity.position && !lost.validity.heading);
        assert_eq!(lost.reset_counter, before.reset_counter.wrapping_add(1));
        assert_eq!(lost.stamp, before.stamp);
        assert!(lost.last_correction.is_some(), "{}", entry.name);
    });
    let mut filter = learning();
    drive_on(&mut filter, (0, 2_001));
    let _ = filter.apply_command(&FilterCommand::ResetPose);
    filter.observe(&fix(1_980, fix_of(3.0, 2.0, 1.0)));
    assert!(!latest(&filter).validity.position, "it was seen before");
    assert_eq!(filter.observe(&fix(2_050, fix_of(3.0, 2.0, 1.0))).outcome, FusionOutcome::PoseReset);
    let found = latest(&filter);
    assert_eq!(found.last_correction.map(|jump| jump.cause), Some(ResetCause::Located));
    assert!(found.validity.position && found.validity.heading);
    assert!((found.pose.x.0 - 3.0).abs() < 1e-9 && (found.pose.heading.rad() - 1.0).abs() < 1e-9);
}

#[test]
fn adjustments_of_one_instant_are_applied_in_their_order() {
    let mut filter = learning();
    drive_on(&mut filter, (0, 1_000));
    let _ = filter.apply_command(&FilterCommand::ResetPose);
    let _ = filter.set_pose(&start(1.0, 1.0, 0.0));
    assert!(latest(&filter).validity.position);
    let _ = filter.apply_command(&FilterCommand::ResetPose);
    assert!(!latest(&filter).validity.position);
}

#[test]
fn frozen_constants_stay_what_they_are_and_are_learned_on_when_they_thaw() {
    let mut filter = learning();
    drive_on(&mut filter, (0, 4_000));
    let learned = radius_scale(&filter);
    assert!(learned.value > 0.005 && learned.sigma < 0.05, "{learned:?}");
    let _ = filter.apply_command(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Frozen));
    let _ = filter.apply_command(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Frozen));
    drive_on(&mut filter, (4_000, 8_000));
    assert_eq!(radius_scale(&filter), learned);
    let row = filter.state().covariance.row(RADIUS).norm();
    assert_eq!(row, 0.0, "nothing else is told by it");
    let _ = filter.apply_command(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Enabled));
    assert_eq!(radius_scale(&filter), learned, "with the doubt that it had");
    drive_on(&mut filter, (8_000, 16_000));
    let on = radius_scale(&filter);
    assert!((on.value - 0.03).abs() < (learned.value - 0.03).abs(), "{on:?}");
    assert!(on.sigma < learned.sigma);
}

#[test]
fn a_calibration_that_is_forgotten_begins_with_what_was_configured() {
    let mut filter = learning();
    let configured = filter.calibration();
    drive_on(&mut filter, (0, 4_000));
    assert_ne!(filter.calibration(), configured);
    let pose = latest(&filter).pose;
    let _ = filter.apply_command(&FilterCommand::ResetCalibration);
    assert_eq!(filter.calibration(), configured);
    assert_eq!(latest(&filter).pose, pose, "the robot is where it was");
    // Frozen it stays, whatever it is.
    let _ = filter.apply_command(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Frozen));
    let _ = filter.apply_command(&FilterCommand::ResetCalibration);
    drive_on(&mut filter, (4_000, 8_000));
    let frozen = filter.calibration().map(|learned| learned.radius_scale);
    assert_eq!(frozen, configured.map(|learned| learned.radius_scale));
}

#[test]
fn a_late_observation_does_not_undo_a_later_adjustment() {
    let run = |order: [i64; 2]| {
        let mut filter = learning();
        drive_on(&mut filter, (0, 2_000));
        for what in order {
            if what == 0 {
                filter.observe(&fix(1_750, fix_of(0.35, 0.001, 0.0)));
            } else {
                let _ = filter.apply_command(&FilterCommand::SetOnlineCalibration(OnlineCalibration::Frozen));
                let _ = filter.set_pose(&start(1.0, 1.0, 0.0));
            }
        }
        drive_on(&mut filter, (2_000, 3_000));
        state_text(&filter) + &format!("{:?}", filter.state())
    };
    assert_eq!(run([0, 1]), run([1, 0]));
}

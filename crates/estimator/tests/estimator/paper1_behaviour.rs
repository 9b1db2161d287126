//! The filters of paper 1 when sensors come in any order, fall silent, jump, or arrive late.

use std::f64::consts::FRAC_PI_2;

use posebridge_estimator::Filter;

use posebridge_telemetry::{Fix, FusionOutcome, Meters, Observation, Point2, TimeDelta, quantities::wrap_rad};

use crate::support::filters::{
    drive_straight, drive_straight_from, latest, named, rest, start, started_at, state_text, without_start,
};
use crate::support::observe::{accelerations, fix, fix_of, gyro, ms, wheels};
use crate::support::robot::{DEGREE, RADIUS_M, TRACK_M, config};

const ALL: [&str; 9] = [
    "wheel-kf",
    "wheel-kf-speeds",
    "velocity-kf",
    "ekf5",
    "ekf5-camera",
    "ekf5-corrected",
    "ekf5-camera-corrected",
    "ukf-all",
    "ukf5",
];

fn with_tag(fix: Fix, forward_m: f64, left_m: f64) -> Fix {
    Fix { tag_in_body: Point2::new(Meters(forward_m), Meters(left_m)), ..fix }
}

#[test]
fn the_order_of_the_sensors_within_an_instant_does_not_matter() {
    for name in ALL {
        let mut ends = vec![];
        for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0], [2, 0, 1]] {
            let mut filter = named(name, &config());
            for k in 0..60_i64 {
                let phase = k as f64 * 0.1;
                let come = [
                    wheels(50 * k, phase.sin() + phase, 2.0 * phase),
                    gyro(50 * k, 0.3 * phase.cos()),
                    accelerations(50 * k, phase.sin(), 0.5),
                ];
                for index in order {
                    filter.observe(&come[index]);
                }
            }
            ends.push(latest(filter.as_ref()));
        }
        for end in &ends[1..] {
            assert!((end.pose.x.0 - ends[0].pose.x.0).abs() < 1e-9, "{name}");
            assert!((end.pose.heading - ends[0].pose.heading).0.abs() < 1e-9);
            assert!((end.turn_rate.0 - ends[0].turn_rate.0).abs() < 1e-9);
            for row in 0..5 {
                let (found, expected) = (end.covariance[row][row], ends[0].covariance[row][row]);
                assert!((found - expected).abs() < 1e-9 * expected, "{name} {row}");
            }
        }
    }
}

/// Integrated speeds are behind by K_1 / K_2 of each wheel's speed, 0.2243 s left and 0.2480 s right: at 0.2 m/s the heading, too.
fn heading_lag_rad(name: &str) -> f64 {
    if name == "wheel-kf-speeds" { 0.2 * (0.2480 - 0.2243) / TRACK_M } else { 0.0 }
}

#[test]
fn over_a_gap_the_robot_moved_by_the_counters() {
    for name in ALL {
        let mut filter = named(name, &config());
        drive_straight(filter.as_mut(), 3_000);
        let before = latest(filter.as_ref());
        let rad = 0.2 * 6.0 / RADIUS_M;
        let record = filter.observe(&wheels(6_000, rad, rad));
        assert_eq!(record.outcome, FusionOutcome::Accepted, "{name}");
        let after = latest(filter.as_ref());
        let moved_m = after.pose.x.0 - before.pose.x.0;
        assert!((moved_m - 0.6).abs() < 0.02, "{name}: {moved_m}");
        assert!(after.pose.y.0.abs() < 0.01 + 1.2 * heading_lag_rad(name), "{name}");
        assert!(after.x_sigma_m() > before.x_sigma_m(), "{name}");
    }
}

#[test]
fn a_turn_within_a_gap_makes_the_position_uncertain() {
    for name in ALL {
        let driven = |turn_rad: f64| {
            let mut filter = named(name, &config());
            drive_straight(filter.as_mut(), 1_000);
            let (far, more) = (1.2 / RADIUS_M, 0.5 * turn_rad * TRACK_M / RADIUS_M);
            filter.observe(&wheels(5_000, far - more, far + more));
            let end = latest(filter.as_ref());
            (end.x_sigma_m().hypot(end.y_sigma_m()), end.pose.heading.rad())
        };
        let (straight_m, _) = driven(0.0);
        let (turned_m, heading_rad) = driven(1.0);
        assert!((heading_rad - 1.0).abs() < 0.05 + heading_lag_rad(name), "{name}: {heading_rad}");
        // Distance times turn over the root of 12, on either axis.
        let added_m2 = turned_m.powi(2) - straight_m.powi(2);
        let expected_m2 = 2.0 / 12.0;
        assert!((0.9 * expected_m2..1.3 * expected_m2).contains(&added_m2), "{name}: {added_m2}");
    }
}

#[test]
fn speeds_are_held_for_half_a_second_and_then_the_pose_stays_with_growing_variance() {
    for name in ALL {
        let mut filter = named(name, &config());
        drive_straight(filter.as_mut(), 5_000);
        let now = latest(filter.as_ref());
        let ahead = |millis: i64| filter.estimate_at(ms(5_000 + millis)).expect("a prediction");
        assert!((ahead(300).pose.x.0 - now.pose.x.0 - 0.06).abs() < 1e-3, "{name}");
        assert_eq!(ahead(500).pose, ahead(4_000).pose, "{name}");
        let sigmas = [0, 200, 500, 700, 4_000].map(|millis| ahead(millis).x_sigma_m());
        assert!(sigmas.is_sorted_by(|a, b| a < b), "{name}: {sigmas:?}");
    }
}

#[test]
fn counters_that_are_zeroed_after_a_turn_do_not_turn_the_robot_back() {
    for name in ALL {
        let mut filter = named(name, &config());
        for k in 0..=40_i64 {
            let turned = FRAC_PI_2 * (k as f64 / 20.0).min(1.0);
            let rad = 0.5 * turned * TRACK_M / RADIUS_M + 500.0;
            let rate = if (1..=20).contains(&k) { FRAC_PI_2 } else { 0.0 };
            filter.observe(&wheels(50 * k, 1_000.0 - rad, rad));
            filter.observe(&gyro(50 * k, rate));
        }
        let before = latest(filter.as_ref());
        assert!((before.pose.heading.rad() - FRAC_PI_2).abs() < 0.15, "{name}");
        let verdict = filter.observe(&wheels(2_050, 0.0, 0.0)).outcome;
        assert_eq!(verdict, FusionOutcome::Rebased, "{name}");
        for k in 42..80_i64 {
            filter.observe(&wheels(50 * k, 0.0, 0.0));
            filter.observe(&gyro(50 * k, 0.0));
        }
        let turned = (latest(filter.as_ref()).pose.heading - before.pose.heading).0;
        assert!(turned.abs() < 0.02, "{name}: {turned}");
    }
}

#[test]
fn a_fix_is_used_when_it_comes_with_its_lever_arm() {
    let mut filter = named("ekf5-camera", &started_at(1.0, 2.0, FRAC_PI_2));
    filter.observe(&wheels(0, 0.0, 0.0));
    // The tag sits 10 cm ahead and 5 cm to the left: north and west of a robot that looks north.
    let exact = fix(0, with_tag(fix_of(0.95, 2.1, FRAC_PI_2), 0.1, 0.05));
    let record = filter.observe(&exact);
    assert_eq!(record.outcome, FusionOutcome::Accepted);
    assert_eq!(record.degrees_of_freedom, 3);
    assert!(record.nis < 1e-20, "{record:?}");
    // Turned further to the left, the tag would be further west and further south.
    let s = record.innovation_covariance;
    assert!((s[0][2] + 0.1 * 0.02 * 0.02).abs() < 1e-12, "{s:?}");
    assert!((s[1][2] + 0.05 * 0.02 * 0.02).abs() < 1e-12, "{s:?}");
    // 5 mm of the camera, and the lever times the uncertain heading.
    assert!(latest(filter.as_ref()).x_sigma_m() < 0.006);
    let record = filter.observe(&fix(10, with_tag(fix_of(0.955, 2.1, None), 0.1, 0.05)));
    assert_eq!(record.degrees_of_freedom, 2);
    assert!((record.innovation[0] - 0.005).abs() < 1e-9, "{record:?}");
    let moved = latest(filter.as_ref());
    assert!((1.0..1.005).contains(&moved.pose.x.0), "{moved:?}");
    assert_eq!(moved.fix_age, Some(TimeDelta::ZERO));
    assert!(!moved.is_dead_reckoning);
}

#[test]
fn a_late_fix_is_held_against_the_present_and_pulls_the_robot_back() {
    let mut filter = named("ekf5-camera", &config());
    drive_straight(filter.as_mut(), 2_000);
    let before = latest(filter.as_ref()).pose.x.0;
    let record = filter.observe(&fix(1_800, fix_of(0.36, 0.0, 0.0)));
    assert_eq!(record.outcome, FusionOutcome::Accepted);
    assert_eq!(record.lag, TimeDelta::from_millis(200));
    let after = latest(filter.as_ref()).pose.x.0;
    assert!((record.innovation[0] - (0.36 - before)).abs() < 1e-12);
    assert!(after < before - 0.02 && after > 0.35, "{before} {after}");
    assert_eq!(filter.latest_time(), Some(ms(2_000)));
    let before = state_text(filter.as_ref());
    assert_eq!(
        filter.observe(&fix(1_700, fix_of(0.34, 0.0, 0.0))).outcome,
        FusionOutcome::TooOld,
        "older than one used"
    );
    assert_eq!(state_text(filter.as_ref()), before);
}

#[test]
fn without_a_start_a_fix_with_a_heading_initializes_the_pose_and_one_without_does_not() {
    let nowhere = without_start();
    let mut filter = named("ekf5-camera", &nowhere);
    drive_straight(filter.as_mut(), 1_000);
    let verdict = filter.observe(&fix(1_000, fix_of(3.0, 4.0, None))).outcome;
    assert_eq!(verdict, FusionOutcome::Unused);
    assert!(!latest(filter.as_ref()).validity.position);
    let first_fix = fix(1_000, with_tag(fix_of(3.0, 4.0, FRAC_PI_2), 0.1, 0.05));
    assert_eq!(filter.observe(&first_fix).outcome, FusionOutcome::PoseReset);
    let located = latest(filter.as_ref());
    assert!(located.validity.position && located.validity.heading);
    assert!((located.pose.x.0 - 3.05).abs() < 1e-12 && (located.pose.y.0 - 3.9).abs() < 1e-12);
    assert!((located.x_sigma_m() - 0.005).abs() < 1e-12);
    drive_straight_from(filter.as_mut(), 1_050, 1_500);
    let moved = latest(filter.as_ref());
    assert!((moved.pose.y.0 - 4.0).abs() < 0.01, "north: {:?}", moved.pose);
}

#[test]
fn the_gyros_drift_is_not_held_against_the_camera_for_ever() {
    let mut filter = named("ekf5-camera", &config());
    for k in 0..1_200_i64 {
        filter.observe(&wheels(50 * k, 0.0, 0.0));
        filter.observe(&gyro(50 * k, 5.0 * DEGREE));
        if k % 2 == 0 {
            filter.observe(&fix(50 * k, fix_of(0.0, 0.0, 0.0)));
        }
    }
    // A minute at 5 degrees per second would be 300 degrees.
    let heading_rad = latest(filter.as_ref()).pose.heading.rad();
    assert!(heading_rad.abs() < 3.0 * DEGREE, "{heading_rad}");
}

/// A circle of 0.5 m at 0.2 m/s: the wheels every 200 ms, and each 800 ms a position between two of their readings, made at the
/// heading of the circle. The filters are told a start that is off by `start_error_rad`.
fn drive_circle(filter: &mut dyn Filter, start_error_rad: f64, image: impl Fn(i64, [f64; 2]) -> [f64; 2]) {
    let at = |millis: i64| 0.4e-3 * millis as f64;
    let _ = filter.set_pose(&start(0.5, 0.0, FRAC_PI_2 + start_error_rad));
    for k in 0..150_i64 {
        let millis = 200 * k;
        let [left, right] = [-0.5, 0.5].map(|side| (0.5 + side * TRACK_M) * at(millis) / RADIUS_M);
        filter.observe(&wheels(millis, left, right));
        if k % 4 == 1 {
            let seen = image(k, [0.5 * at(millis + 100).cos(), 0.5 * at(millis + 100).sin()]);
            filter.observe(&fix(millis + 100, Fix { heading: None, ..fix_of(seen[0], seen[1], 0.0) }));
        }
    }
}

/// Distance to the end of that circle, and the error of the heading.
fn circle_error(filter: &dyn Filter) -> [f64; 2] {
    let (pose, angle) = (latest(filter).pose, 0.4e-3 * 29_900.0);
    let off = wrap_rad(pose.heading.rad() - angle - FRAC_PI_2).abs();
    [(pose.x.0 - 0.5 * angle.cos()).hypot(pose.y.0 - 0.5 * angle.sin()), off]
}

#[test]
fn a_fix_between_two_readings_of_the_wheels_counts_no_turn_twice() {
    for name in ["ekf5-camera", "ekf5-camera-corrected", "ukf-all"] {
        let mut filter = named(name, &without_start());
        drive_circle(filter.as_mut(), 0.0, |_, seen| seen);
        let [off_m, off_rad] = circle_error(filter.as_ref());
        assert!(off_m < 0.02 && off_rad < 0.06, "{name}: {off_m} m, {off_rad} rad");
    }
}

#[test]
fn rejected_fixes_that_agree_among_themselves_move_the_pose_and_others_do_not() {
    for name in ["ekf5-camera-corrected", "ukf-all"] {
        let mut lost = named(name, &without_start());
        drive_circle(lost.as_mut(), 2.6, |_, seen| seen);
        let [off_m, off_rad] = circle_error(lost.as_ref());
        assert!(off_m < 0.02 && off_rad < 0.06, "{name}: {off_m} m, {off_rad} rad");
        // The start that is set is the first.
        assert!(latest(lost.as_ref()).reset_counter > 1);
        // Four images of another robot, here and there.
        let mut right = named(name, &without_start());
        let strange = |k: i64, seen: [f64; 2]| {
            let elsewhere = (60..76).contains(&k);
            if elsewhere { [if k % 8 == 1 { 2.0 } else { -2.0 }, 1.0] } else { seen }
        };
        drive_circle(right.as_mut(), 0.0, strange);
        let [off_m, off_rad] = circle_error(right.as_ref());
        assert!(off_m < 0.02 && off_rad < 0.06, "{name}: {off_m} m, {off_rad} rad");
        assert_eq!(latest(right.as_ref()).reset_counter, 1);
    }
}

#[test]
fn the_corrected_filter_learns_the_gyros_bias_at_rest_and_reports_it() {
    let mut filter = named("ekf5-corrected", &config());
    rest(filter.as_mut(), 400, 1.5 * DEGREE);
    let learned = filter.calibration().expect("it learns").gyro_bias_rad_per_s;
    assert!((learned.value - 1.5 * DEGREE).abs() < 0.1 * DEGREE, "{learned:?}");
    assert!(learned.sigma < 0.1 * DEGREE, "{learned:?}");
    let heading_rad = latest(filter.as_ref()).pose.heading.rad();
    assert!(heading_rad.abs() < 0.3 * DEGREE, "{heading_rad}");
    assert!(named("ekf5", &config()).calibration().is_none());
}

#[test]
fn no_integral_gives_the_corrected_filter_an_absolute_heading() {
    let mut vague = started_at(0.0, 0.0, 0.0);
    if let Some(start) = &mut vague.start {
        start.heading_sigma_rad = 0.1;
    }
    let sigma_of = |name: &str| {
        let mut filter = named(name, &vague);
        rest(filter.as_mut(), 200, 0.0);
        latest(filter.as_ref()).heading_sigma_rad()
    };
    assert!(sigma_of("ekf5-corrected") > 0.0999);
    assert!(sigma_of("ekf5") < 0.01, "it takes the integrals for truth");
}

#[test]
fn a_stamp_that_may_be_off_makes_a_fix_of_a_moving_robot_weaker() {
    let innovation_var_m2 = |stamp_sigma| {
        let mut filter = named("ekf5-camera", &config());
        drive_straight(filter.as_mut(), 2_000);
        let uncertain_fix = Observation { stamp_sigma, ..fix(2_000, fix_of(0.39, 0.0, None)) };
        filter.observe(&uncertain_fix).innovation_covariance[0][0]
    };
    let added_m2 = innovation_var_m2(TimeDelta::from_millis(100)) - innovation_var_m2(TimeDelta::ZERO);
    assert!((added_m2 - 0.02 * 0.02).abs() < 1e-5, "{added_m2}");
}

#[test]
fn a_bias_that_is_known_is_subtracted() {
    for name in ["ekf5", "ukf5"] {
        let mut configured = config();
        configured.calibration.gyro_bias_rad_per_s.value = 1.5 * DEGREE;
        let mut filter = named(name, &configured);
        rest(filter.as_mut(), 400, 1.5 * DEGREE);
        let heading_rad = latest(filter.as_ref()).pose.heading.rad();
        assert!(heading_rad.abs() < 1e-9, "{name}: {heading_rad}");
    }
}

#[test]
fn accelerations_are_held_for_three_tenths_of_a_second_at_any_prediction_time() {
    for name in ["velocity-kf", "ekf5", "ekf5-corrected", "ukf5"] {
        let mut filter = named(name, &config());
        drive_straight(filter.as_mut(), 2_000);
        let before = latest(filter.as_ref()).forward_speed.0;
        filter.observe(&accelerations(2_000, 1.0, 1.0));
        for (millis, gained_m_per_s) in [(2_200, 0.2), (2_300, 0.3), (2_450, 0.3), (9_000, 0.3)] {
            let ahead = filter.estimate_at(ms(millis)).expect("a prediction");
            let gained = ahead.forward_speed.0 - before;
            assert!((gained - gained_m_per_s).abs() < 1e-9, "{name} at {millis}: {gained}");
        }
        let mut turning = named(name, &config());
        turning.observe(&accelerations(0, 0.9, 1.1));
        let turned = turning.estimate_at(ms(50)).expect("a prediction").turn_rate.0;
        assert!((turned - 0.2 / TRACK_M * 0.05).abs() < 1e-9, "{name}: {turned}");
    }
}

#[test]
fn a_new_base_of_the_counters_makes_no_filter_surer_of_its_pose() {
    for name in ALL {
        let mut filter = named(name, &config());
        drive_straight(filter.as_mut(), 2_000);
        let before = filter.estimate_at(ms(2_400)).expect("a prediction");
        let verdict = filter.observe(&wheels(2_400, -500.0, -500.0)).outcome;
        assert_eq!(verdict, FusionOutcome::Rebased, "{name}");
        let after = latest(filter.as_ref());
        for (what, found, least) in [
            ("x", after.x_sigma_m(), before.x_sigma_m()),
            ("y", after.y_sigma_m(), before.y_sigma_m()),
            ("heading", after.heading_sigma_rad(), before.heading_sigma_rad()),
        ] {
            assert!(found > 0.999 * least, "{name}: {what} {found} {least}");
        }
    }
}

#[test]
fn the_corrected_filter_takes_the_bias_off_the_gyro_while_the_wheels_are_lost() {
    let mut configured = config();
    configured.calibration.gyro_bias_rad_per_s.value = 3.0 * DEGREE;
    configured.noise.gyro_bias_rad_per_s = 0.05 * DEGREE;
    let mut filter = named("ekf5-corrected", &configured);
    for k in 0..=60_i64 {
        filter.observe(&gyro(50 * k, 3.0 * DEGREE));
        filter.observe(&wheels(50 * k, 0.0, 0.0));
    }
    for k in 61..=260_i64 {
        filter.observe(&gyro(50 * k, 3.0 * DEGREE));
    }
    let end = latest(filter.as_ref());
    // Ten seconds at 3 degrees per second, all of it bias.
    assert!(end.pose.heading.rad().abs() < 0.5 * DEGREE, "{end:?}");
    // 0.5 degrees by the bias, which is known to 0.05 degrees per second, and as much by the gyro's noise.
    let sigma_rad = end.heading_sigma_rad();
    assert!((0.6 * DEGREE..0.8 * DEGREE).contains(&sigma_rad), "{end:?}");
}

#[test]
fn a_path_that_was_driven_unseen_is_no_leap_of_the_corrected_filters_speed() {
    // The wheels are read with the gyro, or between two of its readings.
    for offset in [0, 20] {
        let mut filter = named("ekf5-corrected", &config());
        for k in 0..=110_i64 {
            filter.observe(&gyro(50 * k, 0.0));
            let millis = 50 * k + offset;
            let rad = 0.2e-3 * millis as f64 / RADIUS_M;
            if !(61..100).contains(&k) {
                filter.observe(&wheels(millis, rad, rad));
            }
            if k >= 100 {
                let now = latest(filter.as_ref());
                let (speed, x_m) = (now.forward_speed.0, now.pose.x.0);
                assert!((speed - 0.2).abs() < 0.03, "{offset} {k}: {speed}");
                let expected_m = 0.2e-3 * millis as f64;
                assert!((x_m - expected_m).abs() < 0.02, "{offset} {k}: {x_m} {expected_m}");
            }
        }
    }
}

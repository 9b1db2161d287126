//! The flagship when the world does not keep to its model: wrong starts, outliers, slip, silence, unknown headings.

mod absolute_sensors;
mod constants;
mod heading;
mod initialization;
mod noise;
mod recovery;
mod slowly;

use std::ops::Range;

use posebridge_telemetry::{FusionOutcome, Meters, SensorId, TimeDelta};

use crate::support::alter::{
    CAMERA, CORNER, STRAIGHT, altered, altered_fixes, at, error_at, fixes, share_accepted, share_done, step_of,
    with_slip,
};
use crate::support::filters::{started_at, without_start};
use crate::support::robot::{DEGREE, RADIUS_M, TRACK_M, config};
use crate::support::score::{mean, mean_score, play, score};
use crate::support::simulation::{Camera, Drive, drive_lap, stamp};

#[test]
fn a_wrong_start_is_left_after_the_fixes_have_agreed_for_long_enough() {
    for seed in 0..10 {
        let drive = drive_lap(Some(CAMERA), seed);
        let played = play(&drive, &started_at(1.0, -0.5, 0.1));
        let reset =
            played.records.iter().find(|record| record.outcome == FusionOutcome::PoseReset).expect("the fixes agree");
        let waited = reset.stamp - stamp(2);
        assert!(waited >= TimeDelta::from_millis(5_000), "seed {seed}: {waited:?}");
        assert!(waited <= TimeDelta::from_millis(5_300), "seed {seed}: {waited:?}");
        let after = at(&played, 120);
        assert_eq!(after.reset_counter, 1, "seed {seed}");
        let jump = after.last_correction.expect("it is told");
        // Half a metre was driven in a direction that is 0.1 rad wrong.
        assert!((jump.dx_m + 1.0).abs() < 0.1 && (jump.dy_m - 0.5).abs() < 0.1, "{jump:?}");
        assert!((jump.turn.0 + 0.1).abs() < 4.0 * DEGREE, "{jump:?}");
        let end = drive.poses.len();
        assert_eq!(at(&played, end).reset_counter, 1, "seed {seed}: only once");
        assert!(error_at(&drive, &played, end).0 < 0.01, "seed {seed}");
    }
}

#[test]
fn fixes_that_disagree_with_each_other_move_nothing() {
    for seed in 0..10 {
        // Three seconds in which the camera sees something else, somewhere else each time.
        let confused = 100..160;
        let drive = altered_fixes(drive_lap(Some(CAMERA), seed), |step, mut fix| {
            if confused.contains(&step) {
                let angle_rad = 2.4 * step as f64;
                fix.position.x += Meters(0.8 * angle_rad.cos());
                fix.position.y += Meters(0.8 * angle_rad.sin());
            }
            Some(fix)
        });
        let played = play(&drive, &config());
        assert_eq!(share_accepted(&fixes(&played, &confused)), 0.0);
        assert!(share_accepted(&fixes(&played, &(160..300))) > 0.97);
        assert_eq!(at(&played, 300).reset_counter, 0, "seed {seed}");
        assert!(error_at(&drive, &played, 165).0 < 0.02, "seed {seed}");
    }
}

#[test]
fn from_an_unknown_start_the_first_fix_with_a_heading_is_enough() {
    let mut scores = vec![];
    for seed in 0..20 {
        let drive = drive_lap(Some(CAMERA), seed);
        let played = play(&drive, &without_start());
        assert!(!at(&played, 1).validity.position, "seed {seed}");
        let soon = at(&played, 6);
        assert!(soon.validity.position && soon.validity.heading, "seed {seed}");
        assert_eq!(soon.reset_counter, 1, "until then the pose was relative");
        scores.push(score(&drive, &played, 6));
    }
    let mean = mean(&scores);
    println!("unknown start, pose fixes: {mean:?}");
    assert!((0.79..1.24).contains(&mean.anees), "{mean:?}");
    assert!((0.9..1.1).contains(&mean.fix_nis_per_dof), "{mean:?}");
    assert!(mean.position_rms_m < 0.002, "{mean:?}");
}

/// Worst heading error during some steps, and share of the fixes of that time that were used.
fn through_slip(drive: &Drive, steps: &Range<usize>) -> (f64, f64) {
    let played = play(drive, &config());
    assert_eq!(at(&played, steps.end + 100).reset_counter, 0);
    let worst_rad = steps.clone().map(|step| error_at(drive, &played, step).1).fold(0.0, f64::max);
    (worst_rad, share_accepted(&fixes(&played, steps)))
}

#[test]
fn a_turn_that_wheels_and_gyro_disagree_about_is_slip() {
    // The right wheel spins by a turn of 60 degrees within half a second, on the straight.
    let spun = |step| (0.0, 60.0 * DEGREE * share_done(&(200..210), step) * TRACK_M / RADIUS_M);
    // The robot is turned through the complete corner while its wheels are at rest.
    let pushed = |step| {
        let half_rad = 0.25 * std::f64::consts::PI * TRACK_M / RADIUS_M * share_done(&CORNER, step);
        (half_rad, -half_rad)
    };
    for seed in 0..10 {
        let drive = drive_lap(Some(CAMERA), seed);
        for (case, drive, steps) in [
            ("spin", with_slip(drive.clone(), spun), 205..260),
            ("push", with_slip(drive, pushed), CORNER.start..CORNER.end + 20),
        ] {
            let (worst_rad, accepted) = through_slip(&drive, &steps);
            println!("{case}, seed {seed}: {:.1} degrees, {accepted}", worst_rad / DEGREE);
            assert!(worst_rad < 5.0 * DEGREE, "{case}, seed {seed}: {worst_rad}");
            assert!(accepted > 0.85, "{case}, seed {seed}: {accepted}");
        }
    }
}

#[test]
fn without_a_camera_the_heading_follows_the_gyro_through_slip() {
    let spun = 200..210;
    for seed in 0..10 {
        let drive = with_slip(drive_lap(None, seed), |step| {
            (0.0, 60.0 * DEGREE * share_done(&spun, step) * TRACK_M / RADIUS_M)
        });
        let played = play(&drive, &config());
        let (_, heading_rad) = error_at(&drive, &played, 230);
        assert!(heading_rad < 5.0 * DEGREE, "seed {seed}: {heading_rad}");
        let sigma_rad = at(&played, 230).heading_sigma_rad();
        assert!(heading_rad < 4.0 * sigma_rad, "seed {seed}: {sigma_rad}");
    }
}

#[test]
fn counters_that_begin_again_in_a_turn_cost_no_heading() {
    let middle = usize::midpoint(CORNER.start, CORNER.end);
    for seed in 0..10 {
        let jumped = with_slip(drive_lap(None, seed), |step| if step < middle { (0.0, 0.0) } else { (-90.0, -70.0) });
        let played = play(&jumped, &config());
        let rebased = played.records.iter().filter(|record| record.outcome == FusionOutcome::Rebased);
        assert_eq!(rebased.count(), 1, "seed {seed}");
        let (_, heading_rad) = error_at(&jumped, &played, CORNER.end);
        println!("jump, seed {seed}: {:.2} degrees", heading_rad / DEGREE);
        assert!(heading_rad < 2.0 * DEGREE, "seed {seed}: {heading_rad}");
    }
}

#[test]
fn after_a_silence_of_four_seconds_round_a_corner_the_first_fixes_are_accepted() {
    let silent = CORNER.start - 40..CORNER.start + 40;
    for seed in 0..10 {
        let drive = altered(drive_lap(Some(CAMERA), seed), |observation| {
            (!silent.contains(&step_of(&observation))).then_some(observation)
        });
        let played = play(&drive, &config());
        let back = silent.end + 10;
        assert_eq!(at(&played, back).reset_counter, 0, "seed {seed}");
        let (position_m, heading_rad) = error_at(&drive, &played, back);
        assert!(position_m < 0.02, "seed {seed}: {position_m}");
        assert!(heading_rad < 3.0 * DEGREE, "seed {seed}: {heading_rad}");
        assert!(share_accepted(&fixes(&played, &(silent.end..back + 50))) > 0.9);
        // In the silence the estimate is marked as uncertain.
        let lost = at(&played, silent.end - 1);
        assert!(lost.is_dead_reckoning && !lost.validity.speeds, "seed {seed}");
        let (error_m, _) = error_at(&drive, &played, silent.end - 1);
        let sigma_m = lost.x_sigma_m().hypot(lost.y_sigma_m());
        assert!(error_m < 3.0 * sigma_m, "seed {seed}: {error_m} {sigma_m}");
    }
}

#[test]
fn after_half_a_minute_without_fixes_the_first_one_is_accepted() {
    let blind = 100..700;
    for seed in 0..10 {
        let drive = altered_fixes(drive_lap(Some(CAMERA), seed), |step, fix| (!blind.contains(&step)).then_some(fix));
        let played = play(&drive, &config());
        let before = at(&played, 700);
        assert!(before.is_dead_reckoning, "seed {seed}");
        assert!(before.fix_age.is_some_and(|age| age > TimeDelta::from_millis(29_000)));
        let after = at(&played, 710);
        assert!(!after.is_dead_reckoning && after.reset_counter == 0);
        assert!(share_accepted(&fixes(&played, &(700..760))) > 0.9, "seed {seed}");
        assert!(error_at(&drive, &played, 710).0 < 0.015, "seed {seed}");
    }
}

#[test]
fn a_fix_whose_stamp_is_uncertain_weighs_less_while_the_robot_moves() {
    let drive = drive_lap(Some(CAMERA), 1);
    let nis_with = |stamp_sigma: TimeDelta| {
        let uncertain = altered(drive.clone(), |mut observation| {
            if observation.sensor == SensorId::CAMERA {
                observation.stamp_sigma = stamp_sigma;
            }
            Some(observation)
        });
        // With the noise as configured: the adaptation would undo the margin of the uncertainty.
        let mut config = config();
        config.params.adapt_gain = 0.0;
        let played = play(&uncertain, &config);
        let driving = fixes(&played, &STRAIGHT);
        driving.iter().map(|record| record.nis).sum::<f64>() / driving.len() as f64
    };
    let (certain_nis, uncertain_nis) = (nis_with(TimeDelta::ZERO), nis_with(TimeDelta::from_millis(50)));
    // 50 ms at 0.2 m/s are 10 mm beside the 5 mm of the camera.
    assert!(uncertain_nis < 0.6 * certain_nis, "{certain_nis} {uncertain_nis}");
}

#[test]
fn fixes_that_all_come_two_seconds_late_are_worth_almost_as_much() {
    let late = Camera { delay: 40, spread: 0, ..CAMERA };
    let mean = mean_score(20, 0, |seed| (drive_lap(Some(late), seed), config()));
    println!("two seconds late: {mean:?}");
    // Two seconds of dead reckoning at 0.2 m/s cost some millimetres.
    assert!(mean.position_rms_m < 0.006, "{mean:?}");
    assert!((0.79..1.24).contains(&mean.anees), "{mean:?}");
}

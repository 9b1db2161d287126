//! The camera: its rate, noise, delay, outliers and the times without it.

use crate::support::{DEGREE, assert_sigma, bundled, changed, fix_errors, fixes, rms};

#[test]
fn the_camera_has_the_files_rate_noise_and_delay() {
    let mut errors = Vec::new();
    let mut late = [0_usize; 8];
    let mut overtaken = 0;
    for run in 0..5 {
        let drive = bundled("camera-10hz").drive(run);
        let fixes = fixes(&drive);
        let steps = drive.truth.len() - 1;
        assert!(steps / 2 - fixes.len() <= 3, "all but the last ones arrive");
        assert!(fixes.windows(2).all(|pair| pair[0].0 < pair[1].0), "one per step");
        overtaken += fixes.windows(2).filter(|pair| pair[1].1 < pair[0].1).count();
        for (arrived, taken, _) in &fixes {
            assert!(taken.is_multiple_of(2));
            late[arrived - taken] += 1;
        }
        errors.extend(fix_errors(&drive));
    }
    let count = errors.len();
    assert_sigma(rms(errors.iter().map(|error| error.0)), 0.005, count, "x");
    assert_sigma(rms(errors.iter().map(|error| error.1)), 0.005, count, "y");
    let heading = rms(errors.iter().filter_map(|error| error.2));
    assert_sigma(heading, DEGREE, count, "heading");
    // Two, three or four steps, equally likely; one in nine waits because a newer fix went first.
    assert_eq!(late[0] + late[1] + late[6] + late[7], 0, "{late:?}");
    let share = |steps: usize| late[steps] as f64 / count as f64;
    for (steps, expected) in [(2, 3.0 / 9.0), (3, 3.0 / 9.0), (4, 2.0 / 9.0), (5, 1.0 / 9.0)] {
        assert!((share(steps) - expected).abs() < 0.02, "{late:?} of {count}");
    }
    assert_eq!(late[5], overtaken, "a fix is overtaken where it waits");
}

#[test]
fn the_slow_camera_is_later() {
    for (name, least, most) in [("camera-1hz", 4, 8), ("kicks-camera-1hz", 5, 7)] {
        let mut late = Vec::new();
        for run in 0..10 {
            let drive = bundled(name).drive(run);
            late.extend(fixes(&drive).iter().map(|(arrived, taken, _)| arrived - taken));
        }
        assert_eq!(late.iter().min(), Some(&least), "{name}");
        assert_eq!(late.iter().max(), Some(&most), "{name}");
    }
}

#[test]
fn the_true_noise_of_the_camera_is_a_multiple_of_what_is_told() {
    for (name, factor) in [("noise-x4", 4.0), ("noise-quarter", 0.25)] {
        let drive = bundled(name).drive(0);
        let errors = fix_errors(&drive);
        assert_eq!(drive.prior.noise.fix_position_m, 0.005);
        let position = rms(errors.iter().map(|error| error.0));
        assert_sigma(position, factor * 0.005, errors.len(), name);
    }
}

#[test]
fn outliers_have_their_share_and_size() {
    for (name, share, sigma) in [("outliers-3pct", 0.03, 0.5), ("outliers-10pct", 0.10, 0.04)] {
        let mut errors = Vec::new();
        for run in 0..5 {
            let drive = bundled(name).drive(run);
            errors.extend(fix_errors(&drive));
        }
        let count = errors.len();
        // Variance: that of the camera and that of the outliers' share.
        let expected = (0.005_f64.powi(2) + share * sigma * sigma).sqrt();
        let found = rms(errors.iter().map(|error| error.0));
        assert!((found / expected - 1.0).abs() < 0.15, "{name}: {found} against {expected}");
        // Far off is beyond six sigma of the camera; with 0.5 m nearly every outlier is.
        let far = errors.iter().filter(|error| error.0.abs() > 0.03).count();
        let beyond = if sigma > 0.1 { 0.952 } else { 0.457 };
        let expected_far = share * beyond * count as f64;
        assert!(
            (far as f64 - expected_far).abs() < 4.0 * expected_far.sqrt(),
            "{name}: {far} of {count}, expected {expected_far}"
        );
    }
}

#[test]
fn a_blackout_has_no_fix_and_the_rest_does() {
    let drive = bundled("blackout").drive(0);
    let stamps: Vec<f64> = fixes(&drive).iter().map(|(_, taken, _)| *taken as f64 * 0.05).collect();
    assert!(stamps.iter().all(|at| !(60.0..=240.0).contains(at)));
    assert!(stamps.iter().any(|at| *at > 59.8 && *at < 60.0));
    assert!(stamps.iter().any(|at| *at > 240.0 && *at < 240.2));
}

#[test]
fn instants_that_are_steps_are_those_steps_on_a_grid_that_binary_fractions_do_not_hit() {
    // 1.05 / 0.15 is above 7 and 6 x 0.15 below 0.9, both by the last bit.
    let blackout = "blackout = { from_s = 0.9, to_s = 1.8 }\ntrue_noise_factor = 1.0";
    let scenario = changed(
        "unknown-heading",
        &[
            ("\nstep_s = 0.05", "\nstep_s = 0.15"),
            ("score_from_s = 2.0", "score_from_s = 1.05"),
            ("true_noise_factor = 1.0", blackout),
        ],
    );
    let drive = scenario.drive(0);
    assert_eq!(drive.scored_from, 7);
    let taken: Vec<usize> = fixes(&drive).iter().map(|fix| fix.1).take(4).collect();
    assert_eq!(taken, [2, 4, 14, 16]);
}

//! The robot's wheels, encoders, gyro and accelerometers: what they told against what was driven.

use crate::support::{DEGREE, accelerations, assert_sigma, bundled, changed, rates, rms, true_turn_rad, wheel_angles};
use posebridge_sim::montecarlo::Drive;
use posebridge_telemetry::quantities::wrap_rad;

/// Wheels that do not slip along their way.
const NO_TRAVEL_NOISE: (&str, &str) = ("wheel_travel_m_per_sqrt_m = 0.0008", "wheel_travel_m_per_sqrt_m = 0.0");
/// And not in turns either.
const NO_TURN_NOISE: (&str, &str) = ("turn_rad_per_sqrt_rad = 0.004", "turn_rad_per_sqrt_rad = 0.0");

#[test]
fn without_noise_the_wheels_tell_the_way_by_the_true_geometry() {
    let fine = ("tick_deg = 1.0", "tick_deg = 1e-5");
    let quiet = changed("no-camera", &[NO_TRAVEL_NOISE, NO_TURN_NOISE, fine]);
    let drive = quiet.drive(2);
    let geometry = drive.true_geometry;
    let mut before: Option<(f64, f64)> = None;
    let mut at = (0.0, 0.0, 0.0_f64);
    for (step, left_rad, right_rad) in wheel_angles(&drive) {
        if let Some((left_before, right_before)) = before.replace((left_rad, right_rad)) {
            let left_m = (left_rad - left_before) * geometry.left_wheel_radius.0;
            let right_m = (right_rad - right_before) * geometry.right_wheel_radius.0;
            let turn_rad = (right_m - left_m) / geometry.track_width.0;
            let middle_rad = at.2 + 0.5 * turn_rad;
            at.0 += 0.5 * (left_m + right_m) * middle_rad.cos();
            at.1 += 0.5 * (left_m + right_m) * middle_rad.sin();
            at.2 += turn_rad;
        }
        let truth = drive.truth[step];
        assert!((at.0 - truth.x.0).hypot(at.1 - truth.y.0) < 1e-4);
        assert!(wrap_rad(at.2 - truth.heading.rad()).abs() < 1e-5);
    }
}

#[test]
fn geometry_slip_and_bias_have_the_files_spread() {
    let scenario = changed("no-camera", &[("laps = 4", "laps = 1")]);
    let drives: Vec<Drive> = (0..300).map(|run| scenario.drive(run)).collect();
    let count = drives.len();
    let relative = |of: fn(&Drive) -> (f64, f64)| {
        rms(drives.iter().map(|drive| {
            let (found, nominal) = of(drive);
            found / nominal - 1.0
        }))
    };
    let track = relative(|drive| (drive.true_geometry.track_width.0, drive.prior.geometry.track_width.0));
    assert_sigma(track, 0.03, count, "track");
    let mean = relative(|drive| {
        let geometry = &drive.true_geometry;
        (geometry.left_wheel_radius.0 + geometry.right_wheel_radius.0, 0.056)
    });
    assert_sigma(mean, 0.005, count, "mean radius");
    let difference = rms(drives.iter().map(|drive| {
        let geometry = &drive.true_geometry;
        (geometry.right_wheel_radius.0 - geometry.left_wheel_radius.0) / 0.028
    }));
    assert_sigma(difference, 0.005, count, "difference of radii");
    // At rest for two seconds the gyro says its bias: the mean of 40 roundings and noises adds 0.1 deg/s.
    let bias = rms(drives.iter().map(|drive| {
        let rest: Vec<f64> = rates(drive).iter().take(40).map(|(_, rate)| *rate).collect();
        rest.iter().sum::<f64>() / 40.0 / DEGREE
    }));
    assert_sigma(bias, 1.0_f64.hypot(0.66 / 40.0_f64.sqrt()), count, "bias");
    // A turn in place of 90 degrees, the first of the lap: both wheels slip, and the heading.
    let turn_rad = std::f64::consts::FRAC_PI_2;
    let slip = rms(drives.iter().map(|drive| {
        let turn = (367..=403).map(|step| true_turn_rad(drive, step));
        turn.sum::<f64>() - turn_rad
    }));
    let wheel_m2 = 0.0008_f64.powi(2) * turn_rad * 0.056;
    let expected = (2.0 * wheel_m2 / 0.112_f64.powi(2) + 0.004_f64.powi(2) * turn_rad).sqrt();
    assert_sigma(slip, expected, count, "slip of a turn");
    // The first side: the mean of two wheels that slip for themselves over 3 m.
    let short_m = rms(drives.iter().map(|drive| {
        let parts = drive.truth[40..347].windows(2);
        let driven_m: f64 = parts.map(|pair| pair[0].origin().distance(pair[1].origin()).0).sum();
        driven_m - 3.0
    }));
    assert_sigma(short_m, 0.0008 * 1.5_f64.sqrt(), count, "slip of a side");
}

#[test]
fn encoder_and_gyro_speak_in_whole_degrees() {
    let drive = bundled("camera-10hz").drive(1);
    let is_whole = |rad: f64| (rad / DEGREE - (rad / DEGREE).round()).abs() < 1e-6;
    for (_, left_rad, right_rad) in wheel_angles(&drive) {
        assert!(is_whole(left_rad) && is_whole(right_rad));
    }
    assert!(rates(&drive).iter().all(|(_, rate)| is_whole(*rate)));
}

#[test]
fn encoders_are_floored_and_not_rounded() {
    let quiet = changed("no-camera", &[NO_TRAVEL_NOISE, NO_TURN_NOISE]);
    let drive = quiet.drive(0);
    let geometry = drive.true_geometry;
    let mut true_rad = 0.0;
    let mut short_deg = Vec::new();
    for (step, left_rad, _) in wheel_angles(&drive).into_iter().skip(1) {
        let poses = (&drive.truth[step - 1], &drive.truth[step]);
        let forward_m = poses.0.origin().distance(poses.1.origin()).0;
        let half_track_m = 0.5 * geometry.track_width.0;
        let left_m = forward_m - half_track_m * true_turn_rad(&drive, step);
        true_rad += left_m / geometry.left_wheel_radius.0;
        short_deg.push((true_rad - left_rad) / DEGREE);
    }
    assert!(short_deg.iter().all(|short| (-0.01..1.01).contains(short)));
    let mean = short_deg.iter().sum::<f64>() / short_deg.len() as f64;
    assert!((mean - 0.5).abs() < 0.1, "{mean}");
}

#[test]
fn the_gyro_errs_by_noise_and_rounding() {
    let drive = bundled("camera-10hz").drive(0);
    let errors: Vec<f64> =
        rates(&drive).iter().map(|(step, rate)| rate - true_turn_rad(&drive, *step) / 0.05).collect();
    // Differences of neighbours have no bias; they hold twice the variance of noise and rounding.
    let white = rms(errors.windows(2).map(|pair| (pair[1] - pair[0]) / DEGREE / 2.0_f64.sqrt()));
    let expected = (0.36_f64 + 1.0 / 12.0).sqrt();
    assert!((white / expected - 1.0).abs() < 0.05, "{white} against {expected}");
}

#[test]
fn the_gyros_bias_walks_as_far_as_the_file_says() {
    let scenario = changed("no-camera", &[("s_sqrt_s = 0.01", "s_sqrt_s = 0.1"), ("laps = 4", "laps = 1")]);

    let walked = (0..200).map(|run| {
        let drive = scenario.drive(run);
        let errors: Vec<f64> =
            rates(&drive).iter().map(|(step, rate)| (rate - true_turn_rad(&drive, *step) / 0.05) / DEGREE).collect();
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        mean(&errors[errors.len() - 200..]) - mean(&errors[..200])
    });
    // Means over 10 s at either end of 79.45 s: a random walk over what lies between, a third of each end, and their noise.
    let between_s = 1589.0_f64 * 0.05 - 20.0 + 20.0 / 3.0;
    let noise = 0.66 * (2.0_f64 / 200.0).sqrt();
    assert_sigma(rms(walked), (0.1 * between_s.sqrt()).hypot(noise), 200, "walk");
}

#[test]
fn accelerometers_tell_the_change_of_the_wheels_speeds() {
    let drive = bundled("paper-square").drive(0);
    let accelerations = accelerations(&drive);
    let rest: Vec<f64> = accelerations.iter().take(40).flat_map(|(_, left, right)| [*left, *right]).collect();
    assert_sigma(rms(rest.iter().copied()), 0.05, rest.len(), "noise at rest");
    let speed: f64 = accelerations
        .iter()
        .take_while(|(step, ..)| *step <= 80)
        .map(|(_, left, right)| 0.5 * (left + right) * 0.05)
        .sum();
    // On the first side: 0.2 m/s, and the sum of 80 noises of two wheels.
    assert!((speed - 0.2).abs() < 0.05, "{speed}");
}

#[test]
fn the_encoders_count_what_the_wheels_really_turned() {
    let drive = bundled("kicks").drive(3);
    assert_eq!(drive.wheel_turns.len() + 1, drive.truth.len());
    let counted = wheel_angles(&drive);
    let (mut left, mut right) = (0.0, 0.0);
    for (turn, (step, told_left, told_right)) in drive.wheel_turns.iter().zip(&counted[1..]) {
        left += turn.left.0;
        right += turn.right.0;
        // Floored to a degree; the sum here is rounded elsewhere.
        for part in [left - told_left, right - told_right] {
            assert!((-1e-9..DEGREE + 1e-9).contains(&part), "{step}: {part}");
        }
    }
    assert!(left > 100.0 && right > 100.0);
    assert!(drive.wheel_turns.iter().any(|turn| turn.left.0 < 0.0));
}

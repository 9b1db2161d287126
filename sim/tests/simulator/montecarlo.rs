//! Monte-Carlo drives are what their files say: statistics of truth and sensors, the order of arrival, repeatability.

mod real_worlds;

use posebridge_sim::montecarlo::{Drive, SCENARIOS, Scenario};
use posebridge_telemetry::quantities::wrap_rad;
use posebridge_telemetry::{Fix, ObservationKind, SensorId};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

fn bundled(name: &str) -> Scenario {
    Scenario::bundled(name).unwrap()
}

/// The bundled scenario with some of its text replaced.
fn changed(name: &str, changes: &[(&str, &str)]) -> Scenario {
    let (_, text) = SCENARIOS.iter().find(|(known, _)| *known == name).unwrap();
    let mut text = (*text).to_owned();
    for (from, to) in changes {
        assert!(text.contains(from), "{name} has no `{from}`");
        text = text.replace(from, to);
    }
    Scenario::from_toml(&text).unwrap()
}

/// What `pick` takes from the observations, given the step at which each arrived.
fn observed<T>(drive: &Drive, pick: impl Fn(usize, ObservationKind) -> Option<T>) -> Vec<T> {
    drive.arrivals.iter().filter_map(|arrival| pick(arrival.step, arrival.observation.measurement)).collect()
}

/// Arrival step, stamp as a step, and content of every fix.
fn fixes(drive: &Drive) -> Vec<(usize, usize, Fix)> {
    let arrivals = drive.arrivals.iter().filter_map(|arrival| {
        let ObservationKind::Fix(fix) = arrival.observation.measurement else { return None };
        let taken = arrival.observation.stamp.as_nanos() / drive.step.as_nanos();
        Some((arrival.step, usize::try_from(taken).unwrap(), fix))
    });
    arrivals.collect()
}

/// Errors of the fixes: x, y and, where it has one, heading.
fn fix_errors(drive: &Drive) -> Vec<(f64, f64, Option<f64>)> {
    let errors = fixes(drive).into_iter().map(|(_, taken, fix)| {
        let (truth, position) = (drive.truth[taken], fix.position);
        let heading = fix.heading.map(|heading| (heading - truth.heading).0);
        (position.x.0 - truth.x.0, position.y.0 - truth.y.0, heading)
    });
    errors.collect()
}

fn rates(drive: &Drive) -> Vec<(usize, f64)> {
    observed(drive, |step, kind| if let ObservationKind::TurnRate(rate) = kind { Some((step, rate.0)) } else { None })
}

/// Step and left and right rotation.
fn wheel_angles(drive: &Drive) -> Vec<(usize, f64, f64)> {
    observed(drive, |step, kind| {
        if let ObservationKind::WheelAngles { left, right } = kind { Some((step, left.0, right.0)) } else { None }
    })
}

/// Step and left and right acceleration.
fn accelerations(drive: &Drive) -> Vec<(usize, f64, f64)> {
    observed(drive, |step, kind| {
        if let ObservationKind::WheelAccelerations { left, right } = kind {
            Some((step, left.0, right.0))
        } else {
            None
        }
    })
}

fn true_turn_rad(drive: &Drive, step: usize) -> f64 {
    (drive.truth[step].heading - drive.truth[step - 1].heading).0
}

fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    f64::sqrt(sum / count)
}

/// Whether a root mean square over `count` draws fits `expected` within four standard deviations.
fn assert_sigma(found: f64, expected: f64, count: usize, what: &str) {
    let allowed = 4.0 * expected / (2.0 * count as f64).sqrt();
    assert!((found - expected).abs() < allowed, "{what}: {found} instead of {expected} +- {allowed}");
}

fn is_whole_degrees(angle_rad: f64) -> bool {
    (angle_rad / DEGREE - (angle_rad / DEGREE).round()).abs() < 1e-6
}

#[test]
fn every_bundled_scenario_reads_and_its_first_drive_is_finite_and_in_order() {
    for (name, _) in SCENARIOS {
        let drive = bundled(name).drive(0);
        assert!(drive.truth.len() > 300, "{name}: {}", drive.truth.len());
        for pose in &drive.truth {
            assert!(pose.x.0.is_finite() && pose.y.0.is_finite(), "{name}");
        }
        let steps: Vec<usize> = drive.arrivals.iter().map(|arrival| arrival.step).collect();
        assert!(steps.is_sorted(), "{name}");
        for arrival in &drive.arrivals {
            assert!(
                arrival.observation.stamp <= drive.time_at(arrival.step),
                "{name}: an observation arrives before it is made"
            );
        }
        let wheels = drive.arrivals.iter().filter(|arrival| arrival.observation.sensor == SensorId::WHEELS);
        assert_eq!(wheels.count(), drive.truth.len(), "{name}");
    }
}

#[test]
fn a_run_can_be_repeated_alone_and_differs_from_its_neighbours() {
    let scenario = bundled("kicks-camera-1hz");
    assert_eq!(scenario.drive(3), scenario.drive(3));
    assert_ne!(scenario.drive(3), scenario.drive(4));
    let other = scenario.clone().with_seed(2);
    assert_ne!(scenario.drive(3), other.drive(3));
}

#[test]
fn scenarios_with_the_same_seed_share_their_truth() {
    let clear = bundled("camera-10hz").drive(5);
    for name in ["outliers-3pct", "noise-x4", "blackout", "no-camera"] {
        assert_eq!(clear.truth, bundled(name).drive(5).truth, "{name}");
    }
}

#[test]
fn four_laps_take_their_steps_and_end_at_the_start() {
    for run in 0..10 {
        let drive = bundled("camera-10hz").drive(run);
        // By hand: 40 + 4 laps of 4 x (306 + 20 + 37 + 10) + 37 + 20.
        assert_eq!(drive.truth.len() - 1, 40 + 4 * (4 * 373 + 57));
        let end = drive.truth.last().unwrap();
        // Along a side nothing corrects the slip: 16 sides of 3 m, 0.8 mm per square root of a metre and wheel.
        assert!(end.x.0.hypot(end.y.0) < 0.03, "{end:?}");
        assert!(end.heading.rad().abs() < 0.06, "{end:?}");
        let farthest =
            drive.truth.iter().fold((0.0_f64, 0.0_f64), |far, pose| (far.0.max(pose.x.0), far.1.max(pose.y.0)));
        assert!((farthest.0 - 3.0).abs() < 0.05 && (farthest.1 - 3.0).abs() < 0.05);
    }
}

#[test]
fn kicks_turn_the_robot_and_not_its_wheels() {
    let scenario = bundled("kicks");
    let (mut kicked, mut sides_s) = (0, 0.0);
    for run in 0..40 {
        let drive = scenario.drive(run);
        sides_s += 4.0 * 306.0 * 0.05;
        // A kick of 3 to 8 degrees over 4 steps is at least 13 mrad a step, more than slip of 0.4 mm and most corrections.
        let rates: Vec<f64> = (1..drive.truth.len()).map(|step| true_turn_rad(&drive, step)).collect();
        let wheels = wheel_turns_rad(&drive);
        let unseen: Vec<f64> = rates.iter().zip(&wheels).map(|(turn, measured)| turn - measured).collect();
        let sums: Vec<f64> = unseen.windows(4).map(|four| four.iter().sum::<f64>().abs()).collect();
        kicked += sums
            .windows(3)
            .filter(|three| three[1] > 2.8 * DEGREE && three[1] >= three[0] && three[1] > three[2])
            .count();
    }
    // While one kick runs none begins: 0.15 per second of 0.2 s less.
    let expected = 0.15 * sides_s / (1.0 + 0.15 * 0.15);
    assert!(
        (f64::from(u32::try_from(kicked).unwrap()) - expected).abs() < 4.0 * expected.sqrt() + 0.05 * expected,
        "{kicked} kicks, expected {expected}"
    );
}

/// The turns that the wheels tell with the true geometry; off by up to a count each.
fn wheel_turns_rad(drive: &Drive) -> Vec<f64> {
    let geometry = drive.true_geometry;
    let angles: Vec<f64> = wheel_angles(drive)
        .into_iter()
        .map(|(_, left_rad, right_rad)| {
            (right_rad * geometry.right_wheel_radius.0 - left_rad * geometry.left_wheel_radius.0)
                / geometry.track_width.0
        })
        .collect();
    angles.windows(2).map(|pair| pair[1] - pair[0]).collect()
}

#[test]
fn an_unknown_heading_is_off_by_anything_and_the_camera_tells_no_heading() {
    let scenario = bundled("unknown-heading");
    let offs: Vec<f64> = (0..500)
        .map(|run| {
            let drive = scenario.drive(run);
            assert_eq!(drive.prior.geometry, drive.true_geometry);
            assert!(fixes(&drive).iter().all(|(arrived, taken, fix)| fix.heading.is_none() && arrived == taken));
            assert_eq!((drive.truth.len(), drive.scored_from), (401, 40));
            (drive.prior.start.heading - drive.truth[0].heading).0
        })
        .collect();
    assert_sigma(rms(offs.iter().copied()), std::f64::consts::PI / 3.0_f64.sqrt(), 500, "off");
    assert!(offs.iter().any(|off| *off > 2.8) && offs.iter().any(|off| *off < -2.8));
}

#[test]
fn the_spline_loop_is_closed_and_driven_at_two_metres_per_second() {
    let drive = bundled("wpilib").drive(0);
    let end = drive.truth.last().unwrap();
    assert!(end.x.0.hypot(end.y.0) < 0.02, "{end:?}");
    assert!((end.heading.rad() - 45.0 * DEGREE).abs() < 0.01, "{end:?}");
    let speeds: Vec<f64> =
        drive.truth.windows(2).map(|pair| pair[0].origin().distance(pair[1].origin()).0 / 0.02).collect();
    let fastest = speeds.iter().copied().fold(0.0, f64::max);
    assert!((1.98..=2.0 + 1e-9).contains(&fastest), "{fastest}");
    let length_m = 0.02 * speeds.iter().sum::<f64>();
    assert!((12.0..16.0).contains(&length_m), "{length_m}");
    for (arrived, taken, _) in fixes(&drive) {
        assert_eq!(arrived - taken, 13);
    }
    // The loop passes its outer poses.
    for x_m in [3.0, -3.0] {
        let nearest = drive.truth.iter().map(|pose| (pose.x.0 - x_m).hypot(pose.y.0));
        assert!(nearest.fold(f64::MAX, f64::min) < 0.03, "{x_m}");
    }
}

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
fn the_gyro_errs_by_noise_and_rounding_to_degrees() {
    let drive = bundled("camera-10hz").drive(0);
    let errors: Vec<f64> =
        rates(&drive).iter().map(|(step, rate)| rate - true_turn_rad(&drive, *step) / 0.05).collect();
    assert!(rates(&drive).iter().all(|(_, rate)| is_whole_degrees(*rate)));
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
fn the_encoders_count_in_whole_degrees_what_the_wheels_really_turned() {
    let drive = bundled("kicks").drive(3);
    assert_eq!(drive.wheel_turns.len() + 1, drive.truth.len());
    let counted = wheel_angles(&drive);
    let (mut left, mut right) = (0.0, 0.0);
    for (turn, (step, measured_left, measured_right)) in drive.wheel_turns.iter().zip(&counted[1..]) {
        assert!(is_whole_degrees(*measured_left) && is_whole_degrees(*measured_right));
        left += turn.left.0;
        right += turn.right.0;
        // Floored to a degree; the sum here is rounded elsewhere.
        for part in [left - measured_left, right - measured_right] {
            assert!((-1e-9..DEGREE + 1e-9).contains(&part), "{step}: {part}");
        }
    }
    assert!(left > 100.0 && right > 100.0);
    assert!(drive.wheel_turns.iter().any(|turn| turn.left.0 < 0.0));
}

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
    // Slower cameras are later: their shortest and their longest delay.
    for (name, least, most) in [("camera-1hz", 4, 8), ("kicks-camera-1hz", 5, 7)] {
        let fixes: Vec<_> = (0..10).flat_map(|run| fixes(&bundled(name).drive(run))).collect();
        let late: Vec<usize> = fixes.iter().map(|(arrived, taken, _)| arrived - taken).collect();
        assert_eq!((late.iter().min(), late.iter().max()), (Some(&least), Some(&most)), "{name}");
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

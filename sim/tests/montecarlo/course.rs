//! The way that is driven, where it begins and what pushes the robot off it.

use crate::support::{DEGREE, assert_sigma, bundled, fixes, rms, true_turn_rad, wheel_angles};
use posebridge_sim::montecarlo::Drive;

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
        let unseen: Vec<f64> = rates.iter().zip(&wheels).map(|(turn, seen)| turn - seen).collect();
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

//! `posebridge calibrate` and `identify` on recordings of ours: what a robot that was recorded is found to be.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test stops where its set-up is broken")]

#[path = "support/calibrating.rs"]
mod calibrating;
mod support;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::path::Path;

use calibrating::{calibrate, calibrate_failing, number};
use posebridge::config::RobotProfile;
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use support::{posebridge, root, stdout_of};
use virtual_drive::record_drive;

/// How far the wheels and the track of the simulated robot are off, as shares: mean radius, difference of the radii, track.
const OFF: [f64; 3] = [0.02, 0.008, 0.04];
/// For so long the robot stands when its path has ended.
const REST: TimeDelta = TimeDelta::from_millis(60_000);

/// A figure of eight by a robot that is not what its brick says, and a minute of rest, as `posebridge run` would have recorded it:
/// brick and station in virtual time, every input of the station written down.
fn recorded_drive(folder: &Path) {
    let mut scenario = Scenario::bundled("figure-eight").unwrap().with_laps(2);
    scenario.errors.radius_error = OFF[0];
    scenario.errors.radius_mismatch = OFF[1];
    scenario.errors.track_error = OFF[2];
    record_drive(&folder.join("drive.mcap"), scenario, REST);
}

/// Whether a profile's robot is the simulated one, to a share of each number.
fn is_the_robot(profile: &Path, share: f64) {
    let robot = RobotProfile::read(profile).unwrap().robot;
    let mean = f64::midpoint(robot.left_wheel_radius_m, robot.right_wheel_radius_m);
    let difference = (robot.right_wheel_radius_m - robot.left_wheel_radius_m) / mean;
    for (found, truth) in
        [(mean / 0.028 - 1.0, OFF[0]), (difference, OFF[1]), (robot.track_width_m / 0.112 - 1.0, OFF[2])]
    {
        assert!((found - truth).abs() < share, "{found}, true {truth}");
    }
    assert!(!robot.adopt_description);
}

#[test]
fn a_recording_of_ours_calibrates_the_robot_that_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    recorded_drive(folder.path());
    let found = calibrate(folder.path(), &["path", "drive.mcap", "--save", "r.toml"]);
    assert_eq!(found["sanity"]["is_sound"], true, "{found}");
    // Two laps of six metres: the sigmas of wheels and track are some tenths of a per cent.
    is_the_robot(&folder.path().join("r.toml"), 0.004);
    for (key, truth) in [("radius_scale", OFF[0]), ("radius_difference", OFF[1]), ("track_scale", OFF[2])] {
        let of = |part: &str| number(&found, &format!("/numbers/{key}/{part}"));
        println!("{key} {:.5} +- {:.5}, true {truth}", of("value"), of("sigma"));
        assert!((of("value") - truth).abs() < 3.0 * of("sigma"), "{key}: {found}");
    }
    // The profile goes over what the brick says of itself, on the recording and live.
    let replayed = stdout_of(posebridge(folder.path()).args(["replay", "drive.mcap", "--robot", "r.toml", "--json"]));
    assert!(serde_json::from_str::<Value>(&replayed).is_ok());
}

#[test]
fn a_recording_of_ours_has_wheels_whose_step_can_be_identified() {
    let folder = tempfile::tempdir().unwrap();
    recorded_drive(folder.path());
    let step = ["identify", "step", "--recording", "drive.mcap", "--json"];
    let wheel = ["--channel", "left-wheel", "--to", "6"];
    let printed = stdout_of(posebridge(folder.path()).args(step).args(wheel));
    let found: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(found["sensor"], "left wheel");
    assert_eq!(found["runs"][0]["way"], "up");
    let mut command = posebridge(folder.path());
    let output = command.args(step).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2));
    assert!(said.contains("left-wheel, right-wheel, turn-rate"), "{said}");
}

#[test]
fn what_the_filter_has_learned_on_line_is_a_profile_too() {
    let folder = tempfile::tempdir().unwrap();
    recorded_drive(folder.path());
    // What a recording of ours cannot be asked for is said as it is.
    for (asked, word) in [
        (["--against", "truth"], "has no truth"),
        (["--try-on", "drive"], "`drive.mcap` is one drive"),
        (["--truth-sigma-m", "0.1"], "compared with fixes"),
    ] {
        let (code, said) = calibrate_failing(folder.path(), &[&["path", "drive.mcap"], &asked[..]].concat());
        assert!(code == 2 && said.contains(word), "{said}");
        assert!(!said.contains("--run"), "{said}");
    }
    let online = ["path", "drive.mcap", "--online", "--save", "on.toml"];
    let found = calibrate(folder.path(), &online);
    for (key, truth) in [("radius_scale", OFF[0]), ("radius_difference", OFF[1]), ("track_scale", OFF[2])] {
        let of = |part: &str| number(&found, &format!("/online/{key}/{part}"));
        assert!((of("value") - truth).abs() < 4.0 * of("sigma"), "{key}: {found}");
        // Better known than the prior that the profile of the default robot gives: it has learned.
        assert!(of("sigma") > 0.0 && of("sigma") < 0.01, "{key}: {found}");
    }
    is_the_robot(&folder.path().join("on.toml"), 0.01);
    let page = std::fs::read_to_string(folder.path().join("calibrate-path.html")).unwrap();
    assert!(page.contains("What the filter has learned"));
    // What it takes is one run that was watched.
    let committed = root().join("tests/data");
    let optiodom = root().join("config/recordings/optiodom.toml");
    let of = ["path", optiodom.to_str().unwrap(), "--data", committed.to_str().unwrap(), "--online"];
    let (code, said) = calibrate_failing(folder.path(), &of);
    assert!(code == 2 && said.contains("choose one with --run"), "{said}");
    let one = ["--run", "circular/250620202104/run-01"];
    let (code, said) = calibrate_failing(folder.path(), &[&of[..], &one].concat());
    assert!(code == 1 && said.contains("has no fixes"), "{said}");
}

#[test]
fn the_gyro_of_a_recorded_rest_has_the_noise_of_the_simulated_one() {
    let folder = tempfile::tempdir().unwrap();
    recorded_drive(folder.path());
    let found = calibrate(folder.path(), &["rest", "drive.mcap", "--save", "g.toml"]);
    let gyro = &found["channels"][0];
    assert_eq!(gyro["sensor"], "gyro", "{found}");
    let scenario = Scenario::bundled("figure-eight").unwrap();
    let noise = scenario.sensor_noise();
    let (sigma, step) = (noise.gyro_rad_per_s, noise.gyro_resolution_rad_per_s);
    // White noise that is rounded; of 1200 readings its sigma is known to 2 %. The link's own unit smears the step by a thousandth.
    let found_sigma = number(gyro, "/noise");
    assert!((found_sigma / sigma - 1.0).abs() < 0.1, "{found_sigma} {sigma}");
    let rounded = number(gyro, "/noise_with_rounding");
    let expected = sigma.hypot(step / 12.0_f64.sqrt());
    assert!((rounded / expected - 1.0).abs() < 0.1, "{rounded}");
    assert!((number(gyro, "/step") / step - 1.0).abs() < 0.01, "{found}");
    assert!(number(gyro, "/rest_s") > 55.0, "{found}");
    let bias = number(gyro, "/bias").abs();
    assert!(bias < 5.0 * noise.gyro_bias_rad_per_s, "{bias}");
    let robot = RobotProfile::read(&folder.path().join("g.toml")).unwrap().robot;
    assert!((robot.noise.gyro_rad_per_s - found_sigma).abs() < 1e-12);
    let saved = robot.calibration.gyro_bias_rad_per_s.unwrap();
    assert!((saved.value - number(gyro, "/bias")).abs() < 1e-12);
    let page = std::fs::read_to_string(folder.path().join("calibrate-rest.html")).unwrap();
    assert!(page.contains("At rest") && page.contains("<img"));
}

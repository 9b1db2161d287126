//! `posebridge calibrate`: every way through the program, and what it promises.
//!
//! One set of recordings is committed (OptiOdom, MIT). The others are read where POSEBRIDGE_DATA says they are; without it their
//! figures are not looked at.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test stops where its set-up is broken")]

#[path = "support/calibrating.rs"]
mod calibrating;
mod support;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use calibrating::{calibrate, calibrate_failing, number};
use posebridge::config::RobotProfile;
use serde_json::Value;
use support::{GYRO_BESIDE_WHEELS, WHEELS_CSV, posebridge, root, stdout_of};

fn shared_data() -> Option<PathBuf> {
    std::env::var_os("POSEBRIDGE_DATA").map(PathBuf::from)
}

fn recording(name: &str) -> PathBuf {
    root().join("config/recordings").join(name)
}

fn calibrate_path(folder: &Path, descriptor: &Path, data: &Path, more: &[&str]) -> Value {
    let (descriptor, data) = (descriptor.to_str().unwrap(), data.to_str().unwrap());
    calibrate(folder, &[&["path", descriptor, "--data", data], more].concat())
}

#[test]
fn squares_of_the_simulated_robot_lose_nine_tenths_of_their_systematic_error() {
    let folder = tempfile::tempdir().unwrap();
    for seed in ["1", "2", "3"] {
        let found = calibrate(folder.path(), &["umbmark", "--sim", "--seed", seed]);
        let (before, after) = (number(&found, "/others/0"), number(&found, "/others/1"));
        assert!(after * 10.0 <= before, "seed {seed}: {before} m, then {after} m");
        let track_off = number(&found, "/track_scale/value") - number(&found, "/truth/0");
        assert!(track_off.abs() < 4.0 * number(&found, "/track_scale/sigma"), "{found}");
    }
    let page = std::fs::read_to_string(folder.path().join("calibrate-umbmark.html")).unwrap();
    assert!(page.contains("<img") && page.contains("systematic error"));
    let picture = folder.path().join("calibrate-umbmark.svg");
    assert!(std::fs::read_to_string(picture).unwrap().starts_with("<svg"));
}

#[test]
fn ends_that_a_person_typed_make_a_profile_that_a_station_reads() {
    let folder = tempfile::tempdir().unwrap();
    // The example of the equations: alpha = 0.02 and beta = 0.01 rad on a side of 4 m.
    let ends = "direction,x_mm,y_mm\n# first day\ncw,-240,-240\nccw,-80,80\n";
    std::fs::write(folder.path().join("ends.csv"), ends).unwrap();
    let args = ["umbmark", "--ends", "ends.csv", "--side-m", "4", "--save", "r.toml"];
    let found = calibrate(folder.path(), &args);
    assert!((number(&found, "/corner_rad") - 0.02).abs() < 1e-12);
    assert!((number(&found, "/bend_rad") - 0.01).abs() < 1e-12);
    let profile = std::fs::read_to_string(folder.path().join("r.toml")).unwrap();
    let mut lines = profile.lines();
    assert!(lines.any(|line| line.starts_with("# systematic error ") && line.ends_with(" 339.4 mm")), "{profile}");
    assert!(profile.contains("date = 2"));
    // The same reader as that of `run --robot`.
    let robot = RobotProfile::read(&folder.path().join("r.toml"));
    let robot = robot.unwrap().robot;
    // 0.112 * 90 / (90 - 1.1459).
    assert!((robot.track_width_m - 0.113_444_4).abs() < 1e-6, "{robot:?}");
    let difference = 2.0 * (robot.right_wheel_radius_m - robot.left_wheel_radius_m)
        / (robot.right_wheel_radius_m + robot.left_wheel_radius_m);
    // b / R with b = 0.112 and R = 400: what the brick steered by has this track.
    assert!((difference - 0.112 / 400.0).abs() < 1e-7, "{difference}");
}

/// Position rms, max and end of dead reckoning over runs of OptiOdom, in metres, by `replay`.
fn dead_reckoning(data: &Path, run: &str, robot: &Value) -> [f64; 3] {
    let keys = ["left_wheel_radius_m", "right_wheel_radius_m", "track_width_m"];
    let settings = keys.map(|key| format!("{key}={}", robot[key]));
    let args: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
    replay_optiodom(data, run, &args)
}

/// The same with other flags for the robot.
fn replay_optiodom(data: &Path, run: &str, robot: &[&str]) -> [f64; 3] {
    let folder = tempfile::tempdir().unwrap();
    let mut command = posebridge(folder.path());
    command
        .args(["replay", "--json", "--filter", "odometry", "--run", run])
        .arg(recording("optiodom.toml"))
        .arg("--data")
        .arg(data)
        .args(robot);
    let report: Value = serde_json::from_str(&stdout_of(&mut command)).unwrap();
    ["position_rms_m", "position_max_m", "position_end_m"].map(|key| report["estimators"][0][key].as_f64().unwrap())
}

#[test]
fn circles_alone_calibrate_as_well_as_the_published_calibration_on_other_drives() {
    let folder = tempfile::tempdir().unwrap();
    let committed = root().join("tests/data");
    let save = ["--save", "circles.toml"];
    let found = calibrate_path(folder.path(), &recording("optiodom.toml"), &committed, &save);
    assert_eq!(found["findings"].as_array().unwrap().len(), 0, "{found}");
    // README of the data: dead reckoning with the published calibration of the same circles; a twentieth on top.
    let published = [
        ("circular/250620202104", [0.0064, 0.0121, 0.0043]),
        ("square/230620202317", [0.0111, 0.0204, 0.0192]),
        ("square/231220200040", [0.0294, 0.0488, 0.0211]),
        ("free/030120210001", [0.0175, 0.0321, 0.0210]),
    ];
    let own = dead_reckoning(&committed, published[0].0, &found["robot"]);
    assert!(own[0] <= 1.05 * published[0].1[0], "{own:?}");
    let by_profile =
        replay_optiodom(&committed, published[0].0, &["--robot", folder.path().join("circles.toml").to_str().unwrap()]);
    assert_eq!(by_profile, own, "the profile is the robot");
    let Some(data) = shared_data() else { return };
    for (run, published) in &published[1..] {
        let ours = dead_reckoning(&data, run, &found["robot"]);
        for (ours, published) in ours.iter().zip(published) {
            assert!(*ours <= 1.05 * published, "{run}: {ours} m, published {published} m");
        }
    }
}

/// What a robot is tried on has taught it nothing.
#[test]
fn runs_to_try_on_take_no_part_in_the_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let optiodom = recording("optiodom.toml");
    let committed = root().join("tests/data");
    let find = |more: &[&str]| calibrate_path(folder.path(), &optiodom, &committed, more);
    let names = |found: &Value, list: &str| -> Vec<String> {
        let runs = found[list].as_array().unwrap().iter();
        runs.map(|run| run["run"].as_str().unwrap().to_owned()).collect()
    };
    let all = names(&find(&[]), "runs");
    assert!(all.len() > 1, "{all:?}");
    let last = all.last().unwrap().as_str();
    // Twice is once.
    let found = find(&["--try-on", last, "--try-on", last]);
    assert_eq!(names(&found, "runs"), all[..all.len() - 1]);
    assert_eq!(names(&found, "tried"), [last]);
    let (descriptor, data) = (optiodom.to_str().unwrap(), committed.to_str().unwrap());
    let taken = ["path", descriptor, "--data", data, "--run", last, "--try-on", last];
    let (code, said) = calibrate_failing(folder.path(), &taken);
    assert!(code == 2 && said.contains("--try-on takes them all"), "{said}");
}

#[test]
fn a_hurried_description_is_told_what_to_change() {
    // The committed recording, described as a person in a hurry would: columns exchanged, half the track.
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(recording("optiodom.toml")).unwrap();
    let text = text
        .replace("right = { column = 4", "right = { column = 5")
        .replace("left = { column = 5", "left = { column = 4")
        .replace("track_width_m = 0.2 ", "track_width_m = 0.1 ");
    let path = folder.path().join("hurried.toml");
    std::fs::write(&path, text).unwrap();
    let found = calibrate_path(folder.path(), &path, &root().join("tests/data"), &[]);
    assert_eq!(found["sanity"]["wiring"], "Swapped");
    assert_eq!(number(&found, "/sanity/track_factor"), 2.0);
    assert_eq!(number(&found, "/sanity/travel_factor"), 1.0);
    let said = found["findings"].to_string();
    assert!(said.contains("the wheels are swapped") && said.contains("half the distance"), "{said}");
    let track_m = number(&found, "/robot/track_width_m");
    assert!((track_m / 0.2 - 1.0).abs() < 0.02, "{track_m}");
}

#[test]
fn the_labyrinth_robot_is_told_of_its_swapped_wheels_and_its_half_track() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    // As the original description has it: right first, and half the track.
    let text = std::fs::read_to_string(recording("uwb-labyrinth.toml")).unwrap();
    let original = text
        .replace("left = 2\nright = 3", "left = 3\nright = 2")
        .replace("track_width_m = 0.16 ", "track_width_m = 0.0785 ");
    let path = folder.path().join("original.toml");
    std::fs::write(&path, original).unwrap();
    let found = calibrate_path(folder.path(), &path, &data, &[]);
    assert_eq!(found["sanity"]["wiring"], "Swapped");
    assert_eq!(number(&found, "/sanity/track_factor"), 2.0);
    let mended = calibrate_path(folder.path(), &recording("uwb-labyrinth.toml"), &data, &[]);
    assert_eq!(mended["sanity"]["is_sound"], true);
}

#[test]
fn the_lego_robot_has_another_track_than_its_course_says() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let lego = recording("lego-nxt-camera.toml");
    let find = |more: &[&str]| {
        let run = ["--run", "track-155mm"];
        calibrate_path(folder.path(), &lego, &data, &[&run[..], more].concat())
    };
    let track_mm = |found: &Value| 1e3 * number(found, "/robot/track_width_m");
    let held = track_mm(&find(&["--hold", "wheel-radius"]));
    assert!((held / 173.0 - 1.0).abs() < 0.01, "{held} mm");
    let free = find(&[]);
    let wheel_m =
        f64::midpoint(number(&free, "/robot/left_wheel_radius_m"), number(&free, "/robot/right_wheel_radius_m"));
    let count_mm = 1e3 * wheel_m.to_radians();
    assert!((track_mm(&free) / 180.0 - 1.0).abs() < 0.02, "{} mm", track_mm(&free));
    assert!((count_mm / 0.366 - 1.0).abs() < 0.02, "{count_mm} mm per count");
}

#[test]
fn the_wheel_size_of_the_tape_measured_robot_is_found() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let table = data.join("ev3-table/segments.csv");
    let found = calibrate(folder.path(), &["path", "--segments", table.to_str().unwrap()]);
    let scale = 1.0 + number(&found, "/numbers/radius_scale/value");
    assert!((scale - 0.92).abs() < 0.015, "{scale}");
}

#[test]
fn a_camera_is_calibrated_by_points_and_a_mistyped_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    // A camera of 4 mm per pixel that hangs straight, and one cross that was measured 10 cm off.
    let mut table = String::from("u,v,x_m,y_m\n");
    for (index, (u, v)) in
        [(0, 0), (300, 10), (290, 200), (10, 210), (150, 100), (80, 30), (220, 170)].into_iter().enumerate()
    {
        let slip_m = if index == 4 { 0.1 } else { 0.0 };
        let (x_m, y_m) = (0.004 * f64::from(u) + slip_m, 0.004 * f64::from(v));
        writeln!(table, "{u},{v},{x_m},{y_m}").unwrap();
    }
    std::fs::write(folder.path().join("points.csv"), table).unwrap();
    let found = calibrate(folder.path(), &["camera", "points.csv", "--save", "c.toml"]);
    assert_eq!(found["suspect"], 5, "{found}");
    let numbers: toml::Table = toml::from_str(&std::fs::read_to_string(folder.path().join("c.toml")).unwrap()).unwrap();
    assert_eq!(numbers["camera"]["homography"].as_array().unwrap().len(), 3);
}

#[test]
fn what_cannot_be_done_is_said_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("one.csv"), "direction,x_mm,y_mm\ncw,1,2\n").unwrap();
    let (code, said) = calibrate_failing(folder.path(), &["umbmark", "--ends", "one.csv"]);
    assert!(code == 2 && said.contains("--side-m"), "{said}");
    let (code, said) = calibrate_failing(folder.path(), &["umbmark", "--ends", "one.csv", "--side-m", "4"]);
    assert!(code == 2 && said.contains("squares driven counter-clockwise: 0 found"), "{said}");
    std::fs::write(folder.path().join("bad.csv"), "direction,x_mm,y_mm\nleft,1,2\n").unwrap();
    let (code, said) = calibrate_failing(folder.path(), &["umbmark", "--ends", "bad.csv", "--side-m", "4"]);
    assert!(code == 2 && said.contains("`bad.csv` line 2: `left` in column `direction`"), "{said}");
    let optiodom = recording("optiodom.toml");
    let (descriptor, data) = (optiodom.to_str().unwrap(), root().join("tests/data"));
    let data = data.to_str().unwrap();
    let path = ["path", descriptor, "--data", data];
    let (code, said) = calibrate_failing(folder.path(), &[&path[..], &["--against", "fixes"]].concat());
    assert!(code == 2 && said.contains("--against truth"), "{said}");
    let (code, said) = calibrate_failing(folder.path(), &[&path[..], &["--free", "tag=1"]].concat());
    assert!(code == 2 && said.contains("wheel-radius"), "{said}");
    let decimal_commas = "direction,x_mm,y_mm\ncw,-12,5,-20,1\n";
    std::fs::write(folder.path().join("commas.csv"), decimal_commas).unwrap();
    let commas = ["umbmark", "--ends", "commas.csv", "--side-m", "4"];
    let (code, said) = calibrate_failing(folder.path(), &commas);
    assert!(code == 2 && said.contains("`commas.csv` line 2") && said.contains("decimal points"), "{said}");
    let (code, said) = calibrate_failing(folder.path(), &["rest", descriptor, "--data", data]);
    assert!(code == 1 && said.contains("record a minute of rest"), "{said}");
}

#[test]
fn the_bias_of_a_gyro_at_rest_is_found_and_its_drive_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut table = String::from("t_s,left,right,gyro\n");
    for tenth in 0..900_u32 {
        let driven = tenth.saturating_sub(600);
        // A pattern without a mean: 0, 1, 2, -2, -1 steps.
        let pattern = [0.0, 1.0, 2.0, -2.0, -1.0][tenth as usize % 5];
        let rate = 0.02 + 0.001 * pattern + if driven > 0 { 0.5 } else { 0.0 };
        writeln!(table, "{},{driven},{},{rate}", f64::from(tenth) / 10.0, 3 * driven).unwrap();
    }
    std::fs::write(folder.path().join("wheels.csv"), table).unwrap();
    let text = GYRO_BESIDE_WHEELS.to_owned() + WHEELS_CSV;
    std::fs::write(folder.path().join("rest.toml"), text).unwrap();
    let found = calibrate(folder.path(), &["rest", "rest.toml", "--data", "."]);
    let gyro = &found["channels"][0];
    assert!((number(gyro, "/bias") - 0.02).abs() < 1e-5, "{found}");
    assert!((number(gyro, "/step") - 0.001).abs() < 1e-6, "{found}");
    // The mean square of the pattern is 2, of which rounding takes a twelfth.
    let white = 0.001 * (2.0 - 1.0 / 12.0_f64).sqrt();
    assert!((number(gyro, "/noise") / white - 1.0).abs() < 0.01, "{found}");
    let rest_s = number(gyro, "/rest_s");
    assert!((55.0..60.5).contains(&rest_s), "{found}");
}

/// Two descriptions of the same wheels.
#[test]
fn drives_of_different_robots_are_not_mixed() {
    let folder = tempfile::tempdir().unwrap();
    let mut table = String::from("t_s,left,right,gyro\n");
    for tenth in 0..50_u32 {
        let driven = tenth.saturating_sub(20);
        writeln!(table, "{},{driven},{driven},0", f64::from(tenth) / 10.0).unwrap();
    }
    std::fs::write(folder.path().join("wheels.csv"), table).unwrap();
    let text = GYRO_BESIDE_WHEELS.to_owned() + WHEELS_CSV;
    std::fs::write(folder.path().join("one.toml"), &text).unwrap();
    let wide = text.replace("track_width_m = 0.2", "track_width_m = 0.3").replace("rest\"", "wide\"");
    std::fs::write(folder.path().join("wide.toml"), wide).unwrap();
    let both = ["umbmark", "one.toml", "wide.toml", "--data", "."];
    let (code, said) = calibrate_failing(folder.path(), &both);
    let are_named = said.contains("`rest` and `wide` are described as different robots");
    assert!(code == 2 && are_named, "{said}");
    let tune = ["tune", "--recording", "one.toml", "--recording", "wide.toml", "--data", "."];
    let output = posebridge(folder.path()).args(tune).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && said.contains("different robots"), "{said}");
    // Nobody saw where they ended: another direction would not help.
    let (code, said) = calibrate_failing(folder.path(), &["umbmark", "one.toml", "--data", "."]);
    assert!(code == 1 && !said.contains("both directions"), "{said}");
}

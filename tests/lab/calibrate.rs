//! `posebridge calibrate` on simulated and typed squares, foreign recordings, and cameras.
//!
//! One set of recordings is committed (OptiOdom, MIT). The others are read where POSEBRIDGE_DATA says they are; without it their
//! figures are not looked at.

use std::path::Path;

use crate::support::{
    WHEELS_CSV, assert_refused, committed_data, descriptor, json, number, read_text, shared_data, write_text,
};
use posebridge::config::RobotProfile;
use serde_json::Value;

fn calibrate(folder: &Path, args: &[&str]) -> Value {
    json(folder, &[&["calibrate"], args].concat())
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
    let page = read_text(folder.path(), "calibrate-umbmark.html");
    assert!(page.contains("<img") && page.contains("systematic error"));
    assert!(read_text(folder.path(), "calibrate-umbmark.svg").starts_with("<svg"));
}

#[test]
fn ends_that_a_person_typed_make_a_profile_that_a_station_reads() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The example of the equations: alpha = 0.02 and beta = 0.01 rad on a side of 4 m.
    write_text(folder, "ends.csv", "direction,x_mm,y_mm\n# first day\ncw,-240,-240\nccw,-80,80\n");
    let found = calibrate(folder, &["umbmark", "--ends", "ends.csv", "--side-m", "4", "--save", "r.toml"]);
    assert!((number(&found, "/corner_rad") - 0.02).abs() < 1e-12);
    assert!((number(&found, "/bend_rad") - 0.01).abs() < 1e-12);
    let profile = read_text(folder, "r.toml");
    let mut lines = profile.lines();
    assert!(lines.any(|line| line.starts_with("# systematic error ") && line.ends_with(" 339.4 mm")), "{profile}");
    // The same reader as that of `run --robot`.
    let robot = RobotProfile::read(&folder.join("r.toml")).unwrap().robot;
    // 0.112 * 90 / (90 - 1.1459).
    assert!((robot.track_width_m - 0.113_444_4).abs() < 1e-6, "{robot:?}");
    let difference = 2.0 * (robot.right_wheel_radius_m - robot.left_wheel_radius_m)
        / (robot.right_wheel_radius_m + robot.left_wheel_radius_m);
    // b / R with b = 0.112 and R = 400: what the brick steered by has this track.
    assert!((difference - 0.112 / 400.0).abs() < 1e-7, "{difference}");
}

/// Position rms, max and end of dead reckoning over runs of OptiOdom, in metres, by `replay` with these flags for the robot.
fn dead_reckoning(data: &str, run: &str, robot: &[&str]) -> [f64; 3] {
    let folder = tempfile::tempdir().unwrap();
    let optiodom = descriptor("optiodom.toml");
    let replay = ["replay", "--filter", "odometry", "--run", run, &optiodom, "--data", data];
    let report = json(folder.path(), &[&replay, robot].concat());
    ["position_rms_m", "position_max_m", "position_end_m"]
        .map(|key| number(&report["estimators"][0], &format!("/{key}")))
}

#[test]
fn circles_alone_calibrate_as_well_as_the_published_calibration_on_other_drives() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (optiodom, committed) = (descriptor("optiodom.toml"), committed_data());
    let path = ["path", &optiodom, "--data", &committed];
    let found = calibrate(folder, &[&path[..], &["--save", "circles.toml"]].concat());
    assert_eq!(found["findings"].as_array().unwrap().len(), 0, "{found}");
    let keys = ["left_wheel_radius_m", "right_wheel_radius_m", "track_width_m"];
    let settings = keys.map(|key| format!("{key}={}", found["robot"][key]));
    let settings: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
    // README of the data: dead reckoning with the published calibration of the same circles; a twentieth on top.
    let published = [
        ("circular/250620202104", [0.0064, 0.0121, 0.0043]),
        ("square/230620202317", [0.0111, 0.0204, 0.0192]),
        ("square/231220200040", [0.0294, 0.0488, 0.0211]),
        ("free/030120210001", [0.0175, 0.0321, 0.0210]),
    ];
    let own = dead_reckoning(&committed, published[0].0, &settings);
    assert!(own[0] <= 1.05 * published[0].1[0], "{own:?}");
    let profile = folder.join("circles.toml").display().to_string();
    let by_profile = dead_reckoning(&committed, published[0].0, &["--robot", &profile]);
    assert_eq!(by_profile, own, "the profile is the robot");

    // What a robot is tried on has taught it nothing; twice is once.
    let names = |found: &Value, list: &str| -> Vec<String> {
        found[list].as_array().unwrap().iter().map(|run| run["run"].as_str().unwrap().to_owned()).collect()
    };
    let all = names(&found, "runs");
    let last = all.last().unwrap().as_str();
    let tried = calibrate(folder, &[&path[..], &["--try-on", last, "--try-on", last]].concat());
    assert_eq!(names(&tried, "runs"), all[..all.len() - 1]);
    assert_eq!(names(&tried, "tried"), [last]);

    let Some(data) = shared_data() else { return };
    for (run, published) in &published[1..] {
        let ours = dead_reckoning(data.to_str().unwrap(), run, &settings);
        for (ours, published) in ours.iter().zip(published) {
            assert!(*ours <= 1.05 * published, "{run}: {ours} m, published {published} m");
        }
    }
}

#[test]
fn a_hurried_description_is_told_what_to_change() {
    // The committed recording, described as a person in a hurry would: columns exchanged, half the track.
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(descriptor("optiodom.toml")).unwrap();
    let text = text
        .replace("right = { column = 4", "right = { column = 5")
        .replace("left = { column = 5", "left = { column = 4")
        .replace("track_width_m = 0.2 ", "track_width_m = 0.1 ");
    write_text(folder.path(), "hurried.toml", &text);
    let found = calibrate(folder.path(), &["path", "hurried.toml", "--data", &committed_data()]);
    assert_eq!(found["sanity"]["wiring"], "Swapped");
    assert_eq!(number(&found, "/sanity/track_factor"), 2.0);
    let findings = found["findings"].to_string();
    assert!(findings.contains("the wheels are swapped") && findings.contains("half the distance"), "{findings}");
    let track_m = number(&found, "/robot/track_width_m");
    assert!((track_m / 0.2 - 1.0).abs() < 0.02, "{track_m}");
}

#[test]
fn real_robots_are_what_their_data_sets_say() {
    let Some(data) = shared_data() else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let path = |descriptor: &str, more: &[&str]| {
        calibrate(folder, &[&["path", descriptor, "--data", data.to_str().unwrap()], more].concat())
    };
    // As its original description has it: right first, and half the track.
    let labyrinth = descriptor("uwb-labyrinth.toml");
    let original = std::fs::read_to_string(&labyrinth).unwrap();
    let original = original
        .replace("left = 2\nright = 3", "left = 3\nright = 2")
        .replace("track_width_m = 0.16 ", "track_width_m = 0.0785 ");
    write_text(folder, "original.toml", &original);
    let found = path("original.toml", &[]);
    assert_eq!(found["sanity"]["wiring"], "Swapped");
    assert_eq!(number(&found, "/sanity/track_factor"), 2.0);
    assert_eq!(path(&labyrinth, &[])["sanity"]["is_sound"], true);

    // The LEGO robot has another track than its course says.
    let lego = |more: &[&str]| path(&descriptor("lego-nxt-camera.toml"), &[&["--run", "track-155mm"], more].concat());
    let track_mm = |found: &Value| 1e3 * number(found, "/robot/track_width_m");
    let held_mm = track_mm(&lego(&["--hold", "wheel-radius"]));
    assert!((held_mm / 173.0 - 1.0).abs() < 0.01, "{held_mm} mm");
    let free = lego(&[]);
    let radii = ["left", "right"].map(|side| number(&free, &format!("/robot/{side}_wheel_radius_m")));
    let count_mm = 1e3 * f64::midpoint(radii[0], radii[1]).to_radians();
    assert!((track_mm(&free) / 180.0 - 1.0).abs() < 0.02, "{} mm", track_mm(&free));
    assert!((count_mm / 0.366 - 1.0).abs() < 0.02, "{count_mm} mm per count");

    // The wheel size of a robot that was measured with a tape.
    let table = data.join("ev3-table/segments.csv");
    let found = calibrate(folder, &["path", "--segments", table.to_str().unwrap()]);
    let scale = 1.0 + number(&found, "/numbers/radius_scale/value");
    assert!((scale - 0.92).abs() < 0.015, "{scale}");
}

/// Of a descriptor: a robot at rest with a gyro, whose column in `wheels.csv` is `gyro`; [`WHEELS_CSV`] belongs behind it.
const GYRO_BESIDE_WHEELS: &str = include_str!("../data/lab/gyro-beside-wheels.toml");

#[test]
fn what_cannot_be_done_is_said_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "one.csv", "direction,x_mm,y_mm\ncw,1,2\n");
    write_text(folder, "bad.csv", "direction,x_mm,y_mm\nleft,1,2\n");
    write_text(folder, "commas.csv", "direction,x_mm,y_mm\ncw,-12,5,-20,1\n");
    // Two descriptions of the same wheels.
    let rows = (0..50).map(|tenth: i32| format!("{},{1},{1},0\n", f64::from(tenth) / 10.0, (tenth - 20).max(0)));
    write_text(folder, "wheels.csv", &("t_s,left,right,gyro\n".to_owned() + &rows.collect::<String>()));
    let text = GYRO_BESIDE_WHEELS.to_owned() + WHEELS_CSV;
    write_text(folder, "own.toml", &text);
    let wide = text.replace("track_width_m = 0.2", "track_width_m = 0.3").replace("rest\"", "wide\"");
    write_text(folder, "wide.toml", &wide);
    let optiodom = format!("{} --data {}", descriptor("optiodom.toml"), committed_data());
    let run = "circular/250620202104/run-01";
    assert_refused(
        folder,
        &[
            ("calibrate umbmark --ends one.csv", 2, &["--side-m"]),
            ("calibrate umbmark --ends one.csv --side-m 4", 2, &["squares driven counter-clockwise: 0 found"]),
            ("calibrate umbmark --ends bad.csv --side-m 4", 2, &["`bad.csv` line 2: `left` in column `direction`"]),
            ("calibrate umbmark --ends commas.csv --side-m 4", 2, &["`commas.csv` line 2", "decimal points"]),
            (&format!("calibrate path {optiodom} --against fixes"), 2, &["--against truth"]),
            (&format!("calibrate path {optiodom} --free tag=1"), 2, &["wheel-radius"]),
            (&format!("calibrate path {optiodom} --run {run} --try-on {run}"), 2, &["--try-on takes them all"]),
            (&format!("calibrate path {optiodom} --online"), 2, &["choose one with --run"]),
            (&format!("calibrate path {optiodom} --online --run {run}"), 1, &["has no fixes, landmarks"]),
            (&format!("calibrate rest {optiodom}"), 1, &["record a minute of rest"]),
            ("calibrate umbmark own.toml wide.toml --data .", 2, &["`rest` and `wide`", "different robots"]),
            ("tune --recording own.toml --recording wide.toml --data .", 2, &["different robots"]),
            // Nobody saw where they ended.
            ("calibrate umbmark own.toml --data .", 1, &[]),
        ],
    );
}

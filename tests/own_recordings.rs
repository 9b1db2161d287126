//! What `identify`, `calibrate umbmark`, `lab thermometer` and `tune` make of recordings of ours and of a live robot, with the real
//! program.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::path::Path;

use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use support::{listening_brick, posebridge, stdout_of};
use virtual_drive::record_drive;

/// A lap of a square whose robot is off by what UMBmark finds, and its camera late by 0.15 s.
const SQUARE: &str = r#"
seed = 5
steering = "odometry"

[path.square]
side_m = 0.8
direction = "left"

[errors]
radius_error = 0.0
radius_error_sigma = 0.0
radius_mismatch = 0.006
radius_mismatch_sigma = 0.0
track_error = -0.02
track_error_sigma = 0.0

[gyro]
sigma_deg_per_s = 0.4
quantum_deg_per_s = 0.1

[camera]
latency_ms = 150.0
jitter_ms = 20.0
position_sigma_m = 0.006
reports_covariance = false
"#;

/// A thermometer that is quick enough for a test; the robot drives on while it settles.
const THERMOMETER: &str = r#"
seed = 3
[path.circle]
radius_m = 0.4
[drive]
laps = 2
[thermometer]
channel = "temp1"
rate_hz = 20.0
lags_s = [0.3, 1.0]
shares = [0.3, 0.7]
sigma_k = 0.03
resolution_k = 0.0625
before_c = 20.0
after_c = 48.7
dipped_at_s = 1.5
"#;

fn record(folder: &Path, name: &str, scenario: &str, rest_s: f64) {
    let scenario = Scenario::from_toml(scenario).unwrap();
    record_drive(&folder.join(name), scenario, TimeDelta::from_secs_f64(rest_s));
}

/// What the program finds, as its JSON says it.
fn found(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&stdout_of(posebridge(folder).args(args).arg("--json"))).unwrap()
}

/// How it ends where it cannot do what it was asked for, and what it says.
fn refusal(folder: &Path, args: &[&str]) -> (i32, String) {
    let output = posebridge(folder).args(args).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.code().unwrap(), said)
}

/// Value and sigma of a quantity that was identified.
fn quantity(found: &Value, name: &str) -> [f64; 2] {
    let quantities = found["quantities"].as_array().unwrap();
    let is_it = |one: &&Value| one["name"].as_str() == Some(name);
    let one = quantities.iter().find(is_it).unwrap();
    [one["value"].as_f64().unwrap(), one["sigma"].as_f64().unwrap_or(f64::NAN)]
}

#[test]
fn a_recorded_rest_and_a_recorded_side_tell_the_noise() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let coarse = SQUARE.replace("quantum_deg_per_s = 0.1", "quantum_deg_per_s = 1.0");
    record(folder, "square.mcap", &coarse, 300.0);
    let rest = ["identify", "rest", "--recording", "square.mcap", "--from", "60"];
    let rest = found(folder, &rest);
    let [noise, sigma] = quantity(&rest, "gyro_rad_per_s");
    let truth = 0.4_f64.to_radians();
    println!("gyro noise {noise} +- {sigma}, true {truth}");
    assert!((noise / truth - 1.0).abs() < 0.1, "{noise}");
    // The link carries it in a unit of its own, of which a step is 34.9.
    let [step, _] = quantity(&rest, "gyro_resolution_rad_per_s");
    assert!((step.to_degrees() - 1.0).abs() < 0.01, "{step}");
    // The first side: 0.8 m at 0.22 m/s after half a second at rest.
    let side = ["identify", "straight", "--recording", "square.mcap", "--from", "1.5", "--to", "3.5"];
    let [speed, _] = quantity(&found(folder, &side), "speed, left wheel");
    assert!((speed - 0.22).abs() < 0.01, "{speed}");
}

#[test]
fn a_recorded_camera_is_late_by_its_arrival_and_not_by_its_stamp() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "square.mcap", SQUARE, 1.0);
    let by = |clock: &str| {
        let delay = ["identify", "delay", "--recording", "square.mcap", "--by", clock];
        quantity(&found(folder, &delay), "delay of the camera")
    };
    let (arrival, stamp) = (by("arrival"), by("stamp"));
    println!("by arrival {arrival:?}, by stamp {stamp:?}");
    assert!((arrival[0] - 0.15).abs() < 0.015 + 2.0 * arrival[1], "{arrival:?}");
    assert!(stamp[0].abs() < 0.005 + 2.0 * stamp[1], "{stamp:?}");
    let asked = ["identify", "rest", "--recording", "square.mcap", "--run", "a"];
    let (code, said) = refusal(folder, &asked);
    assert!(code == 2 && said.contains("recording of ours"), "{said}");
}

#[test]
fn recorded_squares_in_both_directions_calibrate_the_wheels() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "ccw.mcap", SQUARE, 1.0);
    record(folder, "cw.mcap", &SQUARE.replace("\"left\"", "\"right\""), 1.0);
    let squares = ["calibrate", "umbmark", "ccw.mcap", "cw.mcap"];
    let both = found(folder, &squares);
    let value = |name: &str| both[name]["value"].as_f64().unwrap();
    println!("{both}");
    assert!((value("radius_difference") - 0.006).abs() < 0.0015);
    assert!((value("track_scale") + 0.02).abs() < 0.004);
    let (code, said) = refusal(folder, &["calibrate", "umbmark", "ccw.mcap"]);
    assert!(code == 1 && said.contains("so far: ccw.mcap"), "{said}");
    assert!(said.contains("clockwise"), "{said}");
}

#[test]
fn a_recorded_thermometer_foretells_another_run_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "one.mcap", THERMOMETER, 0.0);
    let other = THERMOMETER.replace("seed = 3", "seed = 4").replace("after_c = 48.7", "after_c = 61.0");
    record(folder, "two.mcap", &other, 0.0);
    let step = ["identify", "step", "--recording", "one.mcap", "--json"];
    let step = stdout_of(posebridge(folder).args(step));
    assert!(step.contains("one.mcap temp1"), "{step}");
    let lesson = ["lab", "thermometer", "--recording", "one.mcap", "two.mcap"];
    let lesson = stdout_of(posebridge(folder).args(lesson));
    println!("{lesson}");
    for run in ["one.mcap:temp1", "two.mcap:temp1"] {
        assert!(lesson.contains(run), "{lesson}");
    }
    let alone = ["lab", "thermometer", "--recording", "one.mcap"];
    let output = posebridge(folder).args(alone).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && said.contains("only run"), "{said}");
    let (code, said) = refusal(folder, &["lab", "thermometer", "--recording", "none.mcap"]);
    assert!(code == 2 && said.contains("none.mcap"), "{said}");
}

#[test]
fn recorded_drives_are_tuned_on_and_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "one.mcap", SQUARE, 0.0);
    record(folder, "two.mcap", &SQUARE.replace("seed = 5", "seed = 6"), 0.0);
    let tuned = found(
        folder,
        &[
            "tune",
            "--recording",
            "one.mcap",
            "--recording",
            "two.mcap",
            "--hold-out",
            "two",
            "--use-every",
            "2",
            "--param",
            "fix_position_m",
            "--start-factor",
            "10",
            "--out-profile",
            "tuned.toml",
        ],
    );
    let noise = &tuned["parameters"][0];
    println!("{noise}");
    assert!((noise["at_maximum"].as_f64().unwrap() / 0.006 - 1.0).abs() < 0.15);
    let held_out = |when: &str| tuned[when][1]["position_rms_m"].as_f64().unwrap();
    assert_eq!(tuned["after"][1]["name"], "two.mcap");
    assert!(held_out("after") < held_out("before"));
    assert!(folder.join("tuned.toml").exists());
}

#[test]
fn a_live_robot_is_recorded_and_its_recording_says_the_same_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "one.mcap", THERMOMETER, 0.0);
    let (_brick, url) = listening_brick(folder, THERMOMETER);
    let live = ["--link", &url, "--duration", "9", "--out", "out"];
    let foretold = ["lab", "thermometer", "--recording", "one.mcap"];
    let text = stdout_of(posebridge(folder).args(foretold).args(live));
    println!("{text}");
    assert!(text.contains("out/live.mcap:temp1"), "{text}");
    let again = ["identify", "delay", "--recording", "out/live.mcap"];
    let [delay_s, _] = quantity(&found(folder, &again), "delay of the camera");
    assert!((0.0..0.3).contains(&delay_s), "{delay_s}");
    // A recording is never made twice.
    for args in [
        &["identify", "rest"][..],
        &["identify", "straight"],
        &["identify", "delay"],
        &["calibrate", "umbmark"],
        &["lab", "thermometer"],
    ] {
        let all = [args, &live[..]].concat();
        let (code, said) = refusal(folder, &all);
        let is_told = said.contains("live.mcap` is there already");
        assert!(code == 2 && is_told, "{args:?}: {said}");
    }
}

//! `posebridge lab accuracy`: the promised keys, the picture, and the same result from the same seeds.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::path::Path;

use serde_json::Value;

use support::{posebridge, root, stdout_of};

/// What the experiment prints for these arguments; it must end well.
fn lab(folder: &Path, args: &[&str]) -> String {
    stdout_of(posebridge(folder).args(["lab", "accuracy"]).args(args))
}

fn object(folder: &Path, args: &[&str]) -> Value {
    let text = lab(folder, args);
    assert_eq!(text.lines().count(), 1, "one line: {text}");
    serde_json::from_str(&text).unwrap()
}

const TWO_RUNS: [&str; 5] = ["--scenario", "kicks-camera-1hz", "--runs", "2", "--json"];

#[test]
fn the_object_has_the_promised_keys_and_sensible_figures() {
    let folder = tempfile::tempdir().unwrap();
    let object = object(folder.path(), &TWO_RUNS);
    let scenarios = object["scenarios"].as_array().unwrap();
    assert_eq!(scenarios.len(), 1);
    assert_eq!(scenarios[0]["name"], "kicks-camera-1hz");
    assert_eq!(scenarios[0]["runs"], 2);
    let estimators = scenarios[0]["estimators"].as_array().unwrap();
    let names: Vec<&str> = estimators.iter().map(|estimator| estimator["name"].as_str().unwrap()).collect();
    assert!(names.contains(&"odometry") && names.contains(&"pose"));
    assert_eq!(names[names.len() - 3..], ["pose-true-geometry", "rts", "smooth"]);
    for estimator in estimators {
        for key in ["position_rms_m", "position_mean_m", "position_max_m", "heading_rms_rad", "anees"] {
            assert!(estimator[key].is_f64(), "{key} of {}", estimator["name"]);
        }
        assert_eq!(estimator["run_rms_m"].as_array().unwrap().len(), 2);
        assert_eq!(estimator["refused_runs"], Value::Array(vec![]));
    }
    let rms = |name: &str| {
        let index = names.iter().position(|known| *known == name).unwrap();
        estimators[index]["position_rms_m"].as_f64().unwrap()
    };
    // A camera once a second: millimetres, where dead reckoning that is kicked is decimetres off.
    assert!(rms("pose") < 0.02 && rms("odometry") > 0.05);
    let pose = &estimators[names.iter().position(|name| *name == "pose").unwrap()];
    let camera = pose["sources"].as_array().unwrap().iter().find(|source| source["name"] == "camera");
    assert!(camera.unwrap()["used"].as_u64().unwrap() > 100);
}

/// The two runs of camera-10hz on which the bars of the smoother and the bound are looked at, in millimetres.
#[test]
fn hindsight_is_better_than_the_filter_and_the_filter_is_near_the_bound() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--scenario", "camera-10hz", "--estimator", "pose", "--estimator", "smooth", "--runs", "2"];
    let report = object(folder.path(), &[&args[..], &["--json"]].concat());
    let scenario = &report["scenarios"][0];
    let bound_mm = 1e3 * scenario["bound_rms_m"].as_f64().unwrap();
    assert!(scenario["bound_note"].is_null());
    let rms_mm = |index: usize| 1e3 * scenario["estimators"][index]["position_rms_m"].as_f64().unwrap();
    let (pose_mm, smooth_mm) = (rms_mm(0), rms_mm(1));
    println!("pose {pose_mm:.3} mm, smooth {smooth_mm:.3} mm, bound {bound_mm:.3} mm");
    assert!((0.9..1.2).contains(&(pose_mm / bound_mm)));
    assert!(smooth_mm < 0.85 && smooth_mm < 0.7 * bound_mm);
    let table = lab(folder.path(), &args);
    assert!(table.lines().any(|line| line == format!("bound: {bound_mm:.2} mm rms")));
    assert!(table.contains(&format!("{:.2}", pose_mm / bound_mm)), "{table}");
}

#[test]
fn what_the_bound_leaves_out_is_said_and_so_is_why_there_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--scenario", "kicks", "--scenario", "wpilib", "--estimator", "odometry", "--runs", "1"];
    let report = object(folder.path(), &[&args[..], &["--json"]].concat());
    let (kicks, wpilib) = (&report["scenarios"][0], &report["scenarios"][1]);
    assert!(kicks["bound_rms_m"].as_f64().unwrap() > 0.0);
    assert_eq!(kicks["bound_note"], "without the kicks");
    assert!(wpilib["bound_rms_m"].is_null());
    let why = "the noise of the motion is not what a filter is told";
    assert_eq!(wpilib["bound_note"], why);
    let table = lab(folder.path(), &args);
    assert!(table.contains(&format!("\nno bound, {why}\n")), "{table}");
}

/// Wheels that slip by a thousand kilometres per metre lead the smoother to numbers that are none.
#[test]
fn a_run_of_which_the_smoother_says_nothing_is_named_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(root().join("config/scenarios/accuracy/no-camera.toml"));
    let slippery = text
        .unwrap()
        .replace("laps = 4", "laps = 1")
        .replace("wheel_travel_m_per_sqrt_m = 0.0008", "wheel_travel_m_per_sqrt_m = 1e6");
    std::fs::write(folder.path().join("slippery.toml"), slippery).unwrap();
    let args = ["--scenario", "slippery.toml", "--estimator", "smooth", "--runs", "2"];
    let report = object(folder.path(), &[&args[..], &["--json"]].concat());
    let smooth = &report["scenarios"][0]["estimators"][0];
    let refused = smooth["refused_runs"].as_array().unwrap();
    assert_eq!(refused.len(), 2, "{smooth}");
    assert_eq!((&refused[0]["run"], &refused[1]["run"]), (&0.into(), &1.into()));
    assert!(smooth["position_rms_m"].is_null());
    let reason = refused[0]["reason"].as_str().unwrap();
    let table = lab(folder.path(), &args);
    let said = format!("smooth: says nothing of 2 runs; of run 0: {reason}");
    // A long line breaks between words.
    assert!(table.replace('\n', " ").contains(&said), "{table}");
}

#[test]
fn the_same_seed_gives_the_same_text_and_another_one_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let only_odometry = ["--estimator", "odometry", "--scenario", "kicks", "--json"];
    let with = |more: &[&str]| lab(folder.path(), &[&only_odometry, more].concat());
    let first = with(&["--runs", "5"]);
    assert_eq!(first, with(&["--runs", "5"]));
    assert_ne!(first, with(&["--runs", "5", "--seed", "2"]));
    // The first run of five is the one run of one.
    let of_run = |text: &str| {
        let object: Value = serde_json::from_str(text).unwrap();
        object["scenarios"][0]["estimators"][0]["run_rms_m"][0].clone()
    };
    assert_eq!(of_run(&first), of_run(&with(&["--runs", "1"])));
}

#[test]
fn the_picture_goes_where_it_is_asked_and_a_file_may_be_the_scenario() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(root().join("config/scenarios/accuracy/unknown-heading.toml"));
    let short = text.unwrap().replace("duration_s = 20.0", "duration_s = 5.0");
    std::fs::write(folder.path().join("short.toml"), short).unwrap();
    let table = lab(folder.path(), &["--scenario", "short.toml", "--runs", "3", "--out", "pictures"]);
    assert!(table.contains("\nshort: 3 runs, seed 1\nestimator"), "{table}");
    let picture = std::fs::read_to_string(folder.path().join("pictures/lab-accuracy.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains("short: 3 runs"));
}

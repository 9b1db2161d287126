//! `posebridge lab accuracy`: the promised keys, the picture, and the same result from the same seeds.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;

use std::path::Path;

use serde_json::Value;

use support::{posebridge, root};

/// What the experiment prints for these arguments; it must end well.
fn lab(folder: &Path, args: &[&str]) -> String {
    let output = posebridge(folder)
        .args(["lab", "accuracy"])
        .args(args)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    String::from_utf8(output.stdout).unwrap()
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
    let names: Vec<&str> = estimators
        .iter()
        .map(|estimator| estimator["name"].as_str().unwrap())
        .collect();
    assert!(names.contains(&"odometry") && names.contains(&"pose"));
    assert_eq!(names.last(), Some(&"pose-true-geometry"));
    for estimator in estimators {
        for key in [
            "position_rms_m",
            "position_mean_m",
            "position_max_m",
            "heading_rms_rad",
            "anees",
        ] {
            assert!(estimator[key].is_f64(), "{key} of {}", estimator["name"]);
        }
        assert_eq!(estimator["run_rms_m"].as_array().unwrap().len(), 2);
    }
    let rms = |name: &str| {
        let index = names.iter().position(|known| *known == name).unwrap();
        estimators[index]["position_rms_m"].as_f64().unwrap()
    };
    // A camera once a second: millimetres, where dead reckoning that is kicked is decimetres off.
    assert!(rms("pose") < 0.02 && rms("odometry") > 0.05);
    let pose = &estimators[names.iter().position(|name| *name == "pose").unwrap()];
    let camera = pose["sources"]
        .as_array()
        .unwrap()
        .iter()
        .find(|source| source["name"] == "camera");
    assert!(camera.unwrap()["used"].as_u64().unwrap() > 100);
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
    let text =
        std::fs::read_to_string(root().join("config/scenarios/accuracy/unknown-heading.toml"));
    let short = text
        .unwrap()
        .replace("duration_s = 20.0", "duration_s = 5.0");
    std::fs::write(folder.path().join("short.toml"), short).unwrap();
    let table = lab(
        folder.path(),
        &[
            "--scenario",
            "short.toml",
            "--runs",
            "3",
            "--out",
            "pictures",
        ],
    );
    assert!(
        table.starts_with("short: 3 runs, seed 1\nestimator"),
        "{table}"
    );
    let picture = std::fs::read_to_string(folder.path().join("pictures/lab-accuracy.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains("short: 3 runs"));
}

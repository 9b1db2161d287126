//! `posebridge identify`: what the simulator was told is found again, with sigmas that cover.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;

use std::path::Path;

use serde_json::Value;
use support::{posebridge, stdout_of};

fn identify(folder: &Path, args: &[&str]) -> Vec<Value> {
    let text = stdout_of(posebridge(folder).arg("identify").args(args).arg("--json"));
    let object: Value = serde_json::from_str(&text).unwrap();
    object["quantities"].as_array().unwrap().clone()
}

/// Every quantity with a truth and a sigma, over five seeds: within a tenth, within three sigma, and most within two.
fn covers(what: &str, names: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let (mut all, mut within_two) = (0, 0);
    for seed in ["1", "2", "3", "4", "5"] {
        let found = identify(folder.path(), &[what, "--seed", seed]);
        for name in names {
            let quantity = found
                .iter()
                .find(|quantity| quantity["name"] == *name)
                .unwrap();
            let number = |key: &str| quantity[key].as_f64().unwrap();
            let (value, sigma, truth) = (number("value"), number("sigma"), number("truth"));
            assert!(
                (value - truth).abs() < 0.1 * truth,
                "{name}, seed {seed}: {value}, true {truth}"
            );
            assert!(
                (value - truth).abs() < 3.0 * sigma,
                "{name}, seed {seed}: {value} ± {sigma}, true {truth}"
            );
            within_two += i32::from((value - truth).abs() < 2.0 * sigma);
            all += 1;
        }
    }
    assert!(
        within_two * 10 >= all * 8,
        "{within_two} of {all} within two sigma"
    );
    assert!(folder.path().join(format!("identify-{what}.html")).exists());
}

#[test]
fn noise_and_bias_walk_of_a_gyro_at_rest_are_those_of_the_simulator() {
    covers(
        "rest",
        &["gyro_rad_per_s", "gyro_bias_walk_rad_per_s_sqrt_s"],
    );
    let folder = tempfile::tempdir().unwrap();
    let found = identify(folder.path(), &["rest"]);
    let step = found
        .iter()
        .find(|quantity| quantity["name"] == "gyro_resolution_rad_per_s")
        .unwrap();
    let (value, truth) = (
        step["value"].as_f64().unwrap(),
        step["truth"].as_f64().unwrap(),
    );
    assert!((value - truth).abs() < 1e-9, "{value} {truth}");
}

#[test]
fn the_delay_of_a_camera_is_that_of_the_simulator() {
    covers("delay", &["delay of the camera"]);
}

#[test]
fn by_its_stamps_the_simulated_camera_is_not_late() {
    let folder = tempfile::tempdir().unwrap();
    let found = identify(folder.path(), &["delay", "--by", "stamp"]);
    let (value, sigma) = (
        found[0]["value"].as_f64().unwrap(),
        found[0]["sigma"].as_f64().unwrap(),
    );
    assert!(
        value.abs() < 3.0 * sigma && sigma < 0.005,
        "{value} ± {sigma}"
    );
}

#[test]
fn the_speed_of_a_straight_run_is_as_rough_as_whole_counts_make_it() {
    let folder = tempfile::tempdir().unwrap();
    let found = identify(folder.path(), &["straight"]);
    // 0.08 m/s over 0.05 s on a radius of 28 mm: 8.185 counts of one degree. A share f of the intervals has one count more.
    let f = (0.08_f64 * 0.05 / 0.028).to_degrees().fract();
    let truth = (f * (1.0 - f)).sqrt() * 1.0_f64.to_radians() * 0.028 / 0.05;
    for wheel in ["left", "right"] {
        let name = format!("root of R, {wheel} wheel");
        let quantity = found
            .iter()
            .find(|quantity| quantity["name"] == name.as_str())
            .unwrap();
        let (value, sigma) = (
            quantity["value"].as_f64().unwrap(),
            quantity["sigma"].as_f64().unwrap(),
        );
        assert!(
            (value - truth).abs() < 0.1 * truth && (value - truth).abs() < 3.0 * sigma,
            "{value} {truth}"
        );
    }
}

#[test]
fn what_tells_nothing_says_why() {
    let folder = tempfile::tempdir().unwrap();
    for (args, code, wanted) in [
        (
            vec!["rest", "--from", "5", "--to", "4"],
            2,
            "nothing lies between them",
        ),
        (vec!["rest", "--to", "2"], 1, "100 are the least"),
        (vec!["delay", "--most", "0.1"], 1, "widen it with --most"),
        (vec!["straight", "--sim", "nowhere.toml"], 2, "nowhere.toml"),
    ] {
        let output = posebridge(folder.path())
            .arg("identify")
            .args(&args)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
        assert!(said.contains(wanted), "{args:?}: {said}");
    }
}

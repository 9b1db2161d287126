//! Real robots: the figures that the data sets' own documents give, reached through the program.
//!
//! One set is committed (OptiOdom, MIT). The others are read where POSEBRIDGE_DATA says they are; without it their figures are not
//! looked at, and this test stands on the committed set alone.
#![expect(clippy::expect_used, clippy::unwrap_used, reason = "a test stops where its set-up is broken")]

mod support;

use std::path::PathBuf;

use serde_json::Value;
use support::{posebridge, root, stdout_of};

/// Runs `replay --json` on a descriptor.
fn replay(descriptor: &str, data: &PathBuf, extra: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let path = root().join("config/recordings").join(descriptor);
    let printed =
        stdout_of(posebridge(folder.path()).arg("replay").arg(path).arg("--json").arg("--data").arg(data).args(extra));
    serde_json::from_str(&printed).expect("one JSON object")
}

fn estimator<'a>(report: &'a Value, name: &str) -> &'a Value {
    let all = report["estimators"].as_array().unwrap();
    all.iter().find(|estimator| estimator["name"] == name).expect("it was run")
}

/// Position rms, max, end in metres to four digits after the point and heading rms in degrees to two, as the tables print them.
fn printed(estimator: &Value) -> String {
    let metres = |key: &str| estimator[key].as_f64().unwrap();
    format!(
        "{:.4} / {:.4} / {:.4} / {:.2}",
        metres("position_rms_m"),
        metres("position_max_m"),
        metres("position_end_m"),
        metres("heading_rms_rad").to_degrees(),
    )
}

fn shared_data() -> Option<PathBuf> {
    std::env::var_os("POSEBRIDGE_DATA").map(PathBuf::from)
}

/// The published calibration from the circular set.
const CALIBRATION_C: [&str; 6] = [
    "--set",
    "track_width_m=0.200842",
    "--set",
    "right_wheel_radius_m=0.041671",
    "--set",
    "left_wheel_radius_m=0.041689",
];

#[test]
fn optiodom_dead_reckoning_equals_the_published_table_to_the_printed_digits() {
    let committed = root().join("tests/data");
    let circular = ["--run", "circular/"];
    let nominal = replay("optiodom.toml", &committed, &circular);
    assert_eq!(printed(estimator(&nominal, "odometry")), "0.0291 / 0.0457 / 0.0421 / 5.43");
    let calibrated = replay("optiodom.toml", &committed, &[&circular[..], &CALIBRATION_C].concat());
    assert_eq!(printed(estimator(&calibrated, "odometry")), "0.0064 / 0.0121 / 0.0043 / 0.92");
    let Some(data) = shared_data() else {
        println!("POSEBRIDGE_DATA is not set: only the committed set was looked at");
        return;
    };
    for (run, nominal, calibrated) in [
        ("square/230620202317", "0.0115 / 0.0223 / 0.0202 / 1.30", "0.0111 / 0.0204 / 0.0192 / 1.15"),
        ("square/231220200040", "0.0509 / 0.0834 / 0.0740 / 2.59", "0.0294 / 0.0488 / 0.0211 / 1.13"),
        ("free/030120210001", "0.0411 / 0.0718 / 0.0418 / 2.23", "0.0175 / 0.0321 / 0.0210 / 1.71"),
    ] {
        let by_metadata = replay("optiodom.toml", &data, &["--run", run]);
        assert_eq!(printed(estimator(&by_metadata, "odometry")), nominal, "{run}");
        let by_calibration = replay("optiodom.toml", &data, &[&["--run", run][..], &CALIBRATION_C].concat());
        assert_eq!(printed(estimator(&by_calibration, "odometry")), calibrated, "{run}");
    }
}

#[test]
fn withheld_camera_positions_are_predicted_within_the_promised_millimetres() {
    // Without the recordings: the committed set has no camera, so its dead reckoning by the flagship stands in.
    let committed = replay("optiodom.toml", &root().join("tests/data"), &["--run", "circular/"]);
    assert!(estimator(&committed, "pose")["position_rms_m"].as_f64().unwrap() < 0.030);
    let Some(data) = shared_data() else {
        println!("POSEBRIDGE_DATA is not set: the recordings with a camera were not looked at");
        return;
    };
    let lego = replay("lego-nxt-camera.toml", &data, &[]);
    let rms_m = estimator(&lego, "pose")["position_rms_m"].as_f64().unwrap();
    assert!(rms_m <= 0.016, "lego-nxt-camera, every 4th: {rms_m} m");
    let neato = replay("neato-gyro-camera.toml", &data, &["--run", "rotate_slip_a"]);
    let pose = estimator(&neato, "pose");
    let (rms_m, heading_rad) = (pose["position_rms_m"].as_f64().unwrap(), pose["heading_rms_rad"].as_f64().unwrap());
    assert!(rms_m <= 0.016, "neato rotate_slip_a: {rms_m} m");
    assert!(heading_rad.to_degrees() <= 1.2, "neato rotate_slip_a: {} degrees", heading_rad.to_degrees());
}

/// One committed run, where there is truth and no camera.
const ONE_RUN: &str = "circular/250620202104/run-01";

fn one_run() -> Value {
    replay("optiodom.toml", &root().join("tests/data"), &["--run", ONE_RUN])
}

/// The keys of an object, in the order of the alphabet.
fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<_> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

fn sorted<'a>(names: &[&'a str]) -> Vec<&'a str> {
    let mut names = names.to_vec();
    names.sort_unstable();
    names
}

#[test]
fn the_json_object_has_the_documented_keys_and_null_where_there_is_no_evidence() {
    let report = one_run();
    let documented = [
        "recording",
        "observations",
        "wall_seconds",
        "cpu_seconds",
        "recorded_seconds",
        "times_real_time",
        "changed",
        "estimators",
        "runs",
        "bad_rows",
        "smooth",
    ];
    assert_eq!(keys(&report), sorted(&documented));
    assert!(report["smooth"].is_null(), "not asked for");
    let pose = estimator(&report, "pose");
    let figures = ["position_rms_m", "position_max_m", "position_end_m", "heading_rms_rad", "anees"];
    let others = ["name", "sources", "position_rms_uncorrected_m", "calibration"];
    assert_eq!(keys(pose), sorted(&[&figures[..], &others].concat()));
    for figure in figures {
        assert!(pose[figure].is_f64(), "{figure}");
    }
    assert!(pose["position_rms_uncorrected_m"].is_null(), "no camera, no delay");
    assert!(estimator(&report, "odometry")["calibration"].is_null(), "dead reckoning learns nothing");
}

#[test]
fn each_source_of_the_json_object_has_the_documented_keys_and_counts() {
    let report = one_run();
    let source = &estimator(&report, "pose")["sources"][0];
    let counts = ["gated", "too_old", "malformed", "rebased", "reset_to", "unused", "degrees_of_freedom"];
    let others = ["name", "used", "slip", "mean_nis_per_dof", "consistency"];
    assert_eq!(keys(source), sorted(&[&counts[..], &others].concat()));
    assert_eq!(source["name"], "wheels");
    assert!(source["used"].as_u64().unwrap() > 1_000);
    for key in counts {
        assert_eq!(source[key], 0, "{key}");
    }
    assert_eq!(source["consistency"], "undetermined");
    assert!(source["mean_nis_per_dof"].is_null(), "wheels are an input: nothing is predicted");
}

#[test]
fn the_smoothed_path_has_the_documented_keys_and_without_fixes_it_is_dead_reckoning() {
    let report = replay("optiodom.toml", &root().join("tests/data"), &["--run", ONE_RUN, "--smooth"]);
    let by_run = &report["smooth"];
    assert_eq!(keys(by_run), [ONE_RUN]);
    let smooth = &by_run[ONE_RUN];
    let documented = [
        "position_rms_m",
        "position_max_m",
        "position_rms_uncorrected_m",
        "heading_rms_rad",
        "fixes_used",
        "fixes_left_out",
        "iterations",
        "seconds",
        "not_read",
        "reason",
    ];
    assert_eq!(keys(smooth), sorted(&documented));
    assert_eq!((&smooth["fixes_used"], &smooth["fixes_left_out"]), (&0.into(), &0.into()));
    let odometry = estimator(&report, "odometry");
    for figure in ["position_rms_m", "position_max_m", "heading_rms_rad"] {
        let (own, theirs) = (smooth[figure].as_f64().unwrap(), odometry[figure].as_f64().unwrap());
        assert!((own / theirs - 1.0).abs() < 1e-3, "{figure}: {own}, {theirs}");
    }
}

#[test]
fn every_shipped_descriptor_is_read_and_replayed_where_its_data_are() {
    let committed = root().join("tests/data");
    let data = shared_data();
    for entry in std::fs::read_dir(root().join("config/recordings")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let text = std::fs::read_to_string(root().join("config/recordings").join(&name)).unwrap();
        let descriptor = posebridge_recording::dataset::Descriptor::from_toml(&text).expect(&name);
        let place = if descriptor.name == "optiodom" { Some(&committed) } else { data.as_ref() };
        if let Some(place) = place {
            let report = replay(&name, place, &[]);
            assert!(report["observations"].as_u64().unwrap() > 0, "{name}");
        }
    }
}

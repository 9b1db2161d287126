//! Real robots: the figures that the data sets' own documents give, reached through the program.
//!
//! One set is committed (OptiOdom, MIT). The others are read where POSEBRIDGE_DATA says they are; without it their figures are not
//! looked at, and this test stands on the committed set alone.

use crate::support::{OPTIODOM_RUN, committed_data, descriptor, json, named, read_text, root, shared_data};
use posebridge_recording::dataset::Descriptor;
use serde_json::Value;

/// Runs `replay --json` on a bundled descriptor.
fn replay(name: &str, data: &str, extra: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    json(folder.path(), &[&["replay", &descriptor(name), "--data", data], extra].concat())
}

/// The same of one committed run, where there is truth and no camera.
fn replay_one_run(extra: &[&str]) -> Value {
    replay("optiodom.toml", &committed_data(), &[&["--run", OPTIODOM_RUN], extra].concat())
}

fn estimator<'a>(report: &'a Value, name: &str) -> &'a Value {
    named(&report["estimators"], name)
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
    let committed = committed_data();
    let circular = ["--run", "circular/"];
    let nominal = replay("optiodom.toml", &committed, &circular);
    assert_eq!(printed(estimator(&nominal, "odometry")), "0.0291 / 0.0457 / 0.0421 / 5.43");
    let calibrated = replay("optiodom.toml", &committed, &[&circular[..], &CALIBRATION_C].concat());
    assert_eq!(printed(estimator(&calibrated, "odometry")), "0.0064 / 0.0121 / 0.0043 / 0.92");
    let Some(data) = shared_data() else { return };
    let data = data.to_str().unwrap();
    for (run, nominal, calibrated) in [
        ("square/230620202317", "0.0115 / 0.0223 / 0.0202 / 1.30", "0.0111 / 0.0204 / 0.0192 / 1.15"),
        ("square/231220200040", "0.0509 / 0.0834 / 0.0740 / 2.59", "0.0294 / 0.0488 / 0.0211 / 1.13"),
        ("free/030120210001", "0.0411 / 0.0718 / 0.0418 / 2.23", "0.0175 / 0.0321 / 0.0210 / 1.71"),
    ] {
        let by_metadata = replay("optiodom.toml", data, &["--run", run]);
        assert_eq!(printed(estimator(&by_metadata, "odometry")), nominal, "{run}");
        let by_calibration = replay("optiodom.toml", data, &[&["--run", run][..], &CALIBRATION_C].concat());
        assert_eq!(printed(estimator(&by_calibration, "odometry")), calibrated, "{run}");
    }
}

#[test]
fn withheld_camera_positions_are_predicted_within_the_promised_millimetres() {
    // Without the recordings: the committed set has no camera, so its dead reckoning by the flagship stands in.
    let committed = replay("optiodom.toml", &committed_data(), &["--run", "circular/"]);
    assert!(estimator(&committed, "pose")["position_rms_m"].as_f64().unwrap() < 0.030);
    let Some(data) = shared_data() else { return };
    let data = data.to_str().unwrap();
    let lego = replay("lego-nxt-camera.toml", data, &[]);
    let rms_m = estimator(&lego, "pose")["position_rms_m"].as_f64().unwrap();
    assert!(rms_m <= 0.016, "lego-nxt-camera, every 4th: {rms_m} m");
    let neato = replay("neato-gyro-camera.toml", data, &["--run", "rotate_slip_a"]);
    let pose = estimator(&neato, "pose");
    let (rms_m, heading_rad) = (pose["position_rms_m"].as_f64().unwrap(), pose["heading_rms_rad"].as_f64().unwrap());
    assert!(rms_m <= 0.016, "neato rotate_slip_a: {rms_m} m");
    assert!(heading_rad.to_degrees() <= 1.2, "neato rotate_slip_a: {} degrees", heading_rad.to_degrees());
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
    let report = replay_one_run(&[]);
    let documented =
        ["recording", "observations", "wall_seconds", "cpu_seconds", "recorded_seconds", "times_real_time"];
    let others = ["changed", "estimators", "runs", "bad_rows", "smooth"];
    assert_eq!(keys(&report), sorted(&[&documented[..], &others].concat()));
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

    let source = &pose["sources"][0];
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
    let report = replay_one_run(&["--smooth"]);
    let by_run = &report["smooth"];
    assert_eq!(keys(by_run), [OPTIODOM_RUN]);
    let smooth = &by_run[OPTIODOM_RUN];
    let figures = ["position_rms_m", "position_max_m", "position_rms_uncorrected_m", "heading_rms_rad"];
    let others = ["fixes_used", "fixes_left_out", "iterations", "seconds", "not_read", "reason"];
    assert_eq!(keys(smooth), sorted(&[&figures[..], &others].concat()));
    assert_eq!((&smooth["fixes_used"], &smooth["fixes_left_out"]), (&0.into(), &0.into()));
    let odometry = estimator(&report, "odometry");
    for figure in ["position_rms_m", "position_max_m", "heading_rms_rad"] {
        let (own, theirs) = (smooth[figure].as_f64().unwrap(), odometry[figure].as_f64().unwrap());
        assert!((own / theirs - 1.0).abs() < 1e-3, "{figure}: {own}, {theirs}");
    }
}

#[test]
fn every_shipped_descriptor_is_read_and_replayed_where_its_data_are() {
    let data = shared_data();
    let folder = root().join("config/recordings");
    for entry in std::fs::read_dir(&folder).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let descriptor = Descriptor::from_toml(&read_text(&folder, &name)).expect(&name);
        let place = if descriptor.name == "optiodom" { Some(root().join("tests/data")) } else { data.clone() };
        if let Some(place) = place {
            let report = replay(&name, place.to_str().unwrap(), &[]);
            assert!(report["observations"].as_u64().unwrap() > 0, "{name}");
        }
    }
}

//! Real robots: the figures that the data sets' own documents give, reached through the program.
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

#[test]
fn without_fixes_the_smoothed_path_is_dead_reckoning() {
    let report = replay("optiodom.toml", &committed_data(), &["--run", OPTIODOM_RUN, "--smooth"]);
    let smooth = &report["smooth"][OPTIODOM_RUN];
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

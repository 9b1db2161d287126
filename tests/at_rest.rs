//! What `calibrate rest` and `identify rest` make of the same robot at rest, whose noise is known: the same, or a refusal.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::fmt::Write as _;
use std::path::Path;

use posebridge::config::RobotProfile;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::Value;
use support::{GYRO_BESIDE_WHEELS, WHEELS_CSV, posebridge, stdout_of};

/// Twenty rows a second: an instant in seconds, the counts of both wheels, the gyro in rad/s.
type Row = (f64, u32, f64);

/// Ten minutes of a robot that stands, whose gyro speaks so.
fn standing(gyro: impl FnMut(u32) -> f64) -> Vec<Row> {
    let mut gyro = gyro;
    let row = |k: u32| (f64::from(k) / 20.0, 0, gyro(k));
    (0..12_000).map(row).collect()
}

/// Noise of 0.45 degrees/s that is rounded to whole degrees/s, as a LEGO NXT hears a gyro.
fn rounding(seed: u64) -> impl FnMut(u32) -> f64 {
    let mut random = Pcg64::seed_from_u64(seed);
    move |_| {
        // Near enough a normal deviate.
        let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        (0.3 + 0.45 * normal).round().to_radians()
    }
}

fn write(folder: &Path, rows: &[Row]) {
    let mut table = String::from("t_s,left,right,gyro\n");
    for (at_s, counts, rate) in rows {
        writeln!(table, "{at_s},{counts},{counts},{rate}").unwrap();
    }
    std::fs::write(folder.join("wheels.csv"), table).unwrap();
    std::fs::write(folder.join("rest.toml"), GYRO_BESIDE_WHEELS.to_owned() + WHEELS_CSV).unwrap();
}

const CALIBRATE: [&str; 7] = ["calibrate", "rest", "rest.toml", "--data", ".", "--save", "robot.toml"];
const IDENTIFY: [&str; 6] = ["identify", "rest", "--recording", "rest.toml", "--data", "."];

fn found(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&stdout_of(posebridge(folder).args(args).arg("--json"))).unwrap()
}

fn refusal(folder: &Path, args: &[&str]) -> (i32, String) {
    let output = posebridge(folder).args(args).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    (output.status.code().unwrap(), said)
}

/// A quantity that was identified, and its sigma; `None` where it was not told from zero.
fn quantity(found: &Value, name: &str) -> Option<[f64; 2]> {
    let quantities = found["quantities"].as_array().unwrap();
    let one = quantities.iter().find(|one| one["name"] == name).unwrap();
    Some([one["value"].as_f64()?, one["sigma"].as_f64().unwrap_or(f64::NAN)])
}

fn has_note(found: &Value, wanted: &str) -> bool {
    let notes = found["notes"].as_array().unwrap().iter();
    notes.filter_map(Value::as_str).any(|note| note.contains(wanted))
}

#[test]
fn a_coarse_gyro_has_one_noise_and_its_rounding_is_counted_once() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, &standing(rounding(1)));
    let calibrated = found(folder, &CALIBRATE);
    let identified = found(folder, &IDENTIFY);
    let saved = RobotProfile::read(&folder.join("robot.toml")).unwrap().robot;
    let [noise, sigma] = quantity(&identified, "gyro_rad_per_s").unwrap();
    let truth = 0.45_f64.to_radians();
    println!("noise {noise} +- {sigma}, true {truth}; saved {:?}", saved.noise);
    assert!((noise - truth).abs() < 4.0 * sigma, "{noise} {sigma}");
    assert!(sigma < 0.02 * truth, "{sigma}");
    assert_eq!(saved.noise.gyro_rad_per_s, noise);
    assert_eq!(calibrated["channels"][0]["noise"], noise);
    let [step, _] = quantity(&identified, "gyro_resolution_rad_per_s").unwrap();
    assert!((step.to_degrees() - 1.0).abs() < 1e-6, "{step}");
    assert_eq!(saved.noise.gyro_resolution_rad_per_s, step);
    // A bias that does not walk leaves the walk that the robot had.
    assert_eq!(quantity(&identified, "gyro_bias_walk_rad_per_s_sqrt_s"), None);
    assert!(calibrated["channels"][0]["walk_per_sqrt_s"].is_null());
    let usual = posebridge::config::RobotNoise::default();
    assert_eq!(saved.noise.gyro_bias_walk_rad_per_s_sqrt_s, usual.gyro_bias_walk_rad_per_s_sqrt_s);
    let bias = saved.calibration.gyro_bias_rad_per_s.unwrap();
    assert!((bias.value.to_degrees() - 0.3).abs() < 0.02, "{bias:?}");
}

#[test]
fn a_gyro_that_never_changes_is_not_a_perfect_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(folder, &standing(|_| 3.0_f64.to_radians()));
    for args in [&CALIBRATE[..], &IDENTIFY] {
        let (code, said) = refusal(folder, args);
        assert!(code == 1 && said.contains("every sample is the same"), "{said}");
    }
    assert!(!folder.join("robot.toml").exists());
}

#[test]
fn a_robot_that_drives_does_not_rest() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut rows = standing(rounding(2));
    // It stands for the first five minutes.
    for (k, row) in rows.iter_mut().enumerate().skip(6_000) {
        row.1 = k as u32;
        row.2 += 0.5;
    }
    write(folder, &rows);
    let identified = found(folder, &IDENTIFY);
    let [bias, sigma] = quantity(&identified, "bias, mean over the rest").unwrap();
    assert!((bias.to_degrees() - 0.3).abs() < 0.05 && sigma < 0.01);
    assert!(has_note(&identified, "6009 more lie outside of rest"), "{identified}");
    let driven = [&IDENTIFY[..], &["--from", "310"]].concat();
    let (code, said) = refusal(folder, &driven);
    assert!(code == 1 && said.contains("never stood"), "{said}");
    // Nobody can say that of a gyro alone.
    let text = GYRO_BESIDE_WHEELS.to_owned() + WHEELS_CSV.split("[[wheels]]").next().unwrap();
    std::fs::write(folder.join("rest.toml"), text).unwrap();
    assert!(has_note(&found(folder, &IDENTIFY), "taken on trust"));
}

#[test]
fn a_silence_and_wild_stamps_stretch_no_interval_and_take_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let mut rows = standing(rounding(3));
    for row in &mut rows[6_000..] {
        row.0 += 100.0;
    }
    // The last five rows are in seconds since 1970.
    for row in &mut rows[11_995..] {
        row.0 += 1.7e9;
    }
    write(folder, &rows);
    let calibrated = found(folder, &CALIBRATE);
    let identified = found(folder, &IDENTIFY);
    let rest_s = calibrated["channels"][0]["rest_s"].as_f64().unwrap();
    assert!((rest_s - 599.3).abs() < 0.2, "{calibrated}");
    let [interval_s, _] = quantity(&identified, "sample interval").unwrap();
    assert!((interval_s - 0.05).abs() < 1e-6, "{interval_s}");
    assert!(has_note(&identified, "silent 2 time(s)"), "{identified}");
    let noise = quantity(&identified, "gyro_rad_per_s").unwrap()[0];
    assert!((noise.to_degrees() - 0.45).abs() < 0.03, "{noise}");
}

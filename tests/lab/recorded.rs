//! `calibrate`, `identify`, `tune` and `lab thermometer` on recordings of ours, which hold a simulated robot that is known.

use std::path::Path;

use crate::support::virtual_drive::record_drive;
use crate::support::{assert_refused, json, named, number, read_text, run};
use posebridge::config::RobotProfile;
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;

/// A lap of a square whose robot is off by what UMBmark finds, and its camera late by 0.15 s.
const SQUARE: &str = include_str!("../data/lab/square.toml");

/// A thermometer that is quick enough for a test; the robot drives on while it settles.
const THERMOMETER: &str = include_str!("../data/lab/thermometer.toml");

fn record(folder: &Path, name: &str, scenario: &str, rest_s: f64) {
    let scenario = Scenario::from_toml(scenario).unwrap();
    record_drive(&folder.join(name), scenario, TimeDelta::from_secs_f64(rest_s));
}

/// Value and sigma of a quantity that was identified.
fn quantity(found: &Value, name: &str) -> [f64; 2] {
    let one = named(&found["quantities"], name);
    [number(one, "/value"), one["sigma"].as_f64().unwrap_or(f64::NAN)]
}

/// By how much the wheels and the track of the simulated robot are off, as shares.
const OFF: [(&str, f64); 3] = [("radius_scale", 0.02), ("radius_difference", 0.008), ("track_scale", 0.04)];

/// A figure of eight by a robot that is not what its brick says, and a minute of rest.
fn recorded_eight() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = Scenario::bundled("figure-eight").unwrap().with_laps(2);
    [scenario.errors.radius_error, scenario.errors.radius_mismatch, scenario.errors.track_error] =
        OFF.map(|(_, off)| off);
    record_drive(&folder.path().join("drive.mcap"), scenario, TimeDelta::from_millis(60_000));
    folder
}

/// Whether a profile's robot is the simulated one, to a share of each number.
fn assert_is_the_robot(profile: &Path, share: f64) {
    let robot = RobotProfile::read(profile).unwrap().robot;
    let mean = f64::midpoint(robot.left_wheel_radius_m, robot.right_wheel_radius_m);
    let difference = (robot.right_wheel_radius_m - robot.left_wheel_radius_m) / mean;
    let found = [mean / 0.028 - 1.0, difference, robot.track_width_m / 0.112 - 1.0];
    for (found, (key, truth)) in found.into_iter().zip(OFF) {
        assert!((found - truth).abs() < share, "{key}: {found}, true {truth}");
    }
    assert!(!robot.adopt_description);
}

#[test]
fn a_drive_calibrates_the_robot_in_hindsight_and_by_what_its_filter_has_learned() {
    let folder = recorded_eight();
    let folder = folder.path();
    let path = ["calibrate", "path", "drive.mcap"];
    let found = json(folder, &[&path[..], &["--save", "r.toml"]].concat());
    assert_eq!(found["sanity"]["is_sound"], true, "{found}");
    // Two laps of six metres: the sigmas of wheels and track are some tenths of a per cent.
    assert_is_the_robot(&folder.join("r.toml"), 0.004);
    let online = json(folder, &[&path[..], &["--online", "--save", "on.toml"]].concat());
    assert_is_the_robot(&folder.join("on.toml"), 0.01);
    for (key, truth) in OFF {
        let of = |found: &Value, pointer: &str| {
            ["value", "sigma"].map(|part| number(found, &format!("{pointer}/{key}/{part}")))
        };
        let [value, sigma] = of(&found, "/numbers");
        println!("{key} {value:.5} +- {sigma:.5}, true {truth}");
        assert!((value - truth).abs() < 3.0 * sigma, "{key}: {found}");
        let [value, sigma] = of(&online, "/online");
        assert!((value - truth).abs() < 4.0 * sigma, "{key}: {online}");
        // Better known than the prior that the profile of the default robot gives: it has learned.
        assert!(sigma > 0.0 && sigma < 0.01, "{key}: {online}");
    }
    assert!(read_text(folder, "calibrate-path.html").contains("What the filter has learned"));
    // The profile goes over what the brick says of itself.
    json(folder, &["replay", "drive.mcap", "--robot", "r.toml"]);

    let wheel =
        json(folder, &["identify", "step", "--recording", "drive.mcap", "--channel", "left-wheel", "--to", "6"]);
    assert_eq!((&wheel["sensor"], &wheel["runs"][0]["way"]), (&"left wheel".into(), &"up".into()));
    // What a recording of ours cannot be asked for is said as it is.
    assert_refused(
        folder,
        &[
            ("identify step --recording drive.mcap --json", 2, &["left-wheel, right-wheel, turn-rate"]),
            ("calibrate path drive.mcap --against truth", 2, &["has no truth"]),
            ("calibrate path drive.mcap --try-on drive", 2, &["`drive.mcap` is one drive"]),
            ("calibrate path drive.mcap --truth-sigma-m 0.1", 2, &["compared with fixes"]),
            ("identify rest --recording drive.mcap --run a", 2, &["recording of ours"]),
        ],
    );
}

#[test]
fn a_rest_tells_the_gyros_noise_to_calibrate_and_to_identify_alike() {
    let folder = recorded_eight();
    let folder = folder.path();
    let found = json(folder, &["calibrate", "rest", "drive.mcap", "--save", "g.toml"]);
    let gyro = &found["channels"][0];
    assert_eq!(gyro["sensor"], "gyro", "{found}");
    let expected = Scenario::bundled("figure-eight").unwrap().sensor_noise();
    let (sigma, step) = (expected.gyro_rad_per_s, expected.gyro_resolution_rad_per_s);
    // White noise that is rounded; of 1200 readings its sigma is known to 2 %. The link's own unit smears the step by a thousandth.
    let [noise, with_rounding, found_step, rest_s, bias] =
        ["noise", "noise_with_rounding", "step", "rest_s", "bias"].map(|key| number(gyro, &format!("/{key}")));
    assert!((noise / sigma - 1.0).abs() < 0.1, "{noise} {sigma}");
    assert!((with_rounding / sigma.hypot(step / 12.0_f64.sqrt()) - 1.0).abs() < 0.1, "{with_rounding}");
    assert!((found_step / step - 1.0).abs() < 0.01 && rest_s > 55.0, "{found}");
    assert!(bias.abs() < 5.0 * expected.gyro_bias_rad_per_s, "{bias}");
    let robot = RobotProfile::read(&folder.join("g.toml")).unwrap().robot;
    // JSON is read to a unit in the last place.
    let is_saved = |saved: f64, found: f64| (saved / found - 1.0).abs() < 1e-15;
    assert!(is_saved(robot.noise.gyro_rad_per_s, noise));
    assert!(is_saved(robot.calibration.gyro_bias_rad_per_s.unwrap().value, bias));
    let page = read_text(folder, "calibrate-rest.html");
    assert!(page.contains("At rest") && page.contains("<img"));

    let coarse = SQUARE.replace("quantum_deg_per_s = 0.1", "quantum_deg_per_s = 1.0");
    record(folder, "square.mcap", &coarse, 300.0);
    let rest = json(folder, &["identify", "rest", "--recording", "square.mcap", "--from", "60"]);
    let [noise, _] = quantity(&rest, "gyro_rad_per_s");
    assert!((noise / 0.4_f64.to_radians() - 1.0).abs() < 0.1, "{noise}");
    let [step, _] = quantity(&rest, "gyro_resolution_rad_per_s");
    assert!((step.to_degrees() - 1.0).abs() < 0.01, "{step}");
    // The first side: 0.8 m at 0.22 m/s after half a second at rest.
    let side = json(folder, &["identify", "straight", "--recording", "square.mcap", "--from", "1.5", "--to", "3.5"]);
    let [speed, _] = quantity(&side, "speed, left wheel");
    assert!((speed - 0.22).abs() < 0.01, "{speed}");
}

#[test]
fn a_camera_is_late_by_its_arrival_and_not_by_its_stamp() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "square.mcap", SQUARE, 1.0);
    let [arrival, stamp] = ["arrival", "stamp"].map(|clock| {
        let found = json(folder, &["identify", "delay", "--recording", "square.mcap", "--by", clock]);
        quantity(&found, "delay of the camera")
    });
    println!("by arrival {arrival:?}, by stamp {stamp:?}");
    assert!((arrival[0] - 0.15).abs() < 0.015 + 2.0 * arrival[1], "{arrival:?}");
    assert!(stamp[0].abs() < 0.005 + 2.0 * stamp[1], "{stamp:?}");
}

#[test]
fn squares_in_both_directions_calibrate_the_wheels() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "ccw.mcap", SQUARE, 1.0);
    record(folder, "cw.mcap", &SQUARE.replace("\"left\"", "\"right\""), 1.0);
    let both = json(folder, &["calibrate", "umbmark", "ccw.mcap", "cw.mcap"]);
    println!("{both}");
    assert!((number(&both, "/radius_difference/value") - 0.006).abs() < 0.0015);
    assert!((number(&both, "/track_scale/value") + 0.02).abs() < 0.004);
    assert_refused(folder, &[("calibrate umbmark ccw.mcap", 1, &["so far: ccw.mcap", "clockwise"])]);
}

#[test]
fn a_thermometer_foretells_another_run_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "one.mcap", THERMOMETER, 0.0);
    let other = THERMOMETER.replace("seed = 3", "seed = 4").replace("after_c = 48.7", "after_c = 61.0");
    record(folder, "two.mcap", &other, 0.0);
    let step = run(folder, &["identify", "step", "--recording", "one.mcap", "--json"]);
    assert!(step.contains("one.mcap temp1"), "{step}");
    let lesson = run(folder, &["lab", "thermometer", "--recording", "one.mcap", "two.mcap"]);
    for run in ["one.mcap:temp1", "two.mcap:temp1"] {
        assert!(lesson.contains(run), "{lesson}");
    }
    let answer: Vec<&str> = lesson.lines().skip(2).take(2).collect();
    assert!(answer[0].starts_with("2 steps, each predicted from the others: in the median"), "{lesson}");
    let alone = run(folder, &["lab", "thermometer", "--recording", "one.mcap"]);
    assert!(alone.contains("by nothing"), "{alone}");
    let save = ["identify", "step", "--recording", "one.mcap", "--save", "sensor.toml", "--resolution", "0.0625"];
    run(folder, &save);
    let sensor: toml::Table = toml::from_str(&read_text(folder, "sensor.toml")).unwrap();
    let slow_lag_s = sensor["slow_lag_s"].as_float().unwrap();
    assert!((slow_lag_s - 1.0).abs() < 0.1, "{sensor}");
    // With what is known of the sensor more readings tell the end.
    let predictions = |more: &[&str]| {
        run(folder, &[&["replay", "two.mcap", "--events", "events.jsonl"], more].concat());
        let events = read_text(folder, "events.jsonl");
        let events = events.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        events.filter(|event| event["event"] == "temperature" && event["settled"].is_object()).count()
    };
    let (known, unknown) = (predictions(&["--sensor", "sensor.toml"]), predictions(&[]));
    println!("{known} predictions with a description, {unknown} without");
    assert!(known > unknown);
    assert_refused(
        folder,
        &[
            ("lab thermometer --recording none.mcap", 2, &["none.mcap"]),
            ("identify step --recording one.mcap --channel left-wheel --save s.toml", 2, &["--save", "thermometer"]),
            ("replay two.mcap --sensor none.toml", 2, &["none.toml"]),
        ],
    );
}

#[test]
fn drives_are_tuned_on_and_held_out() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder, "one.mcap", SQUARE, 0.0);
    record(folder, "two.mcap", &SQUARE.replace("seed = 5", "seed = 6"), 0.0);
    let tune = "tune --recording one.mcap --recording two.mcap --hold-out two --use-every 2 --param fix_position_m \
                --start-factor 10 --out-profile tuned.toml";
    let tuned = json(folder, &tune.split_whitespace().collect::<Vec<_>>());
    let at_maximum = number(&tuned, "/parameters/0/at_maximum");
    println!("{at_maximum} m, true 0.006 m");
    assert!((at_maximum / 0.006 - 1.0).abs() < 0.15);
    assert_eq!(tuned["after"][1]["name"], "two.mcap");
    // The filter learns the noise of a camera by itself, so that the positions hardly depend on what it is told.
    assert!(number(&tuned, "/proposed/1/log_likelihood") > number(&tuned, "/before/1/log_likelihood"));
    assert!(number(&tuned, "/after/1/position_rms_m") <= number(&tuned, "/before/1/position_rms_m"));
    assert!(folder.join("tuned.toml").exists());
}

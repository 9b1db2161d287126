//! `posebridge lab thermometer`: page, pictures and numbers of the simulated sensor, and predictions on recorded steps.
//!
//! The recordings of real sensors are read where POSEBRIDGE_DATA says they are; without it recordings of simulated ones stand in.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "helpers outside #[test] stop where the set-up is broken, and show the figures that they check"
)]

mod support;

use std::path::{Path, PathBuf};

use posebridge_lab::identification::simulated::{SimulatedSensor, step_input};
use serde_json::Value;

use support::{posebridge, root, stdout_of};

const THERMOMETER: [&str; 2] = ["lab", "thermometer"];

fn json(folder: &Path, args: &[&str]) -> Value {
    let text = stdout_of(posebridge(folder).args(THERMOMETER).arg("--json").args(args));
    serde_json::from_str(&text).unwrap()
}

fn number(object: &Value, section: &str, name: &str) -> Option<f64> {
    object["sections"][section][name].as_f64()
}

#[test]
fn the_simulated_lesson_leaves_a_page_with_pictures_and_the_same_numbers_each_time() {
    let folder = tempfile::tempdir().unwrap();
    let few = ["--runs", "20", "--seed", "3", "--out", "made/here"];
    let object = json(folder.path(), &few);
    let two = number(&object, "worked_example", "two_samples_known_q").unwrap();
    assert_eq!(format!("{two:.6}"), "3.000000");
    assert!(number(&object, "three_ways", "kalman_difference").unwrap() < 1e-9);
    assert_eq!(object["sections"].as_object().unwrap().len(), 13);
    assert_eq!(json(folder.path(), &few), object);
    let made = folder.path().join("made/here");
    let page = std::fs::read_to_string(made.join("lab-thermometer.html")).unwrap();
    for title in ["The worked example: 21, 15, 11", "Do the bounds hold?", "Data with a trend"] {
        assert!(page.contains(title), "{title}");
    }
    assert!(!page.contains("NaN"));
    let picture = std::fs::read_to_string(made.join("lab-thermometer-1.svg")).unwrap();
    assert!(picture.starts_with("<svg"));
    let tables = stdout_of(posebridge(folder.path()).args(THERMOMETER).args(few));
    assert!(tables.contains("3.000000"), "{tables}");
}

/// A recording of three simulated thermometers of one kind, and of one that never moves.
fn write_recording(folder: &Path) -> PathBuf {
    let lags = [
        ("one", [(2.5, 0.30), (16.0, 0.70)]),
        ("two", [(3.0, 0.40), (14.0, 0.60)]),
        ("three", [(3.6, 0.35), (18.0, 0.65)]),
    ];
    let write = |name: &str, sensor: &SimulatedSensor, to: f64| {
        let samples = sensor.run(7, 280, step_input(20.0, to, 20.0));
        let rows = samples.iter().map(|sample| format!("{},{}\n", sample.at_s, sample.value));
        let text = "t_s,celsius\n".to_owned() + &rows.collect::<String>();
        std::fs::write(folder.join(format!("{name}.csv")), text).unwrap();
    };
    for (index, (name, lags)) in lags.into_iter().enumerate() {
        let sensor = SimulatedSensor { lags: lags.to_vec(), sigma: 0.05, resolution: 0.0, period_s: 0.5 };
        write(name, &sensor, 3.0 + index as f64);
    }
    write("idle", &SimulatedSensor::first_order(5.0, 0.05, 0.5), 20.0);
    write_descriptor(folder, &["one", "two", "three", "idle"], 0.05)
}

/// Of runs that are each a file of seconds and degrees, with this noise.
fn write_descriptor(folder: &Path, runs: &[&str], sigma_k: f64) -> PathBuf {
    let first = runs[0];
    let descriptor = folder.join("thermometers.toml");
    let text = format!(
        r#"
name = "thermometers"
source = "this test"
licence = "none needed"
default_run = "{first}"
[robot]
name = "bench"
left_wheel_radius_m = 0.03
right_wheel_radius_m = 0.03
track_width_m = 0.1
ticks_per_turn = 360.0
[robot.noise]
temperature_k = {sigma_k}
[[runs]]
name = "{{each}}"
each = {runs:?}
[files.log]
path = "{{each}}.csv"
header_lines = 1
time = {{ column = "t_s" }}
[[temperature]]
file = "log"
temperature = "celsius"
"#
    );
    std::fs::write(&descriptor, text).unwrap();
    descriptor
}

/// Whether a run was predicted faster than the sensor showed it, to each of these shares of the step.
fn check_faster(object: &Value, run: &str, shares: &[&str]) {
    for share in shares {
        let of = |what: &str| number(object, "predicted", &format!("{run}.{what}_{share}_percent_s"));
        let (shown_s, predicted_s) = (of("shown"), of("predicted"));
        println!("{run}, {share} %: shown {shown_s:?} s, predicted {predicted_s:?} s");
        let predicted_s = predicted_s.unwrap();
        assert!(shown_s.is_none_or(|shown_s| predicted_s < shown_s), "{run} {share}");
    }
}

#[test]
fn recorded_sensors_are_predicted_by_others_of_their_kind() {
    let folder = tempfile::tempdir().unwrap();
    let descriptor = write_recording(folder.path());
    let names = ["one", "two", "three"];
    let mut args = vec!["--recording", descriptor.to_str().unwrap(), "--identify"];
    args.extend(names);
    args.push("--predict");
    args.extend(names);
    let object = json(folder.path(), &args);
    for name in names {
        assert_eq!(number(&object, "predicted", &format!("{name}.order")), Some(2.0));
        check_faster(&object, name, &["10", "5", "2"]);
    }
    let page = std::fs::read_to_string(folder.path().join("lab-thermometer.html")).unwrap();
    assert!(page.contains("two, by one and three"));
}

/// What it says and with which code it ends.
fn refused(folder: &Path, args: &[&str]) -> (Option<i32>, String) {
    let output = posebridge(folder).args(THERMOMETER).args(args).output().unwrap();
    assert!(output.stdout.is_empty());
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn what_cannot_be_done_is_said_with_the_run_and_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let descriptor = write_recording(folder.path());
    let descriptor = descriptor.to_str().unwrap();
    let recording = ["--recording", descriptor];
    for (args, code, words) in [
        (&["--identify", "four"][..], 2, "no such run; there are: one, two, three, idle"),
        (&["--identify", "one", "--predict", "one"], 2, "cannot be predicted by itself"),
        (&["--identify", "one", "--predict", "idle"], 1, "run `idle`"),
    ] {
        let (found, said) = refused(folder.path(), &[&recording[..], args].concat());
        assert_eq!(found, Some(code), "{said}");
        assert!(said.contains(words), "{words}: {said}");
    }
    let (code, said) = refused(folder.path(), &["--recording", "nowhere.toml"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("nowhere.toml"), "{said}");
    let (code, _) = refused(folder.path(), &["--identify", "one"]);
    assert_eq!(code, Some(2), "--identify needs a recording");
}

fn on_recording(name: &str, args: &[&str]) -> Option<Value> {
    let Some(data) = std::env::var_os("POSEBRIDGE_DATA") else {
        println!("POSEBRIDGE_DATA is not set: {name} was not looked at");
        return None;
    };
    let folder = tempfile::tempdir().unwrap();
    let descriptor = root().join("config/recordings").join(name);
    let text = stdout_of(
        posebridge(folder.path())
            .args(THERMOMETER)
            .arg("--json")
            .arg("--recording")
            .arg(descriptor)
            .arg("--data")
            .arg(data)
            .args(args),
    );
    Some(serde_json::from_str(&text).unwrap())
}

/// Each device by the two others: the order is the tool's own choice, and it is faster than the sensor.
#[test]
fn real_thermometers_are_predicted_by_others_of_their_kind() {
    let Some(object) = on_recording("ds18b20-step.toml", &[]) else {
        return;
    };
    for name in ["LG", "KM", "KiS"] {
        check_faster(&object, name, &["10", "5", "2"]);
    }
}

/// A probe in warm water, heated in one run and judged on the other.
#[test]
fn a_real_probe_is_known_within_a_second_of_heating() {
    let heating = ["heating-20-56", "heating-21-76"];
    for (by, judged) in [(0, 1), (1, 0)] {
        let (by, judged) = (heating[by], heating[judged]);
        let args = ["--same-sensor", "--identify", by, "--predict", judged];
        let Some(object) = on_recording("rtd-step.toml", &args) else {
            return;
        };
        check_faster(&object, judged, &["10", "5"]);
        let settled_s = number(&object, "predicted", &format!("{judged}.predicted_5_percent_s"));
        assert!(settled_s.unwrap() <= 1.0, "{judged}: {settled_s:?}");
    }
}

/// By default, as one of a kind and with the cooling run among the others.
#[test]
fn a_real_probe_of_a_kind_is_known_within_a_second_of_heating() {
    let heating = ["heating-20-56", "heating-21-76"];
    let Some(object) = on_recording("rtd-step.toml", &[&["--predict"][..], &heating[..]].concat()) else {
        return;
    };
    for judged in heating {
        check_faster(&object, judged, &["10", "5"]);
        let settled = format!("{judged}.predicted_5_percent_s");
        let settled_s = number(&object, "predicted", &settled).unwrap();
        assert!(settled_s <= 1.0, "{judged}: {settled_s}");
    }
}

/// What one run of cooling is worth. There is but one, so that every second sample of it stands in for another run: the same dynamics,
/// other noise.
#[test]
fn a_real_probe_that_cools_is_known_within_two_seconds_if_cooling_was_identified() {
    let Some(data) = std::env::var_os("POSEBRIDGE_DATA") else {
        println!("POSEBRIDGE_DATA is not set: the cooling run was not looked at");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let log = std::fs::read_to_string(Path::new(&data).join("rtd-step/rtd_log8.csv")).unwrap();
    for (first, name) in ["even", "odd"].into_iter().enumerate() {
        let rows = log.lines().skip(1 + first).step_by(2).map(|row| {
            let (at_s, volts) = row.split_once(',').unwrap();
            // The line of config/recordings/rtd-step.toml.
            let celsius = 3_077.120_671 * volts.parse::<f64>().unwrap() + 114.844_118;
            format!("{at_s},{celsius}\n")
        });
        let text = "t_s,celsius\n".to_owned() + &rows.collect::<String>();
        std::fs::write(folder.path().join(format!("{name}.csv")), text).unwrap();
    }
    let descriptor = write_descriptor(folder.path(), &["even", "odd"], 1.2);
    let args = ["--same-sensor", "--recording", descriptor.to_str().unwrap()];
    let object = json(folder.path(), &args);
    for name in ["even", "odd"] {
        check_faster(&object, name, &["10", "5", "2"]);
        let settled_s = number(&object, "predicted", &format!("{name}.predicted_5_percent_s"));
        assert!(settled_s.unwrap() <= 2.0, "{name}: {settled_s:?}");
        assert!(number(&object, "predicted", &format!("{name}.inside")).unwrap() > 0.9);
    }
}

/// The other way, of which no run was identified.
#[test]
fn a_real_probe_that_cools_is_predicted_by_runs_that_heat() {
    let args = ["--identify", "heating-20-56", "heating-21-76", "--predict", "cooling-55-21"];
    let Some(object) = on_recording("rtd-step.toml", &args) else {
        return;
    };
    check_faster(&object, "cooling-55-21", &["10", "5", "2"]);
    assert!(number(&object, "predicted", "cooling-55-21.inside").unwrap() > 0.9);
}

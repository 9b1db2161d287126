//! `posebridge lab wall`: the paper's figures, the drive found from simulated steps, the stops before the wall, and a recording whose
//! readings are foretold.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::Value;

use support::{posebridge, root, stdout_of};

fn object(folder: &Path, args: &[&str]) -> Value {
    let text = stdout_of(posebridge(folder).args(["lab", "wall", "--json"]).args(args));
    serde_json::from_str(&text).unwrap()
}

/// What the program says when it cannot start.
fn refusal(folder: &Path, args: &[&str]) -> String {
    let mut command = posebridge(folder);
    let output = command.args(["lab", "wall"]).args(args).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    String::from_utf8(output.stderr).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn is_near(found: &Value, expected: f64, share: f64) {
    let found = number(found);
    assert!((found / expected - 1.0).abs() <= share, "{found} is not {expected} to {share}");
}

#[test]
fn the_papers_figures_and_the_simulated_steps_give_d_and_m() {
    let folder = tempfile::tempdir().unwrap();
    for seed in ["1", "2", "3"] {
        let found = object(folder.path(), &["--runs", "1", "--seed", seed]);
        // Per metre, the paper counts in millimetres: 8.1633e-4 and 3.5346e-4.
        is_near(&found["paper"]["drag_s_per_m"], 0.816_33, 0.01);
        is_near(&found["paper"]["mass_s2_per_m"], 0.353_46, 0.01);
        is_near(&found["fit"]["drag_s_per_m"], 0.816_33, 0.02);
        is_near(&found["fit"]["mass_s2_per_m"], 0.353_46, 0.02);
        // One step alone knows how little it knows.
        let one = &found["fit_of_first"];
        let off = number(&one["drag_s_per_m"]) - 0.816_33;
        assert!(off.abs() < 3.5 * number(&one["drag_sigma_s_per_m"]));
        assert!(number(&one["drag_sigma_s_per_m"]) > 3.0 * number(&found["fit"]["drag_sigma_s_per_m"]));
    }
}

/// The rows of the approaches with these properties, in the order of the table.
fn rows<'a>(found: &'a Value, gains: &str, on: &str, most_pwm: f64) -> Vec<&'a Value> {
    let rows = found["approaches"].as_array().unwrap().iter();
    rows.filter(|row| row["gains"] == gains && row["on"] == on && row["most_pwm"] == most_pwm).collect()
}

fn by<'a>(rows: &[&'a Value], name: &str) -> &'a Value {
    rows.iter().find(|row| row["distance_by"] == name).unwrap()
}

#[test]
fn with_the_filter_the_car_stops_near_the_target_and_nearer_and_faster_than_by_a_line() {
    let folder = tempfile::tempdir().unwrap();
    for (seed, runs) in [("1", 100), ("2", 300)] {
        let count = runs.to_string();
        let args = ["--steps", "20", "--seed", seed, "--runs", &count];
        let found = object(folder.path(), &args);
        let line = by(&rows(&found, "tuned", "brick", 80.0), "line through two");
        let fast = rows(&found, "tuned", "brick", 255.0);
        for name in ["range-kf", "range-kf-corrected"] {
            let filter = by(&fast, name);
            println!("seed {seed}, {name}: {filter}");
            assert_eq!(filter["stopped"], runs);
            assert!(number(&filter["worst_error_m"]) <= 0.02, "{filter}");
            // At least 95 of 100.
            let share = |key: &str| number(&filter[key]) / f64::from(runs);
            assert!(share("nearer_than_line") >= 0.95, "{filter}");
            assert!(share("nearer_and_faster_than_line") >= 0.95, "{filter}");
            let speed = |row: &Value| number(&row["mean_approach_m_per_s"]);
            assert!(speed(filter) > 1.1 * speed(line));
            assert!(number(&filter["mean_time_s"]) < number(&line["mean_time_s"]));
        }
    }
}

#[test]
fn a_filter_on_the_host_is_as_good_as_its_link() {
    let folder = tempfile::tempdir().unwrap();
    let near = |link: &str, on: &str, name: &str| {
        let args = ["--steps", "20", "--runs", "40", "--profile", link];
        let found = object(folder.path(), &args);
        let row = by(&rows(&found, "tuned", on, 80.0), name)["near"].clone();
        row.as_u64().unwrap()
    };
    let clean = near("none", "host", "range-kf-corrected");
    let slow = near("bluetooth-spp", "host", "range-kf-corrected");
    let slow_line = near("bluetooth-spp", "host", "line through two");
    println!("within 20 mm of 40: clean {clean}, Bluetooth {slow}, line over Bluetooth {slow_line}");
    assert!(clean >= 39);
    assert!(slow < clean && slow > slow_line + 5);
}

#[test]
fn validation_and_gate_show_what_the_papers_sigmas_do() {
    let folder = tempfile::tempdir().unwrap();
    let found = object(folder.path(), &["--runs", "1"]);
    let of = |process_m: f64, key: &str| {
        let rows = found["validation"].as_array().unwrap().iter();
        let mut rows = rows.filter(|row| row["process_m"] == process_m && row["filter"] == "range-kf");
        number(&rows.next().unwrap()[key])
    };
    assert!(of(0.01, "gain") < of(0.05, "gain") && of(0.05, "gain") > 0.95);
    assert!(of(0.5, "gain") > 0.999 && of(0.5, "gate_m") > 3.0);
    assert!(of(0.05, "predicted_share") > 0.774);
    let gate = found["gate"].as_array().unwrap();
    assert_eq!(gate.first().unwrap()["refused"], false);
    assert_eq!(gate.last().unwrap()["refused"], true);
    assert_eq!(gate.last().unwrap()["jumped_m"], 0.0);
}

#[test]
fn the_same_seed_gives_the_same_page_and_everything_is_in_it() {
    let folder = tempfile::tempdir().unwrap();
    let run = |out: &str, seed: &str| {
        let args = ["--steps", "3", "--runs", "2", "--seed", seed, "--out", out];
        let text = stdout_of(posebridge(folder.path()).args(["lab", "wall"]).args(args));
        let page = std::fs::read_to_string(folder.path().join(out).join("lab-wall.html")).unwrap();
        (text, page)
    };
    let (text, page) = run("a", "5");
    assert_eq!((text.clone(), page.clone()), run("b", "5"));
    assert_ne!(text, run("c", "6").0);
    assert!(!page.contains("src=\"http") && page.matches("<img").count() == 3);
    for picture in 1..=3 {
        let path = folder.path().join(format!("a/lab-wall-{picture}.svg"));
        assert!(std::fs::read_to_string(path).unwrap().starts_with("<svg"));
    }
    for word in ["range-kf-corrected", "v_ss", "gate", "bluetooth-spp"] {
        assert!(text.contains(word) && page.contains(word), "{word}");
    }
}

#[test]
fn mistakes_are_named_with_file_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let scene = std::fs::read_to_string(root().join("config/scenarios/lab/wall.toml")).unwrap();
    let wrong = scene.replace("rise_90_s = 0.997", "rise_90_s = -1");
    std::fs::write(folder.path().join("wrong.toml"), wrong).unwrap();
    let said = refusal(folder.path(), &["--scene", "wrong.toml"]);
    for word in ["wrong.toml", "line 7", "rise_90_s", "-1"] {
        assert!(said.contains(word), "{word} in {said}");
    }
    let said = refusal(folder.path(), &["--profile", "carrier-pigeon"]);
    assert!(said.contains("carrier-pigeon") && said.contains("bluetooth-spp"), "{said}");
    let said = refusal(folder.path(), &["--run", "x"]);
    assert!(said.contains("--recording"), "{said}");
    let said = refusal(folder.path(), &["--recording", "none.toml"]);
    assert!(said.contains("none.toml"), "{said}");
}

/// A car of 1.5 m/s and 0.6 s from 3 m, half a second after its program begins; somebody's filter that lags behind the readings.
fn recording(folder: &Path) {
    let mut text = "t_ms,tof_mm,pwm,kf_mm\n".to_owned();
    let mut filtered = 3_000.0;
    let mut reading = 3_000.0;
    for turn in 0..200_u32 {
        let t_s = 0.01 * f64::from(turn);
        let driven_s = (t_s - 0.5).max(0.0);
        if turn % 10 == 0 {
            let way_mm = 1_500.0 * (driven_s - 0.6 * (1.0 - (-driven_s / 0.6).exp()));
            // Noise that repeats: 0, 12, -12 mm.
            reading = 3_000.0 - way_mm + [0.0, 12.0, -12.0][(turn / 10 % 3) as usize];
            filtered += 0.4 * (reading - filtered);
        }
        let pwm = if turn < 50 { 0 } else { 80 };
        writeln!(text, "{},{reading:.0},{pwm},{filtered:.1}", 10 * turn).unwrap();
    }
    std::fs::write(folder.join("approach.csv"), text).unwrap();
    let descriptor = std::fs::read_to_string(root().join("config/recordings/tof-wall.toml")).unwrap();
    let robot = descriptor.split("[[runs]]").next().unwrap();
    let robot = robot.replace("robotA-80-step", "approach");
    let streams = "[[runs]]\nname = \"approach\"\n\n[files.log]\npath = \"approach.csv\"\nheader_lines = 1\n\
        time = { column = \"t_ms\", unit = \"ms\" }\n\n[[wall_range]]\nfile = \"log\"\n\
        range = { column = \"tof_mm\", unit = \"mm\" }\nonly_changes = true\n";
    std::fs::write(folder.join("car.toml"), robot + streams).unwrap();
}

#[test]
fn a_recordings_readings_are_foretold_better_than_by_a_line_and_by_its_own_filter() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let found = object(folder.path(), &["--recording", "car.toml"]);
    let run = &found["runs"][0];
    assert_eq!(run["input"], "recorded");
    for side in ["against_line", "against_theirs"] {
        let score = &run[side];
        println!("{side}: {score}");
        assert!(score["readings"].as_u64().unwrap() >= 15);
        assert!(number(&score["filter_rms_m"]) < 0.8 * number(&score["other_rms_m"]), "{side}");
    }
    is_near(&run["fit"]["steady_m_per_s"], 1.5, 0.05);
    let page = folder.path().join("lab-wall.html");
    assert!(std::fs::read_to_string(page).unwrap().contains("their own filter"));
}

#[test]
fn a_column_that_is_not_there_is_named_with_those_that_are() {
    let folder = tempfile::tempdir().unwrap();
    recording(folder.path());
    let args = ["--recording", "car.toml", "--kalman-column", "filtered"];
    let said = refusal(folder.path(), &args);
    assert!(said.contains("`filtered`") && said.contains("kf_mm"), "{said}");
    let said = refusal(folder.path(), &["--recording", "car.toml", "--run", "b"]);
    assert!(said.contains("approach"), "{said}");
}

/// Students' cars: every run is foretold better than by a line, and better than their own filter where they recorded one.
#[test]
fn on_recordings_of_real_cars_the_filter_foretells_best() {
    let Some(data) = std::env::var_os("POSEBRIDGE_DATA").map(PathBuf::from) else {
        return println!("POSEBRIDGE_DATA is not set: the cars' recordings were not looked at");
    };
    let folder = tempfile::tempdir().unwrap();
    let descriptor = root().join("config/recordings/tof-wall.toml");
    let args = ["--recording", descriptor.to_str().unwrap(), "--data", data.to_str().unwrap()];
    let found = object(folder.path(), &args);
    let runs = found["runs"].as_array().unwrap();
    assert!(runs.len() >= 6);
    let mut theirs = 0;
    for run in runs {
        let score = &run["against_line"];
        println!("{}: {score}, theirs {}", run["name"], run["against_theirs"]);
        assert!(number(&score["filter_rms_m"]) < number(&score["other_rms_m"]), "{}", run["name"]);
        let score = &run["against_theirs"];
        if !score.is_null() {
            theirs += 1;
            assert!(number(&score["filter_rms_m"]) < number(&score["other_rms_m"]), "{}", run["name"]);
        }
    }
    assert!(theirs >= 1);
}

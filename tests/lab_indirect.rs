//! `posebridge lab indirect`: how near the rounds of the square end, by wheels, with accelerometers, with a gyro.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::path::Path;

use serde_json::Value;

use support::{posebridge, root, stdout_of};

fn object(folder: &Path, args: &[&str]) -> Value {
    let mut command = posebridge(folder);
    let text = stdout_of(command.args(["lab", "indirect", "--json"]).args(args));
    serde_json::from_str(&text).unwrap()
}

fn row<'a>(found: &'a Value, filter: &str, sensors: &str) -> &'a Value {
    let mut rows = found["rows"].as_array().unwrap().iter();
    rows.find(|row| row["filter"] == filter && row["sensors"] == sensors).unwrap()
}

fn number(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap()
}

#[test]
fn the_fused_ends_are_the_papers_and_better_than_the_wheels() {
    let folder = tempfile::tempdir().unwrap();
    let found = object(folder.path(), &["--runs", "200"]);
    let wheels = row(&found, "odometry", "wheels");
    let [forward, back] = ["indirect", "indirect-feedback"].map(|filter| row(&found, filter, "+ accelerometers"));
    for row in [wheels, forward, back] {
        println!("{row}");
    }
    for fused in [forward, back] {
        assert!(number(fused, "median_m") < number(wheels, "median_m"));
        assert!(number(fused, "rms_x_m") < number(wheels, "rms_x_m"));
        assert!(number(fused, "rms_y_m") < number(wheels, "rms_y_m"));
        assert!(fused["nearer_than_wheels"].as_u64().unwrap() > 120);
    }
    // 95 % of the rounds end within the paper's 23.5 cm and 32 cm.
    assert!(number(back, "p95_x_m") <= 0.235);
    assert!(number(back, "p95_y_m") <= 0.32);
    // Fed back it is nearer, and knows how near.
    let squares = |row: &Value| number(row, "rms_x_m").powi(2) + number(row, "rms_y_m").powi(2);
    assert!(squares(back) < squares(forward));
    assert!((0.7..1.3).contains(&number(back, "anees")));
    assert!(number(forward, "anees") > number(back, "anees"));
    // Round by round, in means of squares and their sigmas: nearer in x, and in y no further off; with a gyro nearer in both.
    let better = |sensors: &str, axis: &str| {
        let gain = &row(&found, "indirect-feedback", sensors)["better_than_feed_forward_m2"];
        number(gain, axis) / number(gain, &format!("{axis}_sigma"))
    };
    assert!(better("+ accelerometers", "x") > 2.0);
    assert!(better("+ accelerometers", "y") > -2.0);
    assert!(better("+ gyro", "x") > 2.0 && better("+ gyro", "y") > 2.0);
}

#[test]
fn the_same_seed_gives_the_same_and_the_page_holds_the_tracks() {
    let folder = tempfile::tempdir().unwrap();
    let run = |out: &str, seed: &str| {
        let args = ["--runs", "3", "--seed", seed, "--out", out];
        stdout_of(posebridge(folder.path()).args(["lab", "indirect"]).args(args))
    };
    let first = run("a", "7");
    assert_eq!(first, run("b", "7"));
    assert_ne!(first, run("c", "8"));
    let page = std::fs::read_to_string(folder.path().join("a/lab-indirect.html")).unwrap();
    assert!(page.matches("<img").count() == 2 && page.contains("indirect-feedback"));
    let tracks = std::fs::read_to_string(folder.path().join("a/lab-indirect-1.svg")).unwrap();
    assert!(tracks.contains(">true</text>"));
}

#[test]
fn a_scenario_may_be_a_file_and_its_mistakes_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(root().join("config/scenarios/lab/indirect.toml")).unwrap();
    let write = |name: &str, from: &str, to: &str| {
        assert!(text.contains(from));
        std::fs::write(folder.path().join(name), text.replace(from, to)).unwrap();
    };
    write("small.toml", "side_m = 3.0", "side_m = 0.5");
    let found = object(folder.path(), &["--scenario", "small.toml", "--runs", "4"]);
    assert!(number(row(&found, "odometry", "wheels"), "median_m") < 0.1);
    write("wrong.toml", "tick_deg = 1.0", "tick_deg = 0.0");
    let mut command = posebridge(folder.path());
    let args = ["lab", "indirect", "--scenario", "wrong.toml"];
    let output = command.args(args).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("wrong.toml") && said.contains("tick_deg"), "{said}");
}

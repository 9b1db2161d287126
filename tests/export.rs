//! `posebridge export`, `import` and telemetry logs as recordings, with the real program.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;
#[path = "support/trajectory.rs"]
mod trajectory;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::path::Path;

use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use support::{posebridge, root, stdout_of};
use trajectory::{trajectory, worst_distance};
use virtual_drive::{record_drive, record_drive_and_truth};

/// A short drive with a camera.
const SQUARE: &str = r#"
seed = 5
[path.square]
side_m = 0.5
direction = "left"
"#;

/// One run of a real robot with truth, which lies beside the tests.
const RUN: &str = "circular/250620202104/run-01";

fn drive(folder: &Path) {
    let scenario = Scenario::from_toml(SQUARE).unwrap();
    record_drive(&folder.join("drive.mcap"), scenario, TimeDelta::ZERO);
}

fn run(folder: &Path, args: &[&str]) -> String {
    stdout_of(posebridge(folder).args(args))
}

fn json(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&run(folder, args)).unwrap()
}

/// The header and the number of lines behind it.
fn csv(path: &Path) -> (String, usize) {
    let text = std::fs::read_to_string(path).unwrap();
    let header = text.lines().next().unwrap().to_owned();
    let columns = header.split(',').count();
    for line in text.lines().filter(|line| !line.contains('"')) {
        assert_eq!(line.split(',').count(), columns, "{line}");
    }
    (header, text.lines().count() - 1)
}

/// What the sender with this component id has sent.
fn frames_of(found: &Value, component: u64) -> u64 {
    let mut sources = found["sources"].as_array().unwrap().iter();
    let source = sources.find(|source| source["component"] == component);
    source.unwrap()["frames"].as_u64().unwrap()
}

/// A folder with a drive, and in `out` its tables and its telemetry log.
fn exported_drive() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    drive(folder.path());
    let command = ["export", "drive.mcap", "--format", "csv,tlog", "--out", "out"];
    run(folder.path(), &command);
    folder
}

#[test]
fn a_drive_becomes_tables_with_units() {
    let folder = exported_drive();
    let out = folder.path().join("out");
    let (header, estimates) = csv(&out.join("estimates.csv"));
    assert!(header.starts_with("t_s,x_m,y_m,heading_rad,"), "{header}");
    let (_, fused) = csv(&out.join("fusion.csv"));
    assert!(estimates > 500 && fused > 500, "{estimates} {fused}");
    for name in ["wheel_angles", "turn_rate", "fix", "links", "sources", "clock", "events"] {
        assert!(csv(&out.join(format!("{name}.csv"))).1 > 0, "{name}");
    }
}

#[test]
fn an_exported_log_holds_what_came_and_what_is_sent() {
    let folder = exported_drive();
    let out = folder.path().join("out");
    let replayed = json(folder.path(), &["replay", "drive.mcap", "--json"]);
    let found = json(folder.path(), &["inspect", "out/drive.tlog", "--json"]);
    assert_eq!(found["bytes_outside"], 0);
    assert_eq!(found["times_backwards"], 0);
    let sources = found["sources"].as_array().unwrap();
    let addresses: Vec<(u64, u64)> = sources
        .iter()
        .map(|source| {
            assert_eq!(source["lost"], 0, "{source}");
            (source["system"].as_u64().unwrap(), source["component"].as_u64().unwrap())
        })
        .collect();
    assert!(addresses.contains(&(1, 1)) && addresses.contains(&(1, 197)), "{addresses:?}");
    let ticks = found["messages"].as_array().unwrap().iter();
    let ticks: u64 = ticks
        .filter(|message| message["name"] == "PB_WHEEL_TICKS")
        .map(|message| message["frames"].as_u64().unwrap())
        .sum();
    let wheels = csv(&out.join("wheel_angles.csv")).1 as u64;
    assert!(ticks >= wheels && ticks < wheels + 20, "{ticks} frames, {wheels} observations");
    assert!(replayed["observations"].as_u64().unwrap() > wheels);
    let original = json(folder.path(), &["inspect", "drive.mcap", "--json"]);
    assert_eq!(original["kind"], "posebridge");
    assert_eq!(original["bytes_outside"], 0);
    assert_eq!(frames_of(&original, 1), frames_of(&found, 1));
}

#[test]
fn a_log_replays_as_close_to_the_drive_as_its_times_allow() {
    let folder = tempfile::tempdir().unwrap();
    drive(folder.path());
    run(folder.path(), &["export", "drive.mcap", "--format", "tum,tlog", "--out", "out"]);
    run(folder.path(), &["export", "out/drive.tlog", "--format", "tum", "--out", "again"]);
    let live = trajectory(&folder.path().join("out/estimate.tum"));
    let again = trajectory(&folder.path().join("again/estimate.tum"));
    let (compared, worst_m) = worst_distance(&live, &again);
    assert!(compared > live.len() / 2, "{compared} of {}", live.len());
    assert!(worst_m < 0.005, "{worst_m} m");
}

#[test]
fn an_imported_log_is_the_recording_that_a_replay_of_the_log_sees() {
    let folder = tempfile::tempdir().unwrap();
    drive(folder.path());
    run(folder.path(), &["export", "drive.mcap", "--format", "tlog"]);
    run(folder.path(), &["import", "drive.tlog", "--out", "imported.mcap"]);
    run(folder.path(), &["replay", "drive.tlog", "--events", "log.txt"]);
    run(folder.path(), &["replay", "imported.mcap", "--events", "imported.txt"]);
    let events = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    assert!(events("log.txt").lines().count() > 1_000);
    assert!(events("log.txt") == events("imported.txt"));
    // What is there already is not touched.
    let again = posebridge(folder.path()).args(["import", "drive.tlog", "--out", "imported.mcap"]).output().unwrap();
    assert_eq!(again.status.code(), Some(2));
}

/// The error between the two trajectories of a folder is that of a replay.
fn trajectories_score_as(scored: &Value, folder: &Path) {
    let estimate = trajectory(&folder.join("estimate.tum"));
    let truth = trajectory(&folder.join("truth.tum"));
    assert_eq!(estimate.len(), truth.len());
    let pairs = estimate.iter().zip(&truth);
    let squares = pairs.map(|(ours, theirs)| {
        assert_eq!(ours.0, theirs.0, "pairs have one stamp");
        (ours.1 - theirs.1).powi(2) + (ours.2 - theirs.2).powi(2)
    });
    let rms_m = (squares.sum::<f64>() / truth.len() as f64).sqrt();
    let expected_m = scored["estimators"][0]["position_rms_m"].as_f64().unwrap();
    assert!((rms_m / expected_m - 1.0).abs() < 1e-4, "{rms_m} m, {expected_m} m");
}

#[test]
fn trajectories_of_a_recording_hold_the_truth_that_it_knows() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = Scenario::from_toml(SQUARE).unwrap();
    record_drive_and_truth(&folder.join("drive.mcap"), scenario, TimeDelta::ZERO);
    run(folder, &["export", "drive.mcap", "--format", "tum"]);
    let scored = json(folder, &["replay", "drive.mcap", "--json"]);
    trajectories_score_as(&scored, folder);
}

#[test]
fn trajectories_of_a_foreign_recording_score_as_the_replay_does() {
    let folder = tempfile::tempdir().unwrap();
    let descriptor = root().join("config/recordings/optiodom.toml");
    let descriptor = descriptor.to_str().unwrap();
    let data = root().join("tests/data");
    let flags = ["--data", data.to_str().unwrap(), "--run", RUN, "--filter", "pose"];
    let scored = json(folder.path(), &[&["replay", descriptor, "--json"][..], &flags].concat());
    run(folder.path(), &[&["export", descriptor, "--format", "tum,csv,mcap"][..], &flags].concat());
    trajectories_score_as(&scored, folder.path());
    // The recording made of it gives the same estimates.
    run(folder.path(), &["export", "optiodom.mcap", "--format", "csv", "--out", "imported"]);
    let estimates = |folder: &Path| csv(&folder.join("estimates.csv")).1;
    assert_eq!(estimates(folder.path()), estimates(&folder.path().join("imported")));
}

#[test]
fn what_cannot_be_exported_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("link.raw"), [0xFD; 40]).unwrap();
    std::fs::write(folder.path().join("empty.tlog"), []).unwrap();
    drive(folder.path());
    for (args, said) in [
        (vec!["export", "link.raw", "--format", "csv"], "bytes without times"),
        (vec!["import", "link.raw", "--out", "a.mcap"], "bytes without times"),
        (vec!["export", "drive.mcap", "--format", "mcap"], "recording of posebridge already"),
        (vec!["export", "empty.tlog", "--format", "tum"], "holds no MAVLink frame"),
        (vec!["export", "nowhere.tlog", "--format", "csv"], "reading the recording `nowhere.tlog`"),
    ] {
        let output = posebridge(folder.path()).args(&args).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && text.contains(said), "{args:?}: {text}");
    }
    assert!(!folder.path().join("a.mcap").exists(), "no half a recording is left");
}

#[test]
fn a_live_run_keeps_a_log_of_both_directions() {
    let folder = tempfile::tempdir().unwrap();
    let told = run(folder.path(), &["run", "--tlog", "--duration", "3", "--out", "run"]);
    assert!(told.contains("recording.tlog"), "{told}");
    let log = json(folder.path(), &["inspect", "run/recording.tlog", "--json"]);
    let recording = json(folder.path(), &["inspect", "run/recording.mcap", "--json"]);
    assert_eq!(log["bytes_outside"], 0);
    assert_eq!(frames_of(&log, 1), frames_of(&recording, 1), "what the brick sent");
    assert!(frames_of(&log, 197) > 10, "what the station sent");
    let [ours, theirs] = [&log, &recording].map(|of| of["first_utc_micros"].as_u64().unwrap());
    assert!(ours.abs_diff(theirs) < 2_000_000, "{ours} {theirs}");
}

//! `posebridge export`, `import` and telemetry logs as recordings.

use std::path::Path;

use crate::support::virtual_drive::record_drive_and_truth;
use crate::support::{OPTIODOM_RUN, committed_data, descriptor, exit_code_and_stderr, json, number, read_text, run};
use crate::{trajectory, worst_distance};
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;

/// A folder with a short drive under a camera, and its truth.
fn drive() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scenario = "seed = 5\n[path.square]\nside_m = 0.5\ndirection = \"left\"\n";
    let scenario = Scenario::from_toml(scenario).unwrap();
    record_drive_and_truth(&folder.path().join("drive.mcap"), scenario, TimeDelta::ZERO);
    folder
}

#[test]
fn a_log_replays_and_is_imported_as_close_to_the_drive_as_its_times_allow() {
    let folder = drive();
    let folder = folder.path();
    run(folder, &["export", "drive.mcap", "--format", "tum,tlog", "--out", "out"]);
    run(folder, &["export", "out/drive.tlog", "--format", "tum", "--out", "again"]);
    let live = trajectory(&folder.join("out/estimate.tum"));
    let (compared, worst_m) = worst_distance(&live, &trajectory(&folder.join("again/estimate.tum")));
    assert!(compared > live.len() / 2, "{compared} of {}", live.len());
    assert!(worst_m < 0.005, "{worst_m} m");

    let import = ["import", "out/drive.tlog", "--out", "imported.mcap"];
    run(folder, &import);
    run(folder, &["replay", "out/drive.tlog", "--events", "log.txt"]);
    run(folder, &["replay", "imported.mcap", "--events", "imported.txt"]);
    let events = read_text(folder, "log.txt");
    assert!(events.lines().count() > 1_000);
    assert!(events == read_text(folder, "imported.txt"));
    // What is there already is not touched.
    assert_eq!(exit_code_and_stderr(folder, &import).0, Some(2));
}

/// The error between the two trajectories of a folder is that of a replay.
fn assert_scores_as(scored: &Value, folder: &Path) {
    let estimate = trajectory(&folder.join("estimate.tum"));
    let truth = trajectory(&folder.join("truth.tum"));
    assert_eq!(estimate.len(), truth.len());
    let squares = estimate.iter().zip(&truth).map(|(ours, theirs)| {
        assert_eq!(ours.0, theirs.0, "pairs have one stamp");
        (ours.1 - theirs.1).powi(2) + (ours.2 - theirs.2).powi(2)
    });
    let rms_m = (squares.sum::<f64>() / truth.len() as f64).sqrt();
    let expected_m = number(scored, "/estimators/0/position_rms_m");
    assert!((rms_m / expected_m - 1.0).abs() < 1e-4, "{rms_m} m, {expected_m} m");
}

#[test]
fn trajectories_score_as_the_replay_does() {
    let foreign = tempfile::tempdir().unwrap();
    let foreign = foreign.path();
    let (optiodom, data) = (descriptor("optiodom.toml"), committed_data());
    let flags = ["--data", &data, "--run", OPTIODOM_RUN, "--filter", "pose"];
    run(foreign, &[&["export", &optiodom, "--format", "tum,csv,mcap"][..], &flags].concat());
    assert_scores_as(&json(foreign, &[&["replay", &optiodom][..], &flags].concat()), foreign);
    // The recording made of it gives the same estimates.
    run(foreign, &["export", "optiodom.mcap", "--format", "csv", "--out", "imported"]);
    let lines = |name: &str| read_text(foreign, name).lines().count();
    assert_eq!(lines("estimates.csv"), lines("imported/estimates.csv"));
}

//! `posebridge export`, `import` and telemetry logs as recordings.

use std::path::Path;

use crate::support::virtual_drive::record_drive_and_truth;
use crate::support::{
    OPTIODOM_RUN, assert_refused, committed_data, descriptor, exit_code_and_stderr, json, number, read_text, run,
    write_text,
};
use crate::trajectory::{trajectory, worst_distance};
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

/// The header and the number of lines behind it.
fn csv(folder: &Path, name: &str) -> (String, u64) {
    let text = read_text(folder, name);
    let header = text.lines().next().unwrap().to_owned();
    let columns = header.split(',').count();
    for line in text.lines().filter(|line| !line.contains('"')) {
        assert_eq!(line.split(',').count(), columns, "{line}");
    }
    (header, text.lines().count() as u64 - 1)
}

#[test]
fn a_drive_becomes_tables_with_units_and_a_log_of_what_came_and_what_is_sent() {
    let folder = drive();
    let folder = folder.path();
    run(folder, &["export", "drive.mcap", "--format", "csv,tlog", "--out", "out"]);
    let (header, estimates) = csv(folder, "out/estimates.csv");
    assert!(header.starts_with("t_s,x_m,y_m,heading_rad,"), "{header}");
    assert!(estimates > 500 && csv(folder, "out/fusion.csv").1 > 500, "{estimates}");
    for name in ["turn_rate", "fix", "links", "sources", "clock", "events"] {
        assert!(csv(folder, &format!("out/{name}.csv")).1 > 0, "{name}");
    }

    let log = json(folder, &["inspect", "out/drive.tlog"]);
    assert_eq!((&log["bytes_outside"], &log["times_backwards"]), (&0.into(), &0.into()));
    let frames_of = |inspected: &Value, component: u64| {
        let mut sources = inspected["sources"].as_array().unwrap().iter();
        let source = sources.find(|source| source["system"] == 1 && source["component"] == component).unwrap();
        assert_eq!(source["lost"], 0, "{source}");
        source["frames"].as_u64().unwrap()
    };
    assert!(frames_of(&log, 197) > 0, "what the station sent");
    let messages = log["messages"].as_array().unwrap().iter();
    let ticks = messages.filter(|message| message["name"] == "PB_WHEEL_TICKS");
    let ticks: u64 = ticks.map(|message| message["frames"].as_u64().unwrap()).sum();
    let wheels = csv(folder, "out/wheel_angles.csv").1;
    assert!(wheels > 0 && (wheels..wheels + 20).contains(&ticks), "{ticks} frames, {wheels} observations");
    let replayed = json(folder, &["replay", "drive.mcap"]);
    assert!(replayed["observations"].as_u64().unwrap() > wheels);
    let original = json(folder, &["inspect", "drive.mcap"]);
    assert_eq!((&original["kind"], &original["bytes_outside"]), (&"posebridge".into(), &0.into()));
    assert_eq!(frames_of(&original, 1), frames_of(&log, 1), "what the brick sent");
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
    let own = drive();
    run(own.path(), &["export", "drive.mcap", "--format", "tum"]);
    assert_scores_as(&json(own.path(), &["replay", "drive.mcap"]), own.path());

    let foreign = tempfile::tempdir().unwrap();
    let foreign = foreign.path();
    let (optiodom, data) = (descriptor("optiodom.toml"), committed_data());
    let flags = ["--data", &data, "--run", OPTIODOM_RUN, "--filter", "pose"];
    run(foreign, &[&["export", &optiodom, "--format", "tum,csv,mcap"][..], &flags].concat());
    assert_scores_as(&json(foreign, &[&["replay", &optiodom][..], &flags].concat()), foreign);
    // The recording made of it gives the same estimates.
    run(foreign, &["export", "optiodom.mcap", "--format", "csv", "--out", "imported"]);
    assert_eq!(csv(foreign, "estimates.csv").1, csv(foreign, "imported/estimates.csv").1);
}

#[test]
fn what_cannot_be_exported_is_refused_with_the_reason() {
    let folder = drive();
    let folder = folder.path();
    write_text(folder, "link.raw", &"U".repeat(40));
    assert_refused(
        folder,
        &[
            ("export link.raw --format csv", 2, &["bytes without times"]),
            ("import link.raw --out a.mcap", 1, &["bytes without times"]),
            ("export drive.mcap --format mcap", 2, &["recording of posebridge already"]),
            ("export nowhere.tlog --format csv", 2, &["reading the recording `nowhere.tlog`"]),
        ],
    );
    assert!(!folder.join("a.mcap").exists(), "no half a recording is left");
}

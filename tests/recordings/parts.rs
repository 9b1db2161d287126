//! Parts of recordings: files that continue each other, spans of time, several estimators at once, other tunables, and a pace.

use std::path::Path;

use crate::support::virtual_drive::record_drive;
use crate::support::{SKEWED_SQUARE, exit_code_and_stderr, json, posebridge, read_text, run};
use posebridge::config::{Config, RecordingLimits};
use posebridge::station::recording_parts::RecordingParts;
use posebridge_recording::container::{FORMAT, RecordingHeader};
use posebridge_sim::Scenario;
use posebridge_telemetry::{Input, TimeDelta, Timestamp};
use serde_json::Value;

/// Seven seconds of ticks, four a second, in parts of two seconds: `recording.mcap` and what continues it.
pub(crate) fn record_ticks(folder: &Path) {
    let limits = RecordingLimits { part_duration: Some(TimeDelta::from_millis(2_000)), ..RecordingLimits::default() };
    let config_toml = toml::to_string(&Config::default()).unwrap();
    let header = RecordingHeader { format: FORMAT, config_toml, ..RecordingHeader::default() };
    let mut parts = RecordingParts::create(&folder.join("recording.mcap"), header, limits, 0).unwrap();
    for number in 0..28_u32 {
        let now = Timestamp::from_millis(250 * i64::from(number));
        parts.record(now, u64::from(number), &Input::Tick).unwrap();
    }
    parts.finish(28).unwrap();
}

#[test]
fn inspect_names_what_continues_a_part_and_export_what_it_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_ticks(folder);
    let third = json(folder, &["inspect", "recording.3.mcap"]);
    let facts = &third["recording"];
    assert_eq!(facts["part"], 3);
    assert_eq!(facts["continued_by"], serde_json::json!(["recording.4.mcap"]));
    assert!(facts["lack"].as_str().unwrap().contains("recording.2.mcap"), "{facts}");
    let duration_s = facts["duration_s"].as_f64().unwrap();
    assert!((1.0..2.5).contains(&duration_s), "{duration_s} s");
    let first = run(folder, &["inspect", "recording.mcap"]);
    assert!(first.contains("3 more continue it") && first.contains("`recording.2.mcap`"), "{first}");
    let export = |name: &str| {
        let (code, stderr) = exit_code_and_stderr(folder, &["export", name, "--format", "csv", "--out", "out"]);
        assert_eq!(code, Some(0), "{stderr}");
        stderr
    };
    assert!(!export("recording.mcap").contains("it lacks the first"));
    let later = export("recording.2.mcap");
    assert!(later.contains("it lacks the first") && later.contains("3 parts were joined"), "{later}");
}

/// A drive of the simulated brick in a folder.
fn drive() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scenario = Scenario::from_toml(SKEWED_SQUARE).unwrap();
    record_drive(&folder.path().join("drive.mcap"), scenario, TimeDelta::from_millis(500));
    folder
}

fn replay(folder: &Path, args: &[&str]) -> Value {
    json(folder, &[&["replay", "drive.mcap"], args].concat())
}

fn events(folder: &Path, args: &[&str]) -> Vec<String> {
    replay(folder, &[args, &["--events", "events.txt"]].concat());
    read_text(folder, "events.txt").lines().map(str::to_owned).collect()
}

#[test]
fn the_events_of_a_span_are_a_stretch_of_those_of_the_whole() {
    let folder = drive();
    let folder = folder.path();
    let whole = events(folder, &[]);
    let part = events(folder, &["--from", "2", "--to", "4.5"]);
    assert!(part.len() > 100 && part.len() < whole.len() / 2, "{} of {}", part.len(), whole.len());
    let begins = whole.windows(part.len()).position(|window| window == part);
    assert!(begins.is_some_and(|begins| begins > 50), "{begins:?}");
    // The two halves together are the whole.
    let halves = [events(folder, &["--to", "3"]), events(folder, &["--from", "3.0000001"])];
    assert_eq!(halves.concat(), whole);
    let counted = replay(folder, &["--from", "2", "--to", "4.5"]);
    assert_eq!(counted["recorded_seconds"].as_f64().map(f64::floor), Some(4.0));
    let observed = part.iter().filter(|line| line.starts_with("{\"event\":\"observed\"")).count();
    assert_eq!(counted["observations"], observed);
}

#[test]
fn several_estimators_at_once_give_what_each_gives_alone() {
    let folder = drive();
    let folder = folder.path();
    let names = ["pose", "odometry", "ekf5"];
    let flags: Vec<&str> = names.iter().flat_map(|name| ["--estimator", name]).collect();
    let all = replay(folder, &flags);
    let estimators = all["estimators"].as_array().unwrap();
    assert_eq!(estimators.len(), 3);
    for (name, together) in names.iter().zip(estimators) {
        assert_eq!(&replay(folder, &["--filter", name])["estimators"][0], together, "{name}");
        assert_eq!(together["name"], *name);
    }
    assert_eq!(all["changed"], serde_json::json!(["filter.name=odometry", "filter.name=ekf5"]));
}

#[test]
fn another_tunable_is_another_run_and_it_is_said_and_a_pace_changes_nothing() {
    let folder = drive();
    let folder = folder.path();
    let plain = events(folder, &[]);
    assert_eq!(plain, events(folder, &["--param", "gate_prob=0.999"]), "the default changes nothing");
    let args = ["replay", "drive.mcap", "--param", "gate_prob=0.5", "--param", "adapt_gain=0", "--json"];
    let output = posebridge(folder).args(args).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    let changed = "replayed with filter.gate_prob=0.5, filter.adapt_gain=0.0: this is not what ran";
    assert!(stderr.contains(changed), "{stderr}");
    let gated = |json: &Value| {
        let sources = json["estimators"][0]["sources"].as_array().unwrap();
        sources.iter().map(|source| source["gated"].as_u64().unwrap()).sum::<u64>()
    };
    let unchanged = replay(folder, &[]);
    let (few, many) = (gated(&unchanged), gated(&serde_json::from_slice(&output.stdout).unwrap()));
    assert!(many > few + 5, "half of all fixes lie beyond the median: {few} {many}");
    assert_eq!(unchanged["changed"], serde_json::json!([]));

    let paced = replay(folder, &["--speed", "20", "--events", "paced.txt"]);
    assert!(read_text(folder, "paced.txt").lines().eq(plain.iter().map(String::as_str)));
    let [recorded, wall] = ["recorded_seconds", "wall_seconds"].map(|key| paced[key].as_f64().unwrap());
    assert!(recorded > 3.0 && wall >= recorded / 20.0, "{recorded} s in {wall} s");
}

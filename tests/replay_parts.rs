//! Parts of a recording, several estimators at once, other tunables, and a pace: on a drive of the simulated brick in virtual time.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;
#[path = "support/virtual_drive.rs"]
mod virtual_drive;

use std::path::Path;

use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;
use support::{SKEWED_SQUARE, posebridge, stdout_of};
use virtual_drive::record_drive;

fn drive(folder: &Path) {
    let scenario = Scenario::from_toml(SKEWED_SQUARE).unwrap();
    record_drive(&folder.join("drive.mcap"), scenario, TimeDelta::from_millis(500));
}

fn replay(folder: &Path, args: &[&str]) -> Value {
    let replay = ["replay", "drive.mcap", "--json"];
    let printed = stdout_of(posebridge(folder).args(replay).args(args));
    serde_json::from_str(&printed).unwrap()
}

fn events(folder: &Path, args: &[&str], name: &str) -> Vec<String> {
    replay(folder, &[args, &["--events", name]].concat());
    let text = std::fs::read_to_string(folder.join(name)).unwrap();
    text.lines().map(str::to_owned).collect()
}

#[test]
fn the_events_of_a_part_are_a_stretch_of_those_of_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    drive(folder);
    let whole = events(folder, &[], "whole.txt");
    let part = events(folder, &["--from", "2", "--to", "4.5"], "part.txt");
    assert!(part.len() > 100 && part.len() < whole.len() / 2, "{} of {}", part.len(), whole.len());
    let begins = whole.windows(part.len()).position(|window| window == part);
    assert!(begins.is_some_and(|begins| begins > 50), "{begins:?}");
    // The two halves together are the whole.
    let before = events(folder, &["--to", "3"], "before.txt");
    let behind = events(folder, &["--from", "3.0000001"], "behind.txt");
    assert_eq!([before, behind].concat(), whole);
    let counted = replay(folder, &["--from", "2", "--to", "4.5"]);
    assert_eq!(counted["recorded_seconds"].as_f64().map(f64::floor), Some(4.0));
    let observed = part.iter().filter(|line| line.starts_with("{\"event\":\"observed\"")).count();
    assert_eq!(counted["observations"], observed);
}

#[test]
fn several_estimators_at_once_give_what_each_gives_alone() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    drive(folder);
    let names = ["pose", "odometry", "ekf5"];
    let flags: Vec<&str> = names.iter().flat_map(|name| ["--estimator", name]).collect();
    let all = replay(folder, &flags);
    for (name, together) in names.iter().zip(all["estimators"].as_array().unwrap()) {
        let alone = replay(folder, &["--filter", name]);
        assert_eq!(&alone["estimators"][0], together, "{name}");
        assert_eq!(together["name"], *name);
    }
    assert_eq!(all["estimators"].as_array().unwrap().len(), 3);
    assert_eq!(all["changed"], serde_json::json!(["filter.name=odometry", "filter.name=ekf5"]));
    let refused = ["replay", "drive.mcap", "--filter", "pose", "--filter", "ekf5", "--events", "e.txt"];
    let output = posebridge(folder).args(refused).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("give --filter once"));
}

#[test]
fn another_tunable_is_another_run_and_it_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    drive(folder);
    let plain = events(folder, &[], "plain.txt");
    let same = events(folder, &["--param", "gate_prob=0.999"], "same.txt");
    assert_eq!(plain, same, "the default changes nothing");
    let replayed = ["replay", "drive.mcap", "--param", "gate_prob=0.5", "--param", "adapt_gain=0", "--json"];
    let output = posebridge(folder).args(replayed).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("replayed with filter.gate_prob=0.5, filter.adapt_gain=0.0: this is not what ran"), "{said}");
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let gated = |json: &Value| {
        let sources = json["estimators"][0]["sources"].as_array().unwrap();
        sources.iter().map(|source| source["gated"].as_u64().unwrap()).sum::<u64>()
    };
    let (few, many) = (gated(&replay(folder, &[])), gated(&json));
    assert!(many > few + 5, "half of all fixes lie beyond the median: {few} {many}");
    assert_eq!(replay(folder, &[])["changed"], serde_json::json!([]));
}

#[test]
fn a_speed_paces_the_replay_and_changes_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    drive(folder);
    let fast = events(folder, &[], "fast.txt");
    let replayed = replay(folder, &["--speed", "20", "--events", "paced.txt"]);
    let paced = std::fs::read_to_string(folder.join("paced.txt")).unwrap();
    assert!(paced.lines().eq(fast.iter().map(String::as_str)));
    let [recorded, wall] = ["recorded_seconds", "wall_seconds"].map(|key| replayed[key].as_f64().unwrap());
    assert!(recorded > 3.0 && wall >= recorded / 20.0, "{recorded} s in {wall} s");
}

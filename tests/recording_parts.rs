//! A recording in parts, as other commands than `replay` tell of it.

#[path = "support/parted.rs"]
mod parted;
mod support;

use parted::record_ticks;
use serde_json::{Value, json};
use support::{posebridge, stdout_of};

#[test]
fn a_part_is_inspected_alone_and_names_what_continues_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record_ticks(folder);
    let inspect = |args: &[&str]| stdout_of(posebridge(folder).arg("inspect").args(args));
    let third = inspect(&["recording.3.mcap", "--json"]);
    let third: Value = serde_json::from_str(&third).unwrap();
    let facts = &third["recording"];
    assert_eq!(facts["part"], 3);
    assert_eq!(facts["continued_by"], json!(["recording.4.mcap"]));
    let lack = facts["lack"].as_str().unwrap();
    assert!(lack.contains("recording.2.mcap"), "{lack}");
    let duration_s = facts["duration_s"].as_f64().unwrap();
    assert!((1.0..2.5).contains(&duration_s), "{duration_s} s");
    let first = inspect(&["recording.mcap"]);
    assert!(first.contains("3 more continue it"), "{first}");
    assert!(first.contains("`recording.2.mcap`"), "{first}");
}

#[test]
fn an_export_of_a_later_part_says_what_it_lacks() {
    let folder = tempfile::tempdir().unwrap();
    record_ticks(folder.path());
    let export = |name: &str| {
        let args = ["export", name, "--format", "csv", "--out", "out"];
        let output = posebridge(folder.path()).args(args).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        said
    };
    assert!(!export("recording.mcap").contains("it lacks the first"));
    let said = export("recording.2.mcap");
    assert!(said.contains("it lacks the first"), "{said}");
    assert!(said.contains("3 parts were joined"), "{said}");
}

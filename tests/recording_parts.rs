//! A recording in parts, as other commands than `replay` tell of it.
#![expect(
    clippy::unwrap_used,
    reason = "helpers outside #[test] stop where the set-up is broken"
)]

mod support;

use std::path::Path;

use posebridge::config::Config;
use posebridge::tasks::parts::{Limits, Parts};
use posebridge_recording::container::{FORMAT, Header};
use posebridge_telemetry::{Input, Span, Stamp};
use serde_json::{Value, json};
use support::{posebridge, stdout_of};

/// Seven seconds of ticks, four a second, in parts of two seconds.
fn record(folder: &Path) {
    let limits = Limits {
        part_span: Some(Span::from_millis(2_000)),
        ..Limits::default()
    };
    let header = Header {
        format: FORMAT,
        config_toml: toml::to_string(&Config::default()).unwrap(),
        ..Header::default()
    };
    let mut parts = Parts::create(&folder.join("recording.mcap"), header, limits, 0).unwrap();
    for number in 0..28_u32 {
        let now = Stamp::from_millis(250 * i64::from(number));
        parts.record(now, u64::from(number), &Input::Tick).unwrap();
    }
    parts.finish(28).unwrap();
}

#[test]
fn a_part_is_inspected_alone_and_names_what_continues_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    record(folder);
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
    record(folder.path());
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

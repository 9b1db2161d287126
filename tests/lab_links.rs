//! `posebridge lab links`: the tables as people read them, the keys as programs read them, and what the clock table promises.
//!
//! A small grid in virtual time; the figures are the same on every run.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::path::Path;

use serde_json::Value;

use support::posebridge;

/// Two links, one of them with a circumstance on top: few laps.
const SMALL: [&str; 12] = [
    "--profile",
    "usb",
    "--profile",
    "bluetooth-spp",
    "--loss",
    "0,0.05",
    "--delay-ms",
    "0",
    "--skew-ppm",
    "2021",
    "--runs",
    "1",
];

/// What the experiment prints for the small grid; it must end well.
fn lab(folder: &Path, more: &[&str]) -> String {
    let output = posebridge(folder).args(["lab", "links"]).args(SMALL).args(more).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn the_tables_are_these() {
    let folder = tempfile::tempdir().unwrap();
    let tables = lab(folder.path(), &[]);
    insta::assert_snapshot!("tables", tables);
    let picture = std::fs::read_to_string(folder.path().join("lab-links.svg")).unwrap();
    assert!(picture.starts_with("<svg") && picture.contains("bluetooth-spp"));
    let page = std::fs::read_to_string(folder.path().join("lab-links.html")).unwrap();
    assert!(page.contains("Clock: error of the offset") && page.contains("data:image/svg+xml,"));
}

/// Every key with the kinds of its values, one line each.
fn keys(rows: &Value) -> String {
    let kind = |value: &Value| match value {
        Value::Null => "null",
        Value::Number(_) => "number",
        Value::String(_) => "text",
        Value::Bool(_) | Value::Array(_) | Value::Object(_) => "something else",
    };
    let rows = rows.as_array().unwrap();
    let mut seen = std::collections::BTreeSet::new();
    for row in rows {
        for (key, value) in row.as_object().unwrap() {
            seen.insert(format!("{key}: {}", kind(value)));
        }
    }
    seen.into_iter().collect::<Vec<_>>().join("\n")
}

fn object(folder: &Path) -> Value {
    let text = lab(folder, &["--json"]);
    assert_eq!(text.lines().count(), 1, "one line: {text}");
    serde_json::from_str(&text).unwrap()
}

#[test]
fn the_object_has_the_keys_that_its_page_promises_and_the_figures_of_the_tables() {
    let folder = tempfile::tempdir().unwrap();
    let object = object(folder.path());
    let parts: Vec<&String> = object.as_object().unwrap().keys().collect();
    assert_eq!(parts, ["clock", "pose"]);
    insta::assert_snapshot!("clock_keys", keys(&object["clock"]));
    insta::assert_snapshot!("pose_keys", keys(&object["pose"]));
    let page = include_str!("../docs/impairment.md");
    for row in ["clock", "pose"] {
        for key in object[row][0].as_object().unwrap().keys() {
            assert!(page.contains(&format!("\"{key}\"")), "{key} is not on the page");
        }
    }
    let pose = object["pose"].as_array().unwrap();
    assert_eq!(pose.len(), 4);
    let tables = lab(folder.path(), &[]);
    for row in pose {
        let position_mm = 1e3 * row["position_rms_m"].as_f64().unwrap();
        let wanted = format!(" {position_mm:.2} ");
        assert!(tables.contains(&wanted), "{wanted}: {tables}");
    }
    check_clock(&object["clock"]);
}

/// A method's worst and mean error in a case, ms.
fn clock_errors(rows: &Value, case: &str, method: &str) -> Option<(f64, f64)> {
    let row = rows.as_array().unwrap().iter().find(|row| row["case"] == case && row["method"] == method).unwrap();
    Some((row["worst_ms"].as_f64()?, row["mean_ms"].as_f64()?))
}

fn check_clock(rows: &Value) {
    const CASES: [&str; 5] = ["50ppm", "2021ppm", "asymmetric", "drift", "reboot"];
    for case in CASES {
        // Every round trip takes 30 ms or more, and the stock filter looks at none above 10 ms.
        assert_eq!(clock_errors(rows, case, "timesync-10ms"), None, "{case}");
    }
    let (ours, one_way) = ("two-way-hulls", "one-way-hull");
    for (case, worst_ms) in [("50ppm", 0.1), ("2021ppm", 0.1), ("drift", 0.3)] {
        let (found_ms, _) = clock_errors(rows, case, ours).unwrap();
        assert!(found_ms <= worst_ms, "{case}: {found_ms}");
    }
    // Half of an asymmetry of 15 ms is what nobody who looks at two ways can see; the one way errs by its whole delay.
    let (_, mean_ms) = clock_errors(rows, "asymmetric", ours).unwrap();
    assert!((mean_ms + 7.5).abs() < 0.1, "{mean_ms}");
    let (_, mean_ms) = clock_errors(rows, "50ppm", one_way).unwrap();
    assert!((mean_ms - 15.0).abs() < 0.1, "{mean_ms}");
}

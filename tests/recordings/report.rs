//! `posebridge report`: one page that needs nothing else. tests/golden holds the pages of whole recordings with their pictures.

use std::path::Path;

use crate::support::virtual_drive::record_configured_drive;
use crate::support::{SKEWED_SQUARE, committed_data, descriptor, json, named, number, read_text, run};
use posebridge::config::Config;
use posebridge_sim::Scenario;
use posebridge_telemetry::TimeDelta;
use serde_json::Value;

/// A folder with a lap of a robot whose name would like to run a script in the reader's browser.
fn recorded_lap() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut config = Config::default();
    "<script>alert(\"1\")</script> & Co".clone_into(&mut config.robot.name);
    let scenario = Scenario::from_toml(SKEWED_SQUARE).unwrap();
    record_configured_drive(&folder.path().join("lap.mcap"), &config, scenario, TimeDelta::from_millis(500));
    folder
}

/// The page that a report leaves, and the object that it prints.
fn report(folder: &Path, args: &[&str], out: &str) -> (String, Value) {
    let object = json(folder, &[&["report", "--out", out], args].concat());
    let page = read_text(&folder.join(out), "report.html");
    check_page(&page);
    (page, object)
}

/// Tags that nest and are closed, quotes in pairs, nothing that is fetched or run, every reference within the page.
fn check_page(page: &str) {
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap();
    let mut open: Vec<&str> = Vec::new();
    for piece in body.split('<').skip(1) {
        let (tag, _text) = piece.split_once('>').unwrap();
        assert_eq!(tag.matches('"').count() % 2, 0, "odd quotes in {tag}");
        let name = tag.split([' ', '/', '\n']).find(|part| !part.is_empty());
        if tag.starts_with('/') {
            assert_eq!(open.pop(), name, "{tag} closes another tag");
        } else if !tag.ends_with('/') {
            open.extend(name);
        }
        assert!(!matches!(name, Some("script" | "link" | "iframe" | "img" | "object")), "{tag}");
        for fetched in ["http", "src=", "href=", "NaN", "Infinity"] {
            assert!(!tag.contains(fetched), "{fetched} in {tag}");
        }
        assert!(!tag.contains(" on") || tag.starts_with("meta"), "an event handler: {tag}");
    }
    assert!(open.is_empty(), "open: {open:?}");
    assert!(!page.contains("@import") && page.matches("url(").count() == page.matches("url(#").count());
    for reference in page.split("url(#").skip(1) {
        let (id, _) = reference.split_once(')').unwrap();
        assert_eq!(page.matches(&format!(" id=\"{id}\"")).count(), 1, "{id}");
    }
}

#[test]
fn the_page_of_a_run_holds_its_pictures() {
    let folder = recorded_lap();
    let folder = folder.path();
    let (page, _) = report(folder, &["lap.mcap"], "first");
    for name in ["path", "errors", "innovations-camera", "innovations-wheels", "learned", "link-0", "clock"] {
        let svg = read_text(folder, &format!("first/report-run1-{name}.svg"));
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{name}");
        // In the page without what only a file needs.
        assert!(page.contains(svg.rsplit("<text").next().unwrap()), "{name} is not in the page");
    }
}

#[test]
fn a_changed_filter_a_cut_recording_and_a_log_without_truth_are_said() {
    let folder = recorded_lap();
    let folder = folder.path();
    let args = ["lap.mcap", "--filter", "odometry", "--param", "history_s=2", "--from", "2"];
    let (page, object) = report(folder, &args, "changed");
    let changed = "Replayed with filter.name=odometry, filter.history_s=2.0: this is not what ran.";
    assert!(page.contains(changed), "{}", object["changed"]);
    assert_eq!(object["filter"], "odometry");
    assert!(page.contains("&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; Co"));
    assert!(!page.contains("link 0 is up"), "that was before 2 s");
    // A drive that was cut off before its truth was recorded, and its telemetry log, have none.
    let bytes = std::fs::read(folder.join("lap.mcap")).unwrap();
    std::fs::write(folder.join("torn.mcap"), &bytes[..bytes.len() / 3]).unwrap();
    let (page, _) = report(folder, &["torn.mcap"], "torn");
    assert!(page.contains("cut off at byte"));
    run(folder, &["export", "lap.mcap", "--format", "tlog", "--out", "out"]);
    let (page, of_log) = report(folder, &["out/lap.tlog"], "log");
    assert!(of_log["runs"][0]["yardstick"].is_null() && of_log["runs"][0]["anees"].is_null());
    assert!(page.contains("No truth is known") && !page.contains("run1-errors"));
    let of_recording = json(folder, &["report", "lap.mcap", "--out", "whole"]);
    let used = |object: &Value| number(named(&object["runs"][0]["sources"], "camera"), "/used");
    let ratio = used(&of_log) / used(&of_recording);
    assert!((ratio - 1.0).abs() < 0.1, "the log holds the same fixes: {ratio}");
}

#[test]
fn the_page_of_a_foreign_recording_has_its_runs_with_the_figures_of_replay() {
    let folder = tempfile::tempdir().unwrap();
    let (optiodom, data) = (descriptor("optiodom.toml"), committed_data());
    let args = [&optiodom[..], "--data", &data];
    let (page, object) = report(folder.path(), &args, "page");
    let runs = object["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 6);
    let replayed = json(folder.path(), &[&["replay", "--filter", "pose"], &args[..]].concat());
    for key in ["position_rms_m", "position_max_m", "heading_rms_rad", "anees"] {
        let mean = runs.iter().map(|run| run[key].as_f64().unwrap()).sum::<f64>() / runs.len() as f64;
        let there = number(&replayed["estimators"][0], &format!("/{key}"));
        assert!((mean / there - 1.0).abs() < 1e-12, "{key}: {mean} {there}");
    }
    for run in runs {
        assert!(page.contains(&format!("<h2>Run {}</h2>", run["name"].as_str().unwrap())));
        assert_eq!(run["yardstick"], "truth");
    }
    assert!(page.len() < 2_000_000, "page of {} bytes", page.len());
}

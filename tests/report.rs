//! `posebridge report` with the real program: one page that needs nothing else, whose numbers are those of `replay`.
#![expect(clippy::unwrap_used, reason = "helpers outside #[test] stop where the set-up is broken")]

mod support;

use std::path::{Path, PathBuf};

use serde_json::Value;
use support::{SKEWED_SQUARE, posebridge, root, stdout_of};

/// A robot that would like to run a script in the reader's browser.
const WICKED: &str = "<script>alert(\"1\")</script> & Co";

/// A short live run of the simulated brick, recorded in `run/`.
fn live_run(folder: &Path) -> PathBuf {
    std::fs::write(folder.join("skewed.toml"), SKEWED_SQUARE).unwrap();
    let name = format!("robot.name={WICKED}");
    let run = ["run", "--link", "sim://skewed.toml", "--laps", "1", "--out", "run", "--tlog", "--set", &name];
    stdout_of(posebridge(folder).args(run));
    folder.join("run/recording.mcap")
}

/// The page that a report leaves, and what it prints.
fn report(folder: &Path, args: &[&str], out: &str) -> (String, Value) {
    let printed = stdout_of(posebridge(folder).arg("report").args(args).args(["--out", out, "--json"]));
    let page = std::fs::read_to_string(folder.join(out).join("report.html")).unwrap();
    (page, serde_json::from_str(&printed).unwrap())
}

fn replay(folder: &Path, args: &[&str]) -> Value {
    let printed = stdout_of(posebridge(folder).arg("replay").args(args).arg("--json"));
    serde_json::from_str(&printed).unwrap()
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
        let target = format!(" id=\"{id}\"");
        assert_eq!(page.matches(&target).count(), 1, "{target}");
    }
}

/// The pictures of the page are those of the files, but for what only a file needs.
fn check_pictures(page: &str, folder: &Path) -> Vec<String> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if name == "report.html" {
            continue;
        }
        let svg = std::fs::read_to_string(&path).unwrap();
        assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"), "{name}");
        let last_text = svg.rsplit("<text").next().unwrap();
        assert!(page.contains(last_text), "{name} is not in the page");
        names.push(name);
    }
    names.sort();
    names
}

#[test]
fn the_page_of_a_live_run_needs_nothing_else_and_says_what_replay_says() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    live_run(folder);
    let recording = ["run/recording.mcap"];
    let (page, json) = report(folder, &recording, "first");
    check_page(&page);
    let names = check_pictures(&page, &folder.join("first"));
    for name in ["path", "errors", "innovations-camera", "innovations-wheels", "learned", "link-0", "clock"] {
        let name = format!("report-run1-{name}.svg");
        assert!(names.contains(&name), "{name} in {names:?}");
    }
    assert!(page.contains("&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; Co"));
    assert!(page.contains("<h3>What happened</h3>") && page.contains("link 0 is up"));

    let replayed = replay(folder, &recording);
    let (run, estimator) = (&json["runs"][0], &replayed["estimators"][0]);
    for key in ["position_rms_m", "position_max_m", "position_end_m", "heading_rms_rad", "anees"] {
        assert!(run[key].as_f64().unwrap() > 0.0, "{key}");
        assert_eq!(run[key], estimator[key], "{key}");
    }
    let rms_mm = run["position_rms_m"].as_f64().unwrap() * 1e3;
    println!("position rms {rms_mm:.2} mm, page of {} bytes", page.len());
    assert!(page.contains(&format!("the position is {rms_mm:.1} mm off")));
    assert!(rms_mm < 30.0, "the estimate of a simulated lap");
    check_sources(&page, run, estimator);

    let (log_page, of_log) = report(folder, &["run/recording.tlog"], "log");
    check_page(&log_page);
    let camera = |json: &Value| {
        let sources = json["runs"][0]["sources"].as_array().unwrap();
        let camera = sources.iter().find(|one| one["name"] == "camera").unwrap();
        camera["used"].as_f64().unwrap()
    };
    let ratio = camera(&of_log) / camera(&json);
    assert!((ratio - 1.0).abs() < 0.1, "the log holds the same fixes: {ratio}");

    let (again, json_again) = report(folder, &recording, "second");
    assert!(page == again && json == json_again, "a page is the same twice");
}

fn check_sources(page: &str, run: &Value, estimator: &Value) {
    let sources = run["sources"].as_array().unwrap();
    let replayed = estimator["sources"].as_array().unwrap();
    assert_eq!(sources.len(), replayed.len());
    let words = ["consistent", "nearly consistent", "too sure", "too careful", "too few to say"];
    for source in sources {
        let same = replayed.iter().find(|one| one["name"] == source["name"]).unwrap();
        for key in ["used", "gated", "too_old", "mean_nis_per_dof", "degrees_of_freedom"] {
            assert_eq!(source[key], same[key], "{} {key}", source["name"]);
        }
        let verdict = source["verdict"].as_str().unwrap();
        assert!(words.iter().any(|word| verdict.starts_with(word)), "{verdict}");
        assert!(page.contains(verdict), "{verdict}");
        if let Some(nis) = source["mean_nis_per_dof"].as_f64() {
            assert!(page.contains(&format!("<td>{nis:.3}</td>")));
        }
    }
}

#[test]
fn a_report_of_another_filter_says_that_it_is_not_what_ran_and_a_truth_may_be_missing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    live_run(folder);
    let args = ["run/recording.mcap", "--filter", "odometry", "--param", "history_s=2", "--from", "2"];
    let (page, json) = report(folder, &args, "changed");
    check_page(&page);
    let said = "Replayed with filter.name=odometry, filter.history_s=2.0: this is not what ran.";
    assert!(page.contains(said), "{}", json["changed"]);
    assert_eq!(json["filter"], "odometry");
    assert!(!page.contains("link 0 is up"), "that was before 2 s");
    // A recording that was cut off has the truth of what it holds.
    let bytes = std::fs::read(folder.join("run/recording.mcap")).unwrap();
    std::fs::write(folder.join("torn.mcap"), &bytes[..bytes.len() / 3]).unwrap();
    let (page, json) = report(folder, &["torn.mcap"], "torn");
    check_page(&page);
    assert!(json["runs"][0]["anees"].is_number());
    assert!(page.contains("cut off at byte"));
    // A telemetry log has none.
    let export = ["export", "run/recording.mcap", "--format", "tlog", "--out", "out"];
    stdout_of(posebridge(folder).args(export));
    let (page, json) = report(folder, &["out/recording.tlog"], "log");
    check_page(&page);
    assert!(json["runs"][0]["yardstick"].is_null() && json["runs"][0]["anees"].is_null());
    assert!(page.contains("No truth is known"));
    assert!(!page.contains("run1-errors"));
}

#[test]
fn the_page_of_a_foreign_recording_has_its_runs_with_the_figures_of_replay() {
    let folder = tempfile::tempdir().unwrap();
    let descriptor = root().join("config/recordings/optiodom.toml");
    let data = root().join("tests/data");
    let args = [descriptor.to_str().unwrap(), "--data", data.to_str().unwrap()];
    let (page, json) = report(folder.path(), &args, "page");
    check_page(&page);
    let runs = json["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 6);
    let mean = |key: &str| {
        let sum: f64 = runs.iter().map(|run| run[key].as_f64().unwrap()).sum();
        sum / runs.len() as f64
    };
    let replayed = replay(folder.path(), &[&args[..], &["--filter", "pose"]].concat());
    let estimator = &replayed["estimators"][0];
    for key in ["position_rms_m", "position_max_m", "heading_rms_rad", "anees"] {
        let (here, there) = (mean(key), estimator[key].as_f64().unwrap());
        assert!((here / there - 1.0).abs() < 1e-12, "{key}: {here} {there}");
    }
    for run in runs {
        assert!(page.contains(&format!("<h2>Run {}</h2>", run["name"].as_str().unwrap())));
        assert_eq!(run["yardstick"], "truth");
    }
    println!("page of {} bytes", page.len());
    assert!(page.len() < 2_000_000);
}

#[test]
fn what_cannot_be_reported_on_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("no.mcap"), b"hello").unwrap();
    let refused = |args: &[&str]| {
        let output = posebridge(folder).arg("report").args(args).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), said)
    };
    let (code, said) = refused(&["no.mcap"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("no.mcap") && said.contains("MCAP magic"), "{said}");
    let (code, said) = refused(&["no.mcap", "--param", "gate_prop=0.9"]);
    assert_eq!(code, Some(2));
    assert!(said.contains("`gate_prop`") && said.contains("gate_prob, history_s"), "{said}");
    let (_, said) = refused(&["no.mcap", "--param", "gate_prob=7"]);
    assert!(said.contains("is 7, must lie in 0.5 to"), "{said}");
    let (_, said) = refused(&["no.mcap", "--from", "5", "--to", "2"]);
    assert!(said.contains("--from 5 does not lie before --to 2"), "{said}");
    assert_eq!(std::fs::read_dir(folder).unwrap().count(), 1);
}

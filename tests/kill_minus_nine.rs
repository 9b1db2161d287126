//! A recording is readable after `kill -9`, up to at most one second before.

mod support;

use posebridge_recording::container::Reader;
use support::{Running, posebridge};

#[test]
fn a_killed_run_leaves_a_recording_that_replays_up_to_a_second_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Running::start(posebridge(folder.path()).args([
        "run",
        "--link",
        "sim://square",
        "--out",
        "run",
    ]));
    // Without a terminal the status block is a line every five seconds: by then inputs have come for that long.
    let status = run.wait_for("time ");
    run.kill();
    let killed_at_s: f64 = status
        .split("time")
        .nth(1)
        .unwrap()
        .trim()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap();

    let path = folder.path().join("run/recording.mcap");
    let bytes = std::fs::read(&path).unwrap();
    let last = Reader::open(&bytes)
        .unwrap()
        .map(|item| item.expect("every whole record is good").0)
        .max();
    let recorded_to_s = last.expect("something was recorded").as_secs_f64();
    println!("killed at {killed_at_s:.2} s or later, recorded up to {recorded_to_s:.2} s");
    assert!(recorded_to_s > killed_at_s - 1.0);

    let replay = posebridge(folder.path())
        .args(["replay", "run/recording.mcap", "--json"])
        .output()
        .unwrap();
    assert!(
        replay.status.success(),
        "{}",
        String::from_utf8_lossy(&replay.stderr)
    );
    let report: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert!(report["observations"].as_u64().unwrap() > 100, "{report}");
}

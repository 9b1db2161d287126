//! The strongest promise of the program: the events of a live run are those of its replay, bit for bit.

use crate::support::{SKEWED_SQUARE, assert_replays, events_named, json, run, write_text};
use posebridge_recording::container::RecordingReader;
use posebridge_telemetry::Input;
use serde_json::Value;

#[test]
fn a_run_over_a_pseudo_terminal_replays_bit_for_bit_with_a_skewed_and_wrapping_clock() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "skewed.toml", SKEWED_SQUARE);
    let args = ["run", "--link", "sim://skewed.toml", "--laps", "1", "--out", "run", "--events", "live.txt", "--tlog"];
    run(folder, &args);
    let live = assert_replays(folder, "run/recording.mcap", "live.txt");

    // The comparison must have had something to compare: fixes that were used across the wrap, and a clock known to be fast.
    let fused = events_named(&live, "fused");
    let used = fused.iter().filter(|event| event["kind"] == "fix" && event["outcome"] == "accepted");
    assert!(used.count() > 40);
    let last_clock = events_named(&live, "robot_clock_aligned").pop().expect("clocks were aligned");
    let skew_ppm = last_clock["skew_ppm"].as_f64().unwrap();
    assert!((skew_ppm - 2000.0).abs() < 300.0, "{skew_ppm} ppm");
    assert!(events_named(&live, "robot_restarted").is_empty());
    // The telemetry log beside the recording holds both directions.
    let [log, recording] = ["run/recording.tlog", "run/recording.mcap"].map(|name| json(folder, &["inspect", name]));
    let frames_of = |inspected: &Value, component: u64| {
        let mut sources = inspected["sources"].as_array().unwrap().iter();
        sources.find(|source| source["component"] == component).unwrap()["frames"].as_u64().unwrap()
    };
    assert_eq!(log["bytes_outside"], 0);
    assert_eq!(frames_of(&log, 1), frames_of(&recording, 1), "what the brick sent");
    assert!(frames_of(&log, 197) > 10, "what the station sent");
    let [ours, theirs] = [&log, &recording].map(|of| of["first_utc_micros"].as_u64().unwrap());
    assert!(ours.abs_diff(theirs) < 2_000_000, "{ours} {theirs}");
    assert!(chunks_that_are_not_frames(&folder.join("run/recording.mcap")) > 0);
}

/// Chunks of the recording that hold more or less than one frame: the boundaries are those of the reads.
fn chunks_that_are_not_frames(path: &std::path::Path) -> usize {
    let bytes = std::fs::read(path).unwrap();
    RecordingReader::open(&bytes)
        .unwrap()
        .filter(|item| match item {
            Ok((_, Input::Bytes { bytes, .. })) => usize::from(bytes[1]) + 12 != bytes.len(),
            _ => false,
        })
        .count()
}

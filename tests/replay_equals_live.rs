//! The strongest promise of the house: the events of a live run are those of its replay, bit for bit.
#![expect(clippy::unwrap_used, reason = "a test stops where its set-up is broken")]

mod support;

use posebridge_recording::container::RecordingReader;
use posebridge_telemetry::Input;
use support::{SKEWED_SQUARE, events_named, posebridge, stdout_of};

#[test]
fn a_run_over_a_pseudo_terminal_replays_bit_for_bit_with_a_skewed_and_wrapping_clock() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("skewed.toml"), SKEWED_SQUARE).unwrap();
    stdout_of(posebridge(folder.path()).args([
        "run",
        "--link",
        "sim://skewed.toml",
        "--laps",
        "1",
        "--out",
        "run",
        "--events",
        "live.txt",
    ]));
    stdout_of(posebridge(folder.path()).args(["replay", "run/recording.mcap", "--events", "replayed.txt"]));

    let live = std::fs::read_to_string(folder.path().join("live.txt")).unwrap();
    let replayed = std::fs::read_to_string(folder.path().join("replayed.txt")).unwrap();
    for (number, (live, replayed)) in live.lines().zip(replayed.lines()).enumerate() {
        assert_eq!(live, replayed, "event {number}");
    }
    assert_eq!(live.lines().count(), replayed.lines().count());

    // The comparison must have had something to compare: fixes that were used across the wrap, and a clock known to be fast.
    let fused = events_named(&live, "fused");
    let used = fused.iter().filter(|event| event["kind"] == "fix" && event["outcome"] == "accepted");
    assert!(used.count() > 40);
    let last_clock = events_named(&live, "robot_clock_aligned").pop().expect("clocks were aligned");
    let skew_ppm = last_clock["skew_ppm"].as_f64().unwrap();
    assert!((skew_ppm - 2000.0).abs() < 300.0, "{skew_ppm} ppm");
    assert!(events_named(&live, "robot_restarted").is_empty());
    assert!(chunks_that_are_not_frames(&folder.path().join("run/recording.mcap")) > 0);
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

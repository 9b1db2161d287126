//! A run with a simulated brick goes on for ever, and leaves its tables when somebody ends it.

use crate::support::{RunningProgram, SKEWED_SQUARE, write_text};
use posebridge_recording::container::read_truth;

/// The number behind the first `name` of a line, up to its unit or the end of its field.
fn number_after(line: &str, name: &str) -> f64 {
    let text = line.split(name).nth(1).expect("the field is there");
    let digits = text.split(['s', ')', ',', ' ']).next();
    let digits = digits.expect("it has a value");
    digits.parse().expect("it is a number")
}

#[test]
fn each_second_has_a_line_of_errors_and_an_interrupted_run_ends_with_tables() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write_text(folder, "skewed.toml", SKEWED_SQUARE);
    let mut run = RunningProgram::posebridge(folder, &["run", "--link", "sim://skewed.toml", "--out", "run"]);
    for number in 0..7 {
        let line = run.wait_for("odometry ");
        // The first fix has come by the fourth second.
        if number > 3 {
            assert!((0.0..2.0).contains(&number_after(&line, "odometry ")), "{line}");
            assert!((0.0..0.1).contains(&number_after(&line, "estimate ")), "{line}");
        }
    }
    let tables = run.interrupt();
    for part in ["brick's own odometry", "path error", "track.svg"] {
        assert!(tables.contains(part), "{tables}");
    }
    let samples = read_truth(&std::fs::read(folder.join("run/recording.mcap")).unwrap()).unwrap();
    assert!(samples.len() > 7 * 15, "{} samples of the truth", samples.len());
    assert!(samples.windows(2).all(|pair| pair[0].time < pair[1].time), "in order, once each");
}

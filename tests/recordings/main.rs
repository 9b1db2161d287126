//! Recordings: written, taken in from elsewhere, replayed, exported and reported on.
#![expect(
    clippy::expect_used,
    clippy::unwrap_used,
    clippy::wildcard_enum_match_arm,
    reason = "helpers outside #[test] stop where the set-up is broken, and pick the inputs that they are about"
)]

#[path = "../support/mod.rs"]
mod support;

mod export;
mod failures;
mod files;
mod inspect;
mod log_times;
mod merge;
mod messages;
mod page_history;
mod parts;
mod real_recordings;
mod replay_smooth;
mod replugged_recording;
mod report;
mod unreadable;

use std::path::Path;

/// Stamp, x and y of each line of a trajectory that `posebridge export --format tum` has written.
fn trajectory(path: &Path) -> Vec<(f64, f64, f64)> {
    let text = std::fs::read_to_string(path).unwrap();
    let poses = text.lines().map(|line| {
        let fields: Vec<f64> = line.split(' ').map(|field| field.parse().unwrap()).collect();
        assert_eq!(fields.len(), 8, "{line}");
        (fields[0], fields[1], fields[2])
    });
    poses.collect()
}

/// How many stamps two trajectories have in common, and how far they are apart there at most, m.
fn worst_distance(one: &[(f64, f64, f64)], other: &[(f64, f64, f64)]) -> (usize, f64) {
    let (mut compared, mut worst_m) = (0, 0.0_f64);
    for (stamp, x, y) in other {
        if let Ok(index) = one.binary_search_by(|(here, ..)| here.total_cmp(stamp)) {
            let (_, here_x, here_y) = one[index];
            // At first a fix may come before the clocks are aligned in one of the two.
            if compared > 100 {
                worst_m = worst_m.max((x - here_x).hypot(y - here_y));
            }
            compared += 1;
        }
    }
    (compared, worst_m)
}

//! The clock part of the link laboratory: every way to align two clocks over links of known delays.
//!
//! The same seeds give the same rows; [`posebridge_lab::clocks`] has methods, links and clocks.

use posebridge_lab::clocks::{ClockRow, compare_methods};
use serde::Serialize;

/// Seeds of the table: as many as docs/maths/clock.md shows.
pub(super) const CLOCK_SEEDS: [u64; 5] = [1, 2, 3, 4, 5];

/// One row of the `clock` part of `lab links --json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct LinkClockRow {
    /// Name of the case: which clock, which link.
    pub(super) case: &'static str,
    /// Name of the method.
    pub(super) method: &'static str,
    /// Largest error, ms; null if the method never answers.
    pub(super) worst_ms: Option<f64>,
    /// Mean error, ms, positive for stamps that are taken for later than they were; null if the method never answers.
    pub(super) mean_ms: Option<f64>,
}

/// The rows of all cases and methods, case by case.
#[must_use]
pub(super) fn rows(seeds: &[u64]) -> Vec<LinkClockRow> {
    let row = |row: ClockRow| LinkClockRow {
        case: row.case,
        method: row.method,
        worst_ms: row.worst_ms,
        mean_ms: row.mean_ms,
    };
    compare_methods(seeds).into_iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_that_never_answers_has_null_for_figures() {
        let rows = rows(&CLOCK_SEEDS[..1]);
        let never = rows.iter().find(|row| row.method == "timesync-10ms");
        let text = serde_json::to_string(never.unwrap()).unwrap();
        let expected = r#"{"case":"50ppm","method":"timesync-10ms","worst_ms":null,"mean_ms":null}"#;
        assert_eq!(text, expected);
        let ours = rows.iter().find(|row| row.method == "two-way-hulls");
        assert!(ours.and_then(|row| row.worst_ms).is_some_and(|worst_ms| worst_ms < 0.1));
    }
}

//! The table of a replay's smoothed paths: one row per run, their inputs, and the observations that they do not use.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use posebridge_telemetry::TimeDelta;

use super::cells::{count_or_dash, degrees, millimetres, two_digits};
use super::replay::footnotes;
use super::text_table::TextTable;
use crate::metrics::ErrorSummary;

/// One run, smoothed.
#[derive(Clone, Debug)]
pub struct SmoothRow<'a> {
    /// The run's name.
    pub run: &'a str,
    /// The errors of the path; nothing without one.
    pub errors: &'a ErrorSummary,
    /// Fixes that the path stands on; `None` without a path, as in the next two.
    pub fixes_used: Option<usize>,
    /// Fixes that it leaves out.
    pub fixes_left_out: Option<usize>,
    /// Steps of the descent.
    pub iterations: Option<u32>,
    /// How long it took.
    pub duration: TimeDelta,
    /// Observations that it does not read, by the name of their sensor.
    pub unused_observations: &'a BTreeMap<&'static str, u64>,
    /// Why there is no path.
    pub reason: Option<String>,
}

/// Accuracy in millimetres and degrees; below, the runs without a path and the sources that were not read.
pub fn smooth_table(rows: &[SmoothRow<'_>]) -> String {
    let mut table = TextTable::new([
        "smooth",
        "samples",
        "rms mm",
        "max mm",
        "heading rms deg",
        "fixes used",
        "left out",
        "iterations",
        "s",
    ]);
    for row in rows {
        let errors = row.errors;
        table.push([
            row.run.to_owned(),
            errors.samples.to_string(),
            millimetres(errors.position_rms_m),
            millimetres(errors.position_max_m),
            degrees(errors.heading_rms_rad),
            count_or_dash(row.fixes_used),
            count_or_dash(row.fixes_left_out),
            count_or_dash(row.iterations),
            two_digits(Some(row.duration.as_secs_f64())),
        ]);
    }
    let mut text = table.render() + &footnotes(rows.iter().map(|row| (row.run, row.errors)));
    for row in rows {
        // Writing to a String cannot fail.
        if let Some(reason) = &row.reason {
            let _ = writeln!(text, "{}: no smoothed path: {reason}", row.run);
        }
        if !row.unused_observations.is_empty() {
            let sources: Vec<String> =
                row.unused_observations.iter().map(|(sensor, count)| format!("{sensor} ({count})")).collect();
            let _ = writeln!(
                text,
                "{}: the smoother reads wheels, gyro and fixes only, not: {}",
                row.run,
                sources.join(", ")
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_has_figures_and_a_missing_one_its_reason() {
        let errors = ErrorSummary {
            samples: 17,
            position_rms_m: Some(0.0125),
            position_max_m: Some(0.031),
            heading_rms_rad: None,
            ..ErrorSummary::default()
        };
        let nothing = ErrorSummary::default();
        let (heard, unheard) = (BTreeMap::new(), BTreeMap::from([("compass", 3), ("range", 20)]));
        let table = smooth_table(&[
            SmoothRow {
                run: "one",
                errors: &errors,
                fixes_used: Some(40),
                fixes_left_out: Some(2),
                iterations: Some(6),
                duration: TimeDelta::from_millis(1_234),
                unused_observations: &unheard,
                reason: None,
            },
            SmoothRow {
                run: "two",
                errors: &nothing,
                fixes_used: None,
                fixes_left_out: None,
                iterations: None,
                duration: TimeDelta::ZERO,
                unused_observations: &heard,
                reason: Some("it is empty".to_owned()),
            },
        ]);
        let lines: Vec<Vec<&str>> = table.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(lines[1], ["one", "17", "12.5", "31.0", "-", "40", "2", "6", "1.23"]);
        assert_eq!(lines[2], ["two", "0", "-", "-", "-", "-", "-", "-", "0.00"]);
        let said = "one: the smoother reads wheels, gyro and fixes only, not: compass (3), range (20)\n\
                    two: no smoothed path: it is empty\n";
        assert!(table.ends_with(said), "{table}");
    }
}

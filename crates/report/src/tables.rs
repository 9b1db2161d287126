//! Plain-text tables of runs and replays, and their parts.
//!
//! Numbers are converted to millimetres and degrees here. The tables are values: printing, colours and JSON belong to the program.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use posebridge_telemetry::TimeDelta;

use super::metrics::{ErrorSummary, FilterVerdict, SourceTally, source_verdicts};

pub const NO_VALUE: &str = "-";

fn or_no_value<T>(value: Option<T>, show: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| NO_VALUE.to_owned(), show)
}

pub(crate) fn millimetres(metres: Option<f64>) -> String {
    or_no_value(metres, |metres| number(metres * 1e3))
}

pub fn degrees(radians: Option<f64>) -> String {
    two_digits(radians.map(f64::to_degrees))
}

fn two_digits(value: Option<f64>) -> String {
    or_no_value(value, |value| format!("{value:.2}"))
}

fn count_or_dash(value: Option<impl ToString>) -> String {
    or_no_value(value, |value| value.to_string())
}

/// One digit after the point; scientific notation where that would be too wide.
fn number(value: f64) -> String {
    if value.abs() < 1e9 { format!("{value:.1}") } else { format!("{value:.3e}") }
}

/// Three significant digits, or all digits before the point: these errors span five decades.
pub fn millimetres_three_digits(metres: Option<f64>) -> String {
    three_digits(metres.map(|metres| metres * 1e3))
}

/// Three significant digits, or all digits before the point; scientific notation where that would be too wide.
pub fn three_digits(value: Option<f64>) -> String {
    let Some(value) = value else {
        return NO_VALUE.to_owned();
    };
    match value.abs() {
        size if size >= 1e5 || !size.is_finite() => format!("{value:.1e}"),
        size if size >= 99.95 => format!("{value:.0}"),
        size if size >= 9.995 => format!("{value:.1}"),
        size if size >= 0.9995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

/// Columns of a terminal.
pub const LINE_WIDTH: usize = 80;
const GUTTER: &str = "  ";

/// A label and text beside it, wrapped at spaces to [`LINE_WIDTH`]; a longer word gets its own line.
pub fn wrapped(label: &str, text: &str) -> String {
    let indent = label.chars().count();
    let (mut lines, mut column) = (label.to_owned(), indent);
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if column > indent && column + 1 + length > LINE_WIDTH {
            lines.push('\n');
            lines.push_str(&" ".repeat(indent));
            column = indent;
        } else if column > indent {
            lines.push(' ');
            column += 1;
        }
        lines.push_str(word);
        column += length;
    }
    lines + "\n"
}

/// Rows of cells under a header.
#[derive(Clone, Debug)]
pub struct TextTable {
    rows: Vec<Vec<String>>,
    labels: usize,
}

impl TextTable {
    pub fn new(header: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self { rows: vec![header.into_iter().map(Into::into).collect()], labels: 1 }
    }

    /// Number of leading columns that identify a row (default 1).
    #[must_use]
    pub fn labels(self, labels: usize) -> Self {
        Self { labels, ..self }
    }

    /// Appends a row; missing cells at its end stay blank.
    pub fn push(&mut self, row: impl IntoIterator<Item = String>) {
        self.rows.push(row.into_iter().collect());
    }

    /// Leaves out the columns in which no row has a value.
    #[must_use]
    pub fn without_empty_columns(mut self) -> Self {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let has_value = |column: &usize| {
            let cells = self.rows.iter().skip(1).filter_map(|row| row.get(*column));
            cells.into_iter().any(|cell| cell != NO_VALUE)
        };
        let kept: Vec<usize> = (0..columns).filter(|column| *column < self.labels || has_value(column)).collect();
        for row in &mut self.rows {
            *row = kept.iter().filter_map(|column| row.get(*column).cloned()).collect();
        }
        self
    }

    /// One line per row, each with a line feed and without trailing spaces. Columns that do not fit into a line continue below, after
    /// those that identify the row.
    pub fn render(&self) -> String {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let widths: Vec<usize> = (0..columns)
            .map(|column| {
                let cells = self.rows.iter().filter_map(|row| row.get(column));
                cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
            })
            .collect();
        let parts = self.parts(&widths);
        let text = parts.iter().map(|part| {
            let lines = self.rows.iter().map(|row| line(row, part, &widths));
            lines.collect::<String>()
        });
        text.collect::<Vec<_>>().join("\n")
    }

    /// The columns of each part of the table that fits into a line.
    fn parts(&self, widths: &[usize]) -> Vec<Vec<usize>> {
        let labels: Vec<usize> = (0..self.labels.min(widths.len())).collect();
        let width_of = |part: &[usize]| {
            let cells: usize = part.iter().filter_map(|column| widths.get(*column)).sum();
            cells + GUTTER.len() * part.len().saturating_sub(1)
        };
        let (mut parts, mut part) = (Vec::new(), labels.clone());
        for column in labels.len()..widths.len() {
            part.push(column);
            if width_of(&part) > LINE_WIDTH && part.len() > labels.len() + 1 {
                part.pop();
                parts.push(std::mem::replace(&mut part, labels.clone()));
                part.push(column);
            }
        }
        parts.push(part);
        parts
    }
}

fn line(row: &[String], columns: &[usize], widths: &[usize]) -> String {
    let mut line = String::new();
    for (index, column) in columns.iter().enumerate() {
        let (Some(cell), Some(width)) = (row.get(*column), widths.get(*column)) else { continue };
        let padded = if index == 0 { format!("{cell:<width$}") } else { format!("{GUTTER}{cell:>width$}") };
        line.push_str(&padded);
    }
    line.trim_end().to_owned() + "\n"
}

/// A row of the accuracy table of a run.
#[derive(Clone, Copy, Debug)]
pub struct RunRow<'a> {
    /// The source, for example "brick's own odometry" or "estimate".
    pub name: &'a str,
    pub errors: &'a ErrorSummary,
}

/// Accuracy of each row in millimetres and degrees; the last column is the ratio of the first row's rms position error to the row's.
pub fn run_table(rows: &[RunRow<'_>]) -> String {
    let mut table = TextTable::new(["position error", "rms mm", "max mm", "end mm", "heading deg", "better by"]);
    let reference_m = rows.first().and_then(|row| row.errors.position_rms_m);
    for row in rows {
        let errors = row.errors;
        table.push([
            row.name.to_owned(),
            millimetres(errors.position_rms_m),
            millimetres(errors.position_max_m),
            millimetres(errors.position_end_m),
            degrees(errors.heading_rms_rad),
            ratio(reference_m, errors.position_rms_m),
        ]);
    }
    table.render() + &footnotes(rows.iter().map(|row| (row.name, row.errors)))
}

/// A robot of a run with several.
#[derive(Clone, Debug, Default)]
pub struct RobotRow {
    pub label: String,
    pub observations: u64,
    pub estimates: u64,
    /// Of its own odometry and of the estimates; `None` without truth.
    pub errors: Option<RobotErrors>,
}

/// Errors of one robot.
#[derive(Clone, Debug, Default)]
pub struct RobotErrors {
    pub odometry: ErrorSummary,
    pub estimate: ErrorSummary,
}

pub fn robots_table(rows: &[RobotRow]) -> String {
    let mut table =
        TextTable::new(["robot", "received", "sent", "odometry mm", "estimate mm", "max mm", "heading deg", "ANEES"]);
    for row in rows {
        let mut cells = vec![row.label.clone(), row.observations.to_string(), row.estimates.to_string()];
        if let Some(RobotErrors { odometry, estimate }) = &row.errors {
            cells.extend([
                millimetres(odometry.position_rms_m),
                millimetres(estimate.position_rms_m),
                millimetres(estimate.position_max_m),
                degrees(estimate.heading_rms_rad),
                two_digits(estimate.anees),
            ]);
        }
        table.push(cells);
    }
    table.render()
}

fn ratio(reference: Option<f64>, value: Option<f64>) -> String {
    match (reference, value) {
        (Some(reference), Some(value)) if (reference / value).is_finite() => {
            format!("{:.1}x", reference / value)
        }
        (Some(_) | None, _) => NO_VALUE.to_owned(),
    }
}

/// An estimator in a comparison.
#[derive(Clone, Copy, Debug)]
pub struct EstimatorRow<'a> {
    /// The estimator's name in the configuration, or the run.
    pub name: &'a str,
    /// Over one run, or the mean over several.
    pub errors: &'a ErrorSummary,
    /// Number of independent runs; determines the ANEES band.
    pub runs: u64,
    pub sources: &'a [SourceTally],
}

impl EstimatorRow<'_> {
    pub fn verdict(&self) -> FilterVerdict {
        FilterVerdict::new(self.errors, self.runs, source_verdicts(self.sources))
    }
}

pub fn estimator_table(rows: &[EstimatorRow<'_>]) -> String {
    accuracy_table("estimator", rows)
}

/// One estimator, with a row for each run.
pub fn runs_table(rows: &[EstimatorRow<'_>]) -> String {
    accuracy_table("run", rows)
}

fn accuracy_table(what: &str, rows: &[EstimatorRow<'_>]) -> String {
    let mut table = TextTable::new([what, "rms mm", "max mm", "end mm", "heading deg", "ANEES", "verdict"]);
    for row in rows {
        let errors = row.errors;
        table.push([
            row.name.to_owned(),
            millimetres(errors.position_rms_m),
            millimetres(errors.position_max_m),
            millimetres(errors.position_end_m),
            degrees(errors.heading_rms_rad),
            two_digits(errors.anees),
            row.verdict().finding.as_text().to_owned(),
        ]);
    }
    table.without_empty_columns().render() + &footnotes(rows.iter().map(|row| (row.name, row.errors)))
}

/// Fusion outcomes of each sensor, and whether its configured noise is too small or too large. An outcome that no observation had is
/// left out.
pub fn source_table(tallies: &[SourceTally]) -> String {
    let counts: Vec<[u64; 8]> = tallies.iter().map(SourceTally::counts).collect();
    let has = |outcome: &usize| *outcome == 0 || counts.iter().any(|counts| counts[*outcome] > 0);
    let shown: Vec<usize> = (0..SourceTally::COUNT_HEADINGS.len()).filter(has).collect();
    let headings = shown.iter().map(|outcome| SourceTally::COUNT_HEADINGS[*outcome]);
    let mut table = TextTable::new(["source"].into_iter().chain(headings).chain(["NIS/dof", "due", "verdict"]));
    for (tally, counts) in tallies.iter().zip(&counts) {
        let counts = shown.iter().map(|outcome| counts[*outcome].to_string());
        let verdict = tally.verdict();
        let due = or_no_value(verdict.band, |band| format!("{:.2}-{:.2}", band.low, band.high));
        let assessment = [two_digits(verdict.mean_nis_per_dof), due, verdict.finding.as_text().to_owned()];
        let name = format!("{} ({})", tally.sensor.name(), tally.sensor);
        table.push(std::iter::once(name).chain(counts).chain(assessment));
    }
    table.render()
}

/// A line for each row with omitted errors.
fn footnotes<'a>(rows: impl Iterator<Item = (&'a str, &'a ErrorSummary)>) -> String {
    rows.flat_map(|(name, errors)| {
        [(errors.dropped, "not finite"), (errors.refused_covariances, "covariance not positive definite")]
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(move |(count, what)| format!("{name}: samples left out, {what}: {count}\n"))
    })
    .collect()
}

/// A smoothed run.
#[derive(Clone, Debug)]
pub struct SmoothRow<'a> {
    pub run: &'a str,
    /// Errors of the path; empty without one.
    pub errors: &'a ErrorSummary,
    /// `None` without a path, as in the next two.
    pub fixes_used: Option<usize>,
    pub fixes_left_out: Option<usize>,
    pub iterations: Option<u32>,
    pub duration: TimeDelta,
    /// Observations that say nothing of a pose, by sensor.
    pub unused_observations: &'a BTreeMap<&'static str, u64>,
    pub reason: Option<String>,
    /// Why a path is not final.
    pub shortfall: Option<String>,
}

/// Accuracy in millimetres and degrees; below, the runs without a path and the unused sources.
pub fn smooth_table(name: &str, rows: &[SmoothRow<'_>]) -> String {
    let mut table = TextTable::new([name, "rms mm", "max mm", "heading deg", "used", "left out", "iterations", "s"]);
    for row in rows {
        let errors = row.errors;
        table.push([
            row.run.to_owned(),
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
        if let Some(shortfall) = &row.shortfall {
            let _ = writeln!(text, "{}: not converged: {shortfall}", row.run);
        }
        if !row.unused_observations.is_empty() {
            let sources: Vec<String> =
                row.unused_observations.iter().map(|(sensor, count)| format!("{sensor} ({count})")).collect();
            let _ = writeln!(text, "{}: of no use to the smoother: {}", row.run, sources.join(", "));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_digits_over_five_decades() {
        let cells = [0.00133, 0.0137, 0.2244, 1.8121, 425.462].map(|metres| millimetres_three_digits(Some(metres)));
        assert_eq!(cells, ["1.33", "13.7", "224", "1812", "4.3e5"]);
        assert_eq!(three_digits(Some(0.0104)), "0.010");
        assert_eq!(three_digits(None), "-");
    }

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
        let (none, unused) = (BTreeMap::new(), BTreeMap::from([("compass", 3), ("range", 20)]));
        let table = smooth_table(
            "smooth",
            &[
                SmoothRow {
                    run: "one",
                    errors: &errors,
                    fixes_used: Some(40),
                    fixes_left_out: Some(2),
                    iterations: Some(6),
                    duration: TimeDelta::from_millis(1_234),
                    unused_observations: &unused,
                    reason: None,
                    shortfall: Some("it still moves".to_owned()),
                },
                SmoothRow {
                    run: "two",
                    errors: &nothing,
                    fixes_used: None,
                    fixes_left_out: None,
                    iterations: None,
                    duration: TimeDelta::ZERO,
                    unused_observations: &none,
                    reason: Some("it is empty".to_owned()),
                    shortfall: None,
                },
            ],
        );
        let lines: Vec<Vec<&str>> = table.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(lines[1], ["one", "12.5", "31.0", "-", "40", "2", "6", "1.23"]);
        assert_eq!(lines[2], ["two", "-", "-", "-", "-", "-", "-", "0.00"]);
        let expected = "one: not converged: it still moves\n\
                    one: of no use to the smoother: compass (3), range (20)\n\
                    two: no smoothed path: it is empty\n";
        assert!(table.ends_with(expected), "{table}");
    }
}

//! The report about the rounds of the square.

use posebridge_lab::end_errors::PairedDifference;
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};
use posebridge_report::report::{Format, Report, Table, Unit};
use posebridge_report::tables::NO_VALUE;
use posebridge_sim::montecarlo::Scenario;
use serde_json::{Value, json};

use super::rounds::{PAPER_END_M, RoundsResult, RowResult, SensorSet};
use crate::lab::experiments::again;
use crate::lab::experiments::recorded::RobotDrives;

/// The rounds of a scenario.
pub(super) fn of_scenario(scenario: &Scenario, runs: u32, found: &RoundsResult) -> Report {
    let headline = format!("End of {runs} rounds of the square, seed {}", scenario.seed);
    let mut report = report(headline, again::rerun_command(None), "true", found);
    report.data("seed", json!(scenario.seed));
    report.data("runs", json!(runs));
    report
}

/// The rounds of a real robot.
pub(super) fn of_recordings(drives: &RobotDrives, found: &RoundsResult) -> Report {
    let names = drives.names();
    let headline =
        format!("End of {} recorded drives ({}), judged by {}", names.len(), names.join(", "), drives.reference_name());
    let mut report = report(headline, drives.command(), "camera", found);
    report.data("recordings", json!(names));
    report.data("runs", json!(names.len()));
    report.data("judged_by", json!(drives.reference_name()));
    report
}

/// `truth` is what is called true in the pictures.
fn report(headline: String, command: String, truth: &str, found: &RoundsResult) -> Report {
    let mut report = Report::new("lab-indirect", "The indirect Kalman filter on a square");
    report.background(
        "A robot drives round a square by its wheels, believes that it is back, and is not. What do two accelerometers know \
         about that, and what does it change to feed the error back?",
    );
    report.command(command);
    report.heading(headline);
    report.table("rows", &table(&found.rows));
    report.paragraph(format!(
        "p95: 95 % of the ends are below. Within: {:.1} cm in x, {:.0} cm in y, the end of the paper's fused run; the last number is in both. Nearer: rounds that end \
         nearer than the wheels alone, and than feed-forward from the same sensors. Better: mean squared error of feed-forward less \
         that of feedback.",
        100.0 * PAPER_END_M.0,
        100.0 * PAPER_END_M.1
    ));
    report.data("paper_end_m", json!({ "x": PAPER_END_M.0, "y": PAPER_END_M.1 }));
    let (tracks, ends) = (tracks(truth, found), ends(found));
    report.chart(&tracks, tracks.title.as_str());
    report.chart(&ends, ends.title.as_str());
    report
}

fn table(rows: &[RowResult]) -> Table<'_, RowResult> {
    let metres = Format::new(Unit::Named("m"), 3);
    let is_fused = |row: &RowResult| row.row.sensors != SensorSet::Wheels;
    Table::of(rows)
        .text("filter", "filter", |row| row.row.filter.to_owned())
        .text("sensors", "sensors", |row| row.row.sensors.name().to_owned())
        .labels(2)
        .data("runs", |row| json!(row.summary.runs))
        .number("rms_x_m", "rms x", metres, |row| Some(row.summary.rms_m.0))
        .number("rms_y_m", "y", metres, |row| Some(row.summary.rms_m.1))
        .number("p95_x_m", "p95 x", metres, |row| Some(row.summary.p95_m.0))
        .number("p95_y_m", "y", metres, |row| Some(row.summary.p95_m.1))
        .number("median_m", "median", metres, |row| Some(row.summary.median_m))
        .number("anees", "NEES/3", Format::new(Unit::None, 2), |row| row.summary.anees)
        .count("within_x", "within x", |row| row.summary.within.0)
        .count("within_y", "y", |row| row.summary.within.1)
        .count("within_both", "both", |row| row.summary.within.2)
        .optional_count("", "nearer than wheels", move |row| is_fused(row).then_some(row.nearer_than_wheels))
        .data("nearer_than_wheels", |row| json!(row.nearer_than_wheels))
        .optional_count("nearer_than_feed_forward", "than feed-forward", |row| row.nearer_than_twin)
        .text("", "better by x / y cm2", |row| row.gain_on_twin.as_ref().map_or(NO_VALUE.to_owned(), gain_cm2))
        .data("better_than_feed_forward_m2", |row| json!(row.gain_on_twin.as_ref().map(gain_json)))
        .data("ends_m", |row| row.ends.iter().map(|end| json!(end.map(|end| [end.dx_m, end.dy_m]))).collect())
}

/// Means of squares and their standard deviations.
fn gain_cm2(gain: &PairedDifference) -> String {
    let of = |mean_m2: f64, sigma_m2: f64| format!("{:+.1}±{:.1}", 1e4 * mean_m2, 1e4 * sigma_m2);
    format!("{} / {}", of(gain.mean_m2.0, gain.sigma_m2.0), of(gain.mean_m2.1, gain.sigma_m2.1))
}

fn gain_json(gain: &PairedDifference) -> Value {
    json!({ "x": gain.mean_m2.0, "x_sigma": gain.sigma_m2.0, "y": gain.mean_m2.1, "y_sigma": gain.sigma_m2.1 })
}

/// Short enough for a legend.
fn name(found: &RowResult) -> String {
    let how = match found.row.filter {
        "indirect" => "forward",
        "indirect-feedback" => "feedback",
        other => other,
    };
    match found.row.sensors {
        SensorSet::Wheels => "wheels".to_owned(),
        SensorSet::Accelerometers => format!("{how} + acc."),
        SensorSet::AccelerometersAndGyro => format!("{how} + gyro"),
    }
}

fn map(y_height_px: f64, curves: Vec<Curve>) -> Axes {
    Axes { x_name: "x [m]".to_owned(), y_name: "y [m]".to_owned(), height_px: y_height_px, is_map: true, curves }
}

fn plot(title: &str, axes: Axes) -> Plot {
    Plot { title: title.to_owned(), key_figures: String::new(), axes: vec![axes] }
}

fn tracks(true_name: &str, found: &RoundsResult) -> Plot {
    let truth = (!found.truth_m.is_empty())
        .then(|| Curve { name: true_name.to_owned(), shape: CurveShape::Line(found.truth_m.clone()) });
    let estimated = found.rows.iter().map(|row| Curve { name: name(row), shape: CurveShape::Line(row.path_m.clone()) });
    let curves = truth.into_iter().chain(estimated).collect();
    plot("The first round: true and believed ways", map(560.0, curves))
}

fn ends(found: &RoundsResult) -> Plot {
    let curves = found.rows.iter().map(|row| Curve {
        name: name(row),
        shape: CurveShape::Dots(row.ends.iter().flatten().map(|end| (end.dx_m, end.dy_m)).collect()),
    });
    plot("Where the rounds end: believed minus true", map(480.0, curves.collect()))
}

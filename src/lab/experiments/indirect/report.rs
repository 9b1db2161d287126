//! The report about the rounds of the square.

use posebridge_lab::end_errors::PairedDifference;
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot, render_plot};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::{NO_VALUE, TextTable};
use posebridge_sim::montecarlo::Scenario;
use serde_json::{Value, json};

use super::rounds::{PAPER_END_M, RoundsResult, RowResult, SensorSet};
use crate::lab::experiments::again;
use crate::lab::experiments::recorded::RobotDrives;
use crate::tools::experiment_output::ExperimentOutcome;

const HEADER: [&str; 10] = [
    "filter",
    "sensors",
    "rms x/y m",
    "95 % below x/y m",
    "median m",
    "within x/y/both",
    "nearer than wheels",
    "than feed-forward",
    "better by x/y cm2",
    "NEES/3",
];

/// Whose rounds they are.
pub(super) struct ReportHeader {
    headline: String,
    command: String,
    /// What is called true in the pictures.
    truth: &'static str,
    /// The first entries of the object.
    object: Value,
}

impl ReportHeader {
    pub(super) fn from_scenario(scenario: &Scenario, runs: u32) -> Self {
        Self {
            headline: format!("end of {runs} rounds of the square, seed {}", scenario.seed),
            command: again::rerun_command(None),
            truth: "true",
            object: json!({ "seed": scenario.seed, "runs": runs }),
        }
    }

    pub(super) fn from_recordings(drives: &RobotDrives) -> Self {
        let names = drives.names();
        Self {
            headline: format!(
                "end of {} recorded drives ({}), judged by {}",
                names.len(),
                names.join(", "),
                drives.reference_name()
            ),
            command: drives.command(),
            truth: "camera",
            object: json!({
                "recordings": names,
                "runs": names.len(),
                "judged_by": drives.reference_name(),
            }),
        }
    }
}

/// Table, page and object.
pub(super) fn outcome(report_header: &ReportHeader, found: &RoundsResult) -> ExperimentOutcome {
    let headline = format!(
        "{}; within: {:.1} cm in x, {:.0} cm in y, the end of the paper's fused run",
        report_header.headline,
        100.0 * PAPER_END_M.0,
        100.0 * PAPER_END_M.1
    );
    let rows: Vec<[String; 10]> = found.rows.iter().map(cells).collect();
    let mut table = TextTable::new(HEADER);
    for row in &rows {
        table.push(row.clone());
    }
    let text = format!("{headline}\n{}", table.render());
    let page = ReportPage {
        title: "The indirect Kalman filter on a square".to_owned(),
        blocks: vec![
            ReportBlock::Text(
                "A robot drives round a square by its wheels, believes that it is back, and is not. What do two accelerometers know \
                 about that, and what does it change to feed the error back?"
                    .to_owned(),
            ),
            ReportBlock::PreformattedText(report_header.command.clone()),
            ReportBlock::Heading(headline),
            ReportBlock::table(&HEADER, rows.into_iter().map(Vec::from).collect()),
            tracks(report_header.truth, found),
            ends(found),
        ],
    };
    let mut json = report_header.object.clone();
    json["paper_end_m"] = json!({ "x": PAPER_END_M.0, "y": PAPER_END_M.1 });
    json["rows"] = found.rows.iter().map(object).collect();
    ExperimentOutcome { name: "lab-indirect", page, text, json }
}

fn cells(found: &RowResult) -> [String; 10] {
    let sum = &found.summary;
    let pair = |(x, y): (f64, f64)| format!("{x:.3} / {y:.3}");
    let is_fused = found.row.sensors != SensorSet::Wheels;
    let count = |count: Option<usize>| count.map_or_else(|| NO_VALUE.to_owned(), |n| n.to_string());
    [
        found.row.filter.to_owned(),
        found.row.sensors.name().to_owned(),
        pair(sum.rms_m),
        pair(sum.p95_m),
        format!("{:.3}", sum.median_m),
        format!("{} / {} / {}", sum.within.0, sum.within.1, sum.within.2),
        count(is_fused.then_some(found.nearer_than_wheels)),
        count(found.nearer_than_twin),
        found.gain_on_twin.map_or_else(|| NO_VALUE.to_owned(), |gain| gain_cm2(&gain)),
        sum.anees.map_or_else(|| NO_VALUE.to_owned(), |anees| format!("{anees:.2}")),
    ]
}

/// Means of squares and their standard deviations.
fn gain_cm2(gain: &PairedDifference) -> String {
    let of = |mean_m2: f64, sigma_m2: f64| format!("{:+.1}±{:.1}", 1e4 * mean_m2, 1e4 * sigma_m2);
    format!("{} / {}", of(gain.mean_m2.0, gain.sigma_m2.0), of(gain.mean_m2.1, gain.sigma_m2.1))
}

fn object(found: &RowResult) -> Value {
    let sum = &found.summary;
    json!({
        "filter": found.row.filter,
        "sensors": found.row.sensors.name(),
        "runs": sum.runs,
        "rms_x_m": sum.rms_m.0,
        "rms_y_m": sum.rms_m.1,
        "p95_x_m": sum.p95_m.0,
        "p95_y_m": sum.p95_m.1,
        "median_m": sum.median_m,
        "within_x": sum.within.0,
        "within_y": sum.within.1,
        "within_both": sum.within.2,
        "nearer_than_wheels": found.nearer_than_wheels,
        "nearer_than_feed_forward": found.nearer_than_twin,
        "better_than_feed_forward_m2": found.gain_on_twin.map(|gain| json!({
            "x": gain.mean_m2.0, "x_sigma": gain.sigma_m2.0, "y": gain.mean_m2.1, "y_sigma": gain.sigma_m2.1,
        })),
        "anees": sum.anees,
        "ends_m": found.ends.iter().map(|end| end.map(|end| [end.dx_m, end.dy_m])).collect::<Vec<_>>(),
    })
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

fn figure(title: &str, axes: Axes) -> ReportBlock {
    let picture = Plot { title: title.to_owned(), key_figures: String::new(), axes: vec![axes] };
    ReportBlock::Figure { svg: render_plot(&picture), caption: title.to_owned() }
}

fn tracks(true_name: &str, found: &RoundsResult) -> ReportBlock {
    let truth = (!found.truth_m.is_empty())
        .then(|| Curve { name: true_name.to_owned(), shape: CurveShape::Line(found.truth_m.clone()) });
    let estimated = found.rows.iter().map(|row| Curve { name: name(row), shape: CurveShape::Line(row.path_m.clone()) });
    let curves = truth.into_iter().chain(estimated).collect();
    figure("The first round: true and believed ways", map(560.0, curves))
}

fn ends(found: &RoundsResult) -> ReportBlock {
    let curves = found.rows.iter().map(|row| Curve {
        name: name(row),
        shape: CurveShape::Dots(row.ends.iter().flatten().map(|end| (end.dx_m, end.dy_m)).collect()),
    });
    figure("Where the rounds end: believed minus true", map(480.0, curves.collect()))
}

//! The report of the experiment on a recording.

use posebridge_lab::wall::{ForecastScore, GateStatistics, ManualStepFit, RangeForecast, StepFit, WallStepError};
use posebridge_report::report::{Format, Report, Table, Unit};
use serde_json::{Value, json};

use super::pictures;

/// What was found of one run.
pub(super) struct RunResult {
    pub(super) name: String,
    pub(super) readings: usize,
    pub(super) knows_input: bool,
    pub(super) by_hand: Result<ManualStepFit, WallStepError>,
    pub(super) fit: Result<StepFit, WallStepError>,
    pub(super) forecasts: Vec<RangeForecast>,
    pub(super) foreign_filter: Vec<(f64, f64)>,
    /// What the filter's gate did.
    pub(super) gate: Option<GateStatistics>,
    /// Against the line through two.
    pub(super) score_against_line: Option<ForecastScore>,
    /// Against another program's filter.
    pub(super) score_against_foreign: Option<ForecastScore>,
}

/// `command` gives the report again.
pub(super) fn report(descriptor: &str, command: String, found: &[RunResult]) -> Report {
    let mut report = Report::new("lab-wall", "The distance to a wall: a recording");
    report.background(
        "Nobody measured these cars. Drive and noise are found anew at each reading, from the readings before it alone; then the \
         reading is foretold and compared.",
    );
    report.command(command);
    add_steps(&mut report, found);
    add_scores(&mut report, found);
    for run in found {
        pictures::add(&mut report, &pictures::foreseen(&run.name, &run.forecasts, &run.foreign_filter));
    }
    report.data("recording", json!(descriptor));
    report.data("runs", found.iter().map(object).collect());
    report
}

const fn input_name(run: &RunResult) -> &'static str {
    if run.knows_input { "recorded" } else { "assumed" }
}

fn add_steps(report: &mut Report, found: &[RunResult]) {
    report.heading("Step: m/s and s under the input 1");
    report.paragraph("The input is 1 at PWM 80, or for the whole drive where nobody wrote it down.");
    let two = Format::new(Unit::None, 2);
    let steady = |run: &RunResult| run.fit.as_ref().ok().map(|fit| fit.steady_m_per_s);
    let rise = |run: &RunResult| run.fit.as_ref().ok().map(|fit| fit.rise_90_s);
    let table = Table::of(found)
        .text("", "run", |run| run.name.clone())
        .count("", "readings", |run| run.readings)
        .text("", "input", |run| input_name(run).to_owned())
        .number("", "v_ss by lines", two, |run| run.by_hand.as_ref().ok().map(|hand| hand.steady_m_per_s))
        .uncertain("", "v_ss by fit", two, move |run| Some(steady(run)?.0), move |run| Some(steady(run)?.1))
        .uncertain("", "t90 by fit", two, move |run| Some(rise(run)?.0), move |run| Some(rise(run)?.1));
    report.table("", &table);
}

fn add_scores(report: &mut Report, found: &[RunResult]) {
    report.heading("Each reading foretold from those before it, rms");
    report.paragraph(
        "Against a line through two readings, and against their own filter. Gate: its mean half-width, and how many readings it refused.",
    );
    let mm = Format::new(Unit::Millimetres, 1);
    let table = Table::of(found)
        .text("", "run", |run| run.name.clone())
        .optional_count("", "readings", |run| Some(run.score_against_line?.readings))
        .number("", "filter", mm, |run| Some(run.score_against_line?.kalman_rms_m))
        .number("", "line", mm, |run| Some(run.score_against_line?.other_rms_m))
        .number("", "gate", Format::new(Unit::Millimetres, 0), |run| Some(run.gate?.mean_m))
        .optional_count("", "refused", |run| Some(run.gate?.gated))
        .optional_count("", "theirs: readings", |run| Some(run.score_against_foreign?.readings))
        .number("", "filter", mm, |run| Some(run.score_against_foreign?.kalman_rms_m))
        .number("", "theirs", mm, |run| Some(run.score_against_foreign?.other_rms_m));
    report.table("", &table);
}

fn object(run: &RunResult) -> Value {
    let scored = |score: Option<ForecastScore>| {
        score.map(|score| {
            json!({
                "readings": score.readings,
                "filter_rms_m": score.kalman_rms_m,
                "other_rms_m": score.other_rms_m,
            })
        })
    };
    json!({
        "name": run.name,
        "readings": run.readings,
        "input": input_name(run),
        "fit": run.fit.as_ref().ok().map(|fit| json!({
            "steady_m_per_s": fit.steady_m_per_s.0,
            "steady_sigma_m_per_s": fit.steady_m_per_s.1,
            "rise_90_s": fit.rise_90_s.0,
            "rise_90_sigma_s": fit.rise_90_s.1,
        })),
        "no_fit": run.fit.as_ref().err().map(ToString::to_string),
        "no_hand": run.by_hand.as_ref().err().map(ToString::to_string),
        "gate": run.gate.map(|gate| json!({
            "readings": gate.readings,
            "refused": gate.gated,
            "mean_m": gate.mean_m,
        })),
        "against_line": scored(run.score_against_line),
        "against_theirs": scored(run.score_against_foreign),
        "foreseen": run.forecasts.iter().map(|foreseen| json!({
            "at_s": foreseen.at_s,
            "range_m": foreseen.range_m,
            "filter_m": foreseen.kalman_m,
            "line_m": foreseen.line_m,
            "gate_m": foreseen.gate_m,
            "refused": foreseen.is_gated,
            "steady_m_per_s": foreseen.plant.steady_m_per_s,
            "time_constant_s": foreseen.plant.time_constant_s,
            "process_m": foreseen.plant.noise.process_m,
            "range_sigma_m": foreseen.plant.noise.range_m,
        })).collect::<Vec<_>>(),
    })
}

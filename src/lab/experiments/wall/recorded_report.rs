//! The report of the experiment on a recording.

use posebridge_lab::wall::{ForecastScore, GateStatistics, ManualStepFit, RangeForecast, StepFit, WallStepError};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::{NO_VALUE, TextTable};
use serde_json::{Value, json};

use super::pictures;
use crate::tools::experiment_output::ExperimentOutcome;

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

const STEP_HEADER: [&str; 6] = ["run", "readings", "input", "v_ss by lines", "v_ss by fit", "t90 by fit"];
const SCORE_HEADER: [&str; 9] =
    ["run", "readings", "filter mm", "line mm", "gate mm", "refused", "readings", "filter mm", "theirs mm"];

/// Tables, page and object; `command` gives them again.
pub(super) fn outcome(descriptor: &str, command: String, found: &[RunResult]) -> ExperimentOutcome {
    let steps: Vec<[String; 6]> = found.iter().map(step_row).collect();
    let scores: Vec<[String; 9]> = found.iter().map(score_row).collect();
    let step_line = "step: m/s and s under the input 1 (PWM 80, or the whole drive where nobody wrote it down)";
    let score_line = "each reading foretold from those before it, rms; against a line through two, and against their own filter; \
         gate: its mean half-width, and how many readings it refused";
    let text =
        format!("{step_line}\n{}\n{score_line}\n{}", aligned(STEP_HEADER, &steps), aligned(SCORE_HEADER, &scores));
    let mut parts = vec![
        ReportBlock::Text(
            "Nobody measured these cars. Drive and noise are found anew at each reading, from the readings before it alone; then the \
             reading is foretold and compared."
                .to_owned(),
        ),
        ReportBlock::PreformattedText(command),
        ReportBlock::Heading(step_line.to_owned()),
        ReportBlock::table(&STEP_HEADER, steps.into_iter().map(Vec::from).collect()),
        ReportBlock::Heading(score_line.to_owned()),
        ReportBlock::table(&SCORE_HEADER, scores.into_iter().map(Vec::from).collect()),
    ];
    let figures = found.iter();
    parts.extend(figures.map(|run| pictures::foreseen(&run.name, &run.forecasts, &run.foreign_filter)));
    ExperimentOutcome {
        name: "lab-wall",
        page: ReportPage { title: "The distance to a wall: a recording".to_owned(), blocks: parts },
        text,
        json: json!({ "recording": descriptor, "runs": found.iter().map(object).collect::<Vec<_>>() }),
    }
}

fn aligned<const COLUMNS: usize>(header: [&str; COLUMNS], rows: &[[String; COLUMNS]]) -> String {
    let mut table = TextTable::new(header);
    for row in rows {
        table.push(row.clone());
    }
    table.render()
}

fn none() -> String {
    NO_VALUE.to_owned()
}

fn step_row(run: &RunResult) -> [String; 6] {
    let with_sigma = |(value, sigma): (f64, f64)| format!("{value:.2} +- {sigma:.2}");
    let by_hand = run.by_hand.as_ref().ok();
    let fit = run.fit.as_ref().ok();
    [
        run.name.clone(),
        run.readings.to_string(),
        if run.knows_input { "recorded" } else { "assumed" }.to_owned(),
        by_hand.map_or_else(none, |hand| format!("{:.2}", hand.steady_m_per_s)),
        fit.map_or_else(none, |fit| with_sigma(fit.steady_m_per_s)),
        fit.map_or_else(none, |fit| with_sigma(fit.rise_90_s)),
    ]
}

fn score_row(run: &RunResult) -> [String; 9] {
    let cells = |score: Option<ForecastScore>| match score {
        Some(score) => [
            score.readings.to_string(),
            format!("{:.1}", 1e3 * score.kalman_rms_m),
            format!("{:.1}", 1e3 * score.other_rms_m),
        ],
        None => [none(), none(), none()],
    };
    let [count, kalman, line] = cells(run.score_against_line);
    let [their_count, their_kalman, theirs] = cells(run.score_against_foreign);
    [
        run.name.clone(),
        count,
        kalman,
        line,
        run.gate.map_or_else(none, |gate| format!("{:.0}", 1e3 * gate.mean_m)),
        run.gate.map_or_else(none, |gate| gate.gated.to_string()),
        their_count,
        their_kalman,
        theirs,
    ]
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
        "input": if run.knows_input { "recorded" } else { "assumed" },
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

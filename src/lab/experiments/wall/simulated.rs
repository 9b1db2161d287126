//! The experiment on the simulated car: what is driven, and its report.

use anyhow::Result;
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_lab::wall::{NEAR_WALL_M, StepFit, mean_manual_fit};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::TextTable;
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::wall::WallScene;
use serde_json::{Value, json};

use super::approaches::{ApproachResult, cases, drive_all};
use super::pictures;
use super::steps::{StepResults, ValidationCase, steps};
use crate::console::progress_bar;
use crate::lab::experiments::again;
use crate::tools::experiment_output::ExperimentOutcome;

/// The figures of the paper's own step: v_ss in m/s and t_90 in s.
const PAPER_STEP: (f64, f64) = (1.225, 0.997);

/// What was asked for, read and checked.
pub(super) struct SimulatedSetup {
    pub(super) scene: WallScene,
    pub(super) steps: u32,
    pub(super) runs: u32,
    pub(super) profile_name: String,
    pub(super) link: LinkProfile,
}

/// Runs all drives and reports them.
pub(super) fn run(prepared: &SimulatedSetup) -> Result<ExperimentOutcome> {
    let steps = steps(&prepared.scene, prepared.steps)?;
    let kinds = cases(&prepared.scene, steps.all.model()).len() as u64;
    let bar = progress_bar(kinds * u64::from(prepared.runs), "approaches")?;
    let driven = drive_all(&prepared.scene, &steps, prepared.runs, &prepared.link, || bar.inc(1));
    bar.finish_and_clear();
    let tables = ResultTables::of(prepared, &steps, &driven);
    Ok(ExperimentOutcome {
        name: "lab-wall",
        text: tables.text(),
        page: page(prepared, &steps, &driven, tables),
        json: object(prepared, &steps, &driven),
    })
}

/// A table with its headline, for the terminal and for the page.
struct ResultTable {
    headline: String,
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

struct ResultTables(Vec<ResultTable>);

impl ResultTables {
    fn of(prepared: &SimulatedSetup, steps: &StepResults, driven: &[ApproachResult]) -> Self {
        Self(vec![identification(prepared, steps), validation(steps), gate(steps), approaches(prepared, driven)])
    }

    fn text(&self) -> String {
        let table = self.0.iter().map(|table| {
            let mut text = format!("{}\n", table.headline);
            text += &aligned(&table.header, &table.rows);
            text
        });
        table.collect::<Vec<_>>().join("\n")
    }
}

fn aligned(header: &[&str], rows: &[Vec<String>]) -> String {
    let mut table = TextTable::new(header.iter().copied());
    for row in rows {
        table.push(row.iter().cloned());
    }
    table.render()
}

fn with_sigma((value, sigma): (f64, f64), digits: usize) -> String {
    format!("{value:.digits$} +- {sigma:.digits$}")
}

/// How far from the truth, in per cent.
fn format_error(found: f64, truth: f64) -> String {
    format!("{:+.1} %", 100.0 * (found / truth - 1.0))
}

/// Rows of the table of the step tests, all against the same truth.
struct IdentificationTable {
    truth: WallApproachModel,
    rows: Vec<Vec<String>>,
}

impl IdentificationTable {
    fn push(&mut self, name: &str, figures: [String; 4], model: WallApproachModel) {
        let [v, t90, d, m] = figures;
        self.rows.push(vec![
            name.to_owned(),
            v,
            t90,
            d,
            format_error(model.drag_s_per_m, self.truth.drag_s_per_m),
            m,
            format_error(model.mass_s2_per_m, self.truth.mass_s2_per_m),
        ]);
    }

    fn by_hand(&mut self, name: &str, v: f64, t90: f64) {
        let model = WallApproachModel::from_step_test(v, t90);
        let figures = [
            format!("{v:.3}"),
            format!("{t90:.3}"),
            format!("{:.5}", model.drag_s_per_m),
            format!("{:.5}", model.mass_s2_per_m),
        ];
        self.push(name, figures, model);
    }

    fn fitted(&mut self, name: &str, fit: &StepFit) {
        let figures = [
            with_sigma(fit.steady_m_per_s, 3),
            with_sigma(fit.rise_90_s, 3),
            with_sigma(fit.drag_s_per_m, 4),
            with_sigma(fit.mass_s2_per_m, 4),
        ];
        self.push(name, figures, fit.model());
    }
}

fn identification(prepared: &SimulatedSetup, steps: &StepResults) -> ResultTable {
    let truth = steps.truth;
    let mut table = IdentificationTable { truth, rows: Vec::new() };
    table.by_hand("the paper's figures", PAPER_STEP.0, PAPER_STEP.1);
    if let Some(hand) = steps.by_hand.first() {
        table.by_hand("first step, lines", hand.steady_m_per_s, hand.rise_90_s);
        let by_difference = hand.steady_by_difference_m_per_s;
        table.by_hand("first step, differences", by_difference, hand.rise_90_s);
    }
    if let Some(hand) = mean_manual_fit(&steps.by_hand) {
        let name = format!("{} steps, lines, mean", steps.by_hand.len());
        table.by_hand(&name, hand.steady_m_per_s, hand.rise_90_s);
    }
    table.fitted("first step, fit", &steps.one);
    table.fitted(&format!("{} steps, fit", prepared.steps), &steps.all);
    ResultTable {
        headline: format!(
            "step test: full drive to {} m; the car has d = {:.5} s/m, m = {:.5} s2/m; a reading's noise by the fit: {:.1} mm",
            prepared.scene.step.cutoff_m,
            truth.drag_s_per_m,
            truth.mass_s2_per_m,
            1e3 * steps.all.range_sigma_m
        ),
        header: vec!["", "v_ss m/s", "t90 s", "d s/m", "off", "m s2/m", "off"],
        rows: table.rows,
    }
}

const fn variant_name(variant: RangeFilterVariant) -> &'static str {
    match variant {
        RangeFilterVariant::Paper => "range-kf",
        RangeFilterVariant::Corrected => "range-kf-corrected",
    }
}

fn validation(steps: &StepResults) -> ResultTable {
    let rows = steps.validations.iter().map(|validated| {
        let ValidationCase { process_m, variant, validation: found } = validated;
        vec![
            variant_name(*variant).to_owned(),
            format!("{:.0}", 1e3 * process_m),
            format!("{:.3}", found.gain),
            format!("{:.0}", 1e3 * found.gate_m),
            found.used.to_string(),
            found.gated.to_string(),
            format!("{:.1} %", 100.0 * found.predicted_share()),
            format!("{:.1}", 1e3 * found.innovation_rms_m),
            format!("{:.2}", found.nis),
        ]
    });
    let loop_s = steps.log.loop_intervals_s();
    let measured = loop_s.map_or_else(String::new, |(mean, low, high)| {
        format!("; measured dt {:.2} ms, {:.2} to {:.2}", 1e3 * mean, 1e3 * low, 1e3 * high)
    });
    ResultTable {
        headline: format!("the filter on the first step's own readings, sigma_z 20 mm{measured}"),
        header: vec!["filter", "sigma_u mm", "gain", "gate mm", "used", "gated", "predicted", "rms mm", "NIS"],
        rows: rows.collect(),
    }
}

fn gate(steps: &StepResults) -> ResultTable {
    let rows = steps.gate.iter().map(|trial| {
        vec![
            format!("{:.0}", 1e3 * trial.added_m),
            if trial.is_gated { "refused" } else { "used" }.to_owned(),
            format!("{:.0}", 1e3 * trial.jumped_m),
        ]
    });
    ResultTable {
        headline: "gate: a reading of the step made wrong, range-kf, sigma_u 50 mm".to_owned(),
        header: vec!["added mm", "verdict", "estimate jumps mm"],
        rows: rows.collect(),
    }
}

fn approaches(prepared: &SimulatedSetup, driven: &[ApproachResult]) -> ResultTable {
    let rows = driven.iter().map(|driven| {
        let (case, sum, against) = (driven.case, driven.summary, driven.against_line);
        vec![
            case.source.name().to_owned(),
            case.placement.name().to_owned(),
            case.tuning.to_owned(),
            format!("{:.0}", case.max_pwm),
            format!("{:+.0}", 1e3 * sum.mean_error_m),
            format!("{:.0}", 1e3 * sum.worst_error_m),
            format!("{}/{}", sum.near, sum.runs),
            format!("{:.2}", sum.mean_time_s),
            format!("{:.2}", sum.mean_approach_m_per_s),
            against.nearer.to_string(),
            against.both.to_string(),
        ]
    });
    ResultTable {
        headline: format!(
            "approaches to {:.0} mm, {} runs each, seed {}; host over {}; nearer, and nearer and faster, than the tuned line on the brick at PWM {:.0}",
            1e3 * prepared.scene.approach.target_m,
            prepared.runs,
            prepared.scene.seed,
            prepared.profile_name,
            prepared.scene.approach.most_pwm
        ),
        header: vec![
            "distance by",
            "on",
            "gains",
            "PWM",
            "error mm",
            "worst mm",
            "within 20",
            "time s",
            "speed m/s",
            "nearer",
            "and faster",
        ],
        rows: rows.collect(),
    }
}

fn page(prepared: &SimulatedSetup, steps: &StepResults, driven: &[ApproachResult], tables: ResultTables) -> ReportPage {
    let mut parts = vec![
        ReportBlock::Text(
            "A car drives at a wall. Its range sensor speaks seldom, its motors are slow, and it has to stop a foot before \
             the wall. What does a model of the motors buy?"
                .to_owned(),
        ),
        ReportBlock::PreformattedText(again::rerun_command(None)),
    ];
    let figures = [
        Some(pictures::step(steps)),
        Some(pictures::validation(steps)),
        None,
        Some(pictures::approaches(&prepared.scene, driven)),
    ];
    for (table, figure) in tables.0.into_iter().zip(figures) {
        parts.push(ReportBlock::Heading(table.headline));
        parts.push(ReportBlock::table(&table.header, table.rows));
        parts.extend(figure);
    }
    parts.push(ReportBlock::Text(
        "Error: true distance at which the car first stood, minus the target; negative is too near. Time: from the start to that stand. \
         Speed: the way over that time."
            .to_owned(),
    ));
    ReportPage { title: "The distance to a wall".to_owned(), blocks: parts }
}

fn object(prepared: &SimulatedSetup, steps: &StepResults, driven: &[ApproachResult]) -> Value {
    let fit = |fit: &StepFit| {
        json!({
            "steady_m_per_s": fit.steady_m_per_s.0,
            "steady_sigma_m_per_s": fit.steady_m_per_s.1,
            "rise_90_s": fit.rise_90_s.0,
            "rise_90_sigma_s": fit.rise_90_s.1,
            "drag_s_per_m": fit.drag_s_per_m.0,
            "drag_sigma_s_per_m": fit.drag_s_per_m.1,
            "mass_s2_per_m": fit.mass_s2_per_m.0,
            "mass_sigma_s2_per_m": fit.mass_s2_per_m.1,
            "range_sigma_m": fit.range_sigma_m,
            "readings": fit.readings,
        })
    };
    let paper = WallApproachModel::from_step_test(PAPER_STEP.0, PAPER_STEP.1);
    let model =
        |model: WallApproachModel| json!({ "drag_s_per_m": model.drag_s_per_m, "mass_s2_per_m": model.mass_s2_per_m });
    let validations = steps.validations.iter().map(|validated| {
        json!({
            "filter": variant_name(validated.variant),
            "process_m": validated.process_m,
            "gain": validated.validation.gain,
            "gate_m": validated.validation.gate_m,
            "used": validated.validation.used,
            "gated": validated.validation.gated,
            "predicted_share": validated.validation.predicted_share(),
            "innovation_rms_m": validated.validation.innovation_rms_m,
            "nis": validated.validation.nis,
        })
    });
    let gate = steps
        .gate
        .iter()
        .map(|trial| json!({ "added_m": trial.added_m, "refused": trial.is_gated, "jumped_m": trial.jumped_m }));
    json!({
        "seed": prepared.scene.seed,
        "truth": model(steps.truth),
        "paper": model(paper),
        "by_hand": steps.by_hand.first().map(|hand| json!({
            "steady_m_per_s": hand.steady_m_per_s,
            "steady_by_difference_m_per_s": hand.steady_by_difference_m_per_s,
            "rise_90_s": hand.rise_90_s,
            "start_s": hand.start_s,
            "drag_s_per_m": hand.model.drag_s_per_m,
            "mass_s2_per_m": hand.model.mass_s2_per_m,
        })),
        "fit_of_first": fit(&steps.one),
        "fit": fit(&steps.all),
        "validation": validations.collect::<Vec<_>>(),
        "gate": gate.collect::<Vec<_>>(),
        "near_m": NEAR_WALL_M,
        "link": prepared.profile_name,
        "approaches": driven.iter().map(approach_object).collect::<Vec<_>>(),
    })
}

fn approach_object(driven: &ApproachResult) -> Value {
    let (case, sum) = (driven.case, driven.summary);
    json!({
        "distance_by": case.source.name(),
        "on": case.placement.name(),
        "gains": case.tuning,
        "most_pwm": case.max_pwm,
        "runs": sum.runs,
        "stopped": sum.stopped,
        "near": sum.near,
        "mean_error_m": sum.mean_error_m,
        "rms_error_m": sum.rms_error_m,
        "worst_error_m": sum.worst_error_m,
        "mean_time_s": sum.mean_time_s,
        "mean_approach_m_per_s": sum.mean_approach_m_per_s,
        "nearer_than_line": driven.against_line.nearer,
        "faster_than_line": driven.against_line.faster,
        "nearer_and_faster_than_line": driven.against_line.both,
    })
}

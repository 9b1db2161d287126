//! The experiment on the simulated car, and its report.

use anyhow::Result;
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::numerics::statistics::wilson_interval_95;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_lab::wall::{GateTrial, NEAR_WALL_M, StepFit, mean_manual_fit};
use posebridge_report::quantity::{Format, Quantity, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_sim::impairment::LinkProfile;
use posebridge_sim::wall::WallScene;
use serde_json::{Value, json};

use super::approaches::{ApproachResult, DistanceSource, EstimatorPlacement, drive_all};
use super::pictures;
use super::steps::{StepResults, steps};
use crate::lab::experiments::recorded::rerun_command;

/// Result of the paper's own step: v_ss in m/s and t_90 in s.
const PAPER_STEP: (f64, f64) = (1.225, 0.997);

const MILLIMETRES: Format = Format::new(Unit::Millimetres, 0);
const THREE: Format = Format::new(Unit::None, 3);
const FIVE: Format = Format::new(Unit::None, 5);

pub(super) struct SimulatedSetup {
    pub(super) scene: WallScene,
    pub(super) steps: u32,
    pub(super) runs: u32,
    pub(super) profile_name: String,
    pub(super) link: LinkProfile,
}

pub(super) fn run(prepared: &SimulatedSetup) -> Result<Report> {
    let steps = steps(&prepared.scene, prepared.steps)?;
    let driven = drive_all(&prepared.scene, &steps, prepared.runs, &prepared.link)?;
    let mut report = Report::new("lab-wall", "The distance to a wall");
    report.background(
        "A car drives at a wall. Its range sensor speaks seldom, its motors are slow, and it has to stop a foot before \
         the wall. What does a model of the motors buy?",
    );
    report.command(rerun_command(None));
    report.data("seed", json!(prepared.scene.seed));
    add_identification(&mut report, prepared, &steps);
    add_validation(&mut report, &steps);
    add_gate(&mut report, &steps.gate);
    add_approaches(&mut report, prepared, &driven);
    add_same_speeds(&mut report, prepared, &driven);
    super::population::add(&mut report, prepared.scene.seed, prepared.runs)?;
    Ok(report)
}

struct IdentificationRow {
    name: String,
    /// Steady speed, rise time, d and m, each with its sigma where there is one.
    values: [(f64, Option<f64>); 4],
}

impl IdentificationRow {
    fn by_hand(name: impl Into<String>, steady_m_per_s: f64, rise_90_s: f64) -> Self {
        let model = WallApproachModel::from_step_test(steady_m_per_s, rise_90_s);
        let values = [steady_m_per_s, rise_90_s, model.drag_s_per_m, model.mass_s2_per_m];
        Self { name: name.into(), values: values.map(|value| (value, None)) }
    }

    fn fitted(name: impl Into<String>, fit: &StepFit) -> Self {
        let values = [fit.steady_m_per_s, fit.rise_90_s, fit.drag_s_per_m, fit.mass_s2_per_m];
        Self { name: name.into(), values: values.map(|known| (known.value, Some(known.sigma))) }
    }
}

fn identification_rows(steps: &StepResults, count: u32) -> Vec<IdentificationRow> {
    let mut rows = vec![IdentificationRow::by_hand("the paper's figures", PAPER_STEP.0, PAPER_STEP.1)];
    if let Some(hand) = steps.by_hand.first() {
        rows.push(IdentificationRow::by_hand("first step, lines", hand.steady_m_per_s, hand.rise_90_s));
        let by_difference = hand.steady_by_difference_m_per_s;
        rows.push(IdentificationRow::by_hand("first step, differences", by_difference, hand.rise_90_s));
    }
    if let Some(hand) = mean_manual_fit(&steps.by_hand) {
        let name = format!("{} steps, lines, mean", steps.by_hand.len());
        rows.push(IdentificationRow::by_hand(name, hand.steady_m_per_s, hand.rise_90_s));
    }
    rows.push(IdentificationRow::fitted("first step, fit", &steps.one));
    rows.push(IdentificationRow::fitted(format!("{count} steps, fit"), &steps.all));
    rows
}

fn add_identification(report: &mut Report, prepared: &SimulatedSetup, steps: &StepResults) {
    let truth = steps.truth;
    report.heading(format!("Step test: full drive to {} m", prepared.scene.step.cutoff_m));
    report.values([
        Quantity::new("", "true d", truth.drag_s_per_m, Format::new(Unit::Named("s/m"), 5)),
        Quantity::new("", "true m", truth.mass_s2_per_m, Format::new(Unit::Named("s2/m"), 5)),
        Quantity::new("", "noise of a reading, fit", steps.all.range_sigma_m, Format::new(Unit::Millimetres, 1)),
    ]);
    let off = Format::new(Unit::Percent, 1).signed();
    let rows = identification_rows(steps, prepared.steps);
    let table = Table::of(&rows)
        .text("", "", |row| row.name.clone())
        .uncertain("", "v_ss m/s", THREE, |row| Some(row.values[0].0), |row| row.values[0].1)
        .uncertain("", "t90 s", THREE, |row| Some(row.values[1].0), |row| row.values[1].1)
        .uncertain("", "d s/m", FIVE, |row| Some(row.values[2].0), |row| row.values[2].1)
        .number("", "off", off, |row| Some(row.values[2].0 / truth.drag_s_per_m - 1.0))
        .uncertain("", "m s2/m", FIVE, |row| Some(row.values[3].0), |row| row.values[3].1)
        .number("", "off", off, |row| Some(row.values[3].0 / truth.mass_s2_per_m - 1.0));
    report.table("", &table);
    pictures::add(report, &pictures::step(steps));
    let model =
        |model: WallApproachModel| json!({ "drag_s_per_m": model.drag_s_per_m, "mass_s2_per_m": model.mass_s2_per_m });
    report.data("truth", model(truth));
    report.data("paper", model(WallApproachModel::from_step_test(PAPER_STEP.0, PAPER_STEP.1)));
    let by_hand = steps.by_hand.first().map(|hand| {
        json!({
            "steady_m_per_s": hand.steady_m_per_s,
            "steady_by_difference_m_per_s": hand.steady_by_difference_m_per_s,
            "rise_90_s": hand.rise_90_s,
            "start_s": hand.start_s,
            "drag_s_per_m": hand.model.drag_s_per_m,
            "mass_s2_per_m": hand.model.mass_s2_per_m,
        })
    });
    report.data("by_hand", json!(by_hand));
    report.data("fit_of_first", fit_json(&steps.one));
    report.data("fit", fit_json(&steps.all));
}

fn fit_json(fit: &StepFit) -> Value {
    json!({
        "steady_m_per_s": fit.steady_m_per_s.value,
        "steady_sigma_m_per_s": fit.steady_m_per_s.sigma,
        "rise_90_s": fit.rise_90_s.value,
        "rise_90_sigma_s": fit.rise_90_s.sigma,
        "drag_s_per_m": fit.drag_s_per_m.value,
        "drag_sigma_s_per_m": fit.drag_s_per_m.sigma,
        "mass_s2_per_m": fit.mass_s2_per_m.value,
        "mass_sigma_s2_per_m": fit.mass_s2_per_m.sigma,
        "range_sigma_m": fit.range_sigma_m,
        "readings": fit.readings,
    })
}

const fn variant_name(variant: RangeFilterVariant) -> &'static str {
    match variant {
        RangeFilterVariant::Paper => "range-kf",
        RangeFilterVariant::Corrected => "range-kf-corrected",
    }
}

fn add_validation(report: &mut Report, steps: &StepResults) {
    report.heading("The filter on the first step's own readings, sigma_z 20 mm");
    if let Some((mean_s, low_s, high_s)) = steps.log.loop_intervals_s() {
        let ms = Format::new(Unit::Milliseconds, 2);
        report.values([
            Quantity::new("", "measured dt, mean", mean_s, ms),
            Quantity::new("", "least", low_s, ms),
            Quantity::new("", "most", high_s, ms),
        ]);
    }
    let table = Table::of(&steps.validations)
        .text("filter", "filter", |case| variant_name(case.variant).to_owned())
        .number("process_m", "sigma_u", MILLIMETRES, |case| Some(case.process_m))
        .labels(2)
        .number("gain", "gain", THREE, |case| Some(case.validation.gain))
        .number("gate_m", "gate", MILLIMETRES, |case| Some(case.validation.gate_m))
        .count("used", "used", |case| case.validation.used)
        .count("gated", "gated", |case| case.validation.gated)
        .number("predicted_share", "predicted", Format::new(Unit::Percent, 1), |case| {
            Some(case.validation.predicted_share())
        })
        .number("innovation_rms_m", "rms", Format::new(Unit::Millimetres, 1), |case| {
            Some(case.validation.innovation_rms_m)
        })
        .number("nis", "NIS", Format::new(Unit::None, 2), |case| Some(case.validation.nis));
    report.table("validation", &table);
    pictures::add(report, &pictures::validation(steps));
}

fn add_gate(report: &mut Report, trials: &[GateTrial]) {
    report.heading("Gate: a reading of the step made wrong, range-kf, sigma_u 50 mm");
    let table = Table::of(trials)
        .number("added_m", "added", MILLIMETRES, |trial| Some(trial.added_m))
        .text("", "verdict", |trial| if trial.is_gated { "refused" } else { "used" }.to_owned())
        .data("refused", |trial| json!(trial.is_gated))
        .number("jumped_m", "estimate jumps", MILLIMETRES, |trial| Some(trial.jumped_m));
    report.table("gate", &table);
}

fn add_approaches(report: &mut Report, prepared: &SimulatedSetup, driven: &[ApproachResult]) {
    let approach = &prepared.scene.approach;
    report.heading(format!(
        "Approaches to {:.0} mm, {} runs each, seed {}, host over {}",
        1e3 * approach.target_m,
        prepared.runs,
        prepared.scene.seed,
        prepared.profile_name
    ));
    let seconds = Format::new(Unit::Named("s"), 2);
    let table = Table::of(driven)
        .text("distance_by", "distance by", |row| row.case.source.name().to_owned())
        .text("on", "on", |row| row.case.placement.name().to_owned())
        .text("gains", "gains", |row| row.case.tuning.to_owned())
        .number("most_pwm", "PWM", Format::new(Unit::None, 0), |row| Some(row.case.max_pwm))
        .labels(4)
        .number("mean_error_m", "error", MILLIMETRES.signed(), |row| Some(row.summary.mean_error_m))
        .data("rms_error_m", |row| json!(row.summary.rms_error_m))
        .number("worst_error_m", "worst", MILLIMETRES, |row| Some(row.summary.worst_error_m))
        .text("", "near", |row| format!("{}/{}", row.summary.near, row.summary.runs))
        .data("near", |row| json!(row.summary.near))
        .data("runs", |row| json!(row.summary.runs))
        .data("stopped", |row| json!(row.summary.stopped))
        .number("mean_time_s", "time", seconds, |row| Some(row.summary.mean_time_s))
        .number("mean_approach_m_per_s", "speed", Format::new(Unit::Named("m/s"), 2), |row| {
            Some(row.summary.mean_approach_m_per_s)
        })
        .count("nearer_than_line", "nearer", |row| row.against_line.nearer)
        .data("faster_than_line", |row| json!(row.against_line.faster))
        .count("nearer_and_faster_than_line", "and faster", |row| row.against_line.both);
    let mut near: Vec<(&str, u32, u32)> = Vec::new();
    for row in driven {
        let (name, summary) = (row.case.source.name(), &row.summary);
        let known = near.iter_mut().find(|(known, ..)| *known == name);
        match known {
            Some((_, near, runs)) => {
                *near += summary.near as u32;
                *runs += summary.runs as u32;
            }
            None => near.push((name, summary.near as u32, summary.runs as u32)),
        }
    }
    let shares = near.iter().map(|(name, near, runs)| format!("{near} of {runs} approaches by {name}"));
    report.answer(format!(
        "Within {:.0} mm of the target ended {}.",
        1e3 * NEAR_WALL_M,
        shares.collect::<Vec<_>>().join(", ")
    ));
    report.table("approaches", &table);
    pictures::add(report, &pictures::approaches(&prepared.scene, driven));
    if let Some(plot) = pictures::control_periods(driven) {
        pictures::add(report, &plot);
    }
    report.paragraph(format!(
        "Error: true distance at which the car first stood, minus the target; negative is too near. Near: within {:.0} mm. Time: \
         from the start to that stand. Speed: the way over that time. Nearer, and nearer and faster: than the tuned line on the \
         brick at PWM {:.0}.",
        1e3 * NEAR_WALL_M,
        approach.most_pwm
    ));
    report.data("near_m", json!(NEAR_WALL_M));
    report.data("link", json!(prepared.profile_name));
}

/// On the brick, on the host over the link, and the line on the brick, at the same PWM.
fn add_same_speeds(report: &mut Report, prepared: &SimulatedSetup, driven: &[ApproachResult]) {
    let approach = &prepared.scene.approach;
    report
        .heading(format!("At the same speeds: the brick, the host over {}, and extrapolation", prepared.profile_name));
    report.paragraph(format!(
        "Tuned gains. Within {:.0} mm, and within twice that: share of the runs with its 95 % interval (Wilson).",
        1e3 * NEAR_WALL_M
    ));
    let is_compared = |row: &&ApproachResult| {
        let case = row.case;
        let is_method = match case.placement {
            EstimatorPlacement::Brick => matches!(case.source, DistanceSource::Line | DistanceSource::Faithful),
            EstimatorPlacement::Host => case.source == DistanceSource::Corrected,
        };
        case.tuning == "tuned" && is_method
    };
    let mut rows: Vec<&ApproachResult> = driven.iter().filter(is_compared).collect();
    rows.sort_by(|a, b| a.case.max_pwm.total_cmp(&b.case.max_pwm));
    let within = |row: &ApproachResult, limit_m: f64| {
        row.stops.iter().flatten().filter(|stop| stop.error_m.abs() <= limit_m).count()
    };
    let share = move |row: &ApproachResult, limit_m: f64| {
        let near = within(row, limit_m);
        let [low, high] = wilson_interval_95(near as u64, row.stops.len() as u64);
        format!("{near} ({:.0} to {:.0} %)", 100.0 * low, 100.0 * high)
    };
    let table = Table::of(&rows)
        .number("pwm", "PWM", Format::new(Unit::None, 0), |row| Some(row.case.max_pwm))
        .number("m_per_s", "at most m/s", Format::new(Unit::None, 2), |row| {
            Some(prepared.scene.car.steady_m_per_s * row.case.max_pwm / prepared.scene.car.reference_pwm)
        })
        .text("distance_by", "distance by", |row| row.case.source.name().to_owned())
        .text("on", "on", |row| row.case.placement.name().to_owned())
        .labels(4)
        .text("", "within 20 mm", move |row| share(row, NEAR_WALL_M))
        .text("", "within 40 mm", move |row| share(row, 2.0 * NEAR_WALL_M))
        .data("within_20_mm", move |row| json!(within(row, NEAR_WALL_M)))
        .data("within_40_mm", move |row| json!(within(row, 2.0 * NEAR_WALL_M)))
        .number("worst_error_m", "worst", MILLIMETRES, |row| Some(row.summary.worst_error_m));
    report.table("same_speeds", &table);
    report.data("most_pwm", json!(approach.most_pwm));
}

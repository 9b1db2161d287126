//! `posebridge lab accuracy`: every estimator over the Monte-Carlo scenarios, as a table and a figure.
//!
//! Scenarios are files (`config/scenarios/accuracy/`); docs/lab/accuracy.md explains them.

use anyhow::{Context, Result};
use clap::Args;
use posebridge_estimator::smoother::OfflineError;
use posebridge_lab::accuracy::{DriveScore, FilterScore, ReferenceDrive, Requirement, Verdict, bound_text};
use posebridge_lab::statistics::RunningMean;
use posebridge_link::HostTimer;
use posebridge_report::SourceTally;
use posebridge_report::chart::{AccuracyChart, AccuracyMark, AccuracyPanel, render_accuracy_chart};
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use posebridge_sim::montecarlo::{Drive, Limits, SCENARIOS, Scenario};
use posebridge_telemetry::TimeDelta;
use serde_json::{Value, json};

use super::Estimator;
use super::estimators::{BoundKind, MAIN_FILTER};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::lab::drives::{filter_config, known_drive, load_scenario};
use crate::lab::parallel::run_cases;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `lab accuracy`.
#[derive(Args, Clone, Debug)]
pub struct LabAccuracyArgs {
    /// Bundled scenario by name, or a TOML file. Can be repeated. Default: all bundled ones.
    #[arg(long = "scenario", value_name = "NAME|FILE.toml")]
    pub scenarios: Vec<String>,
    /// Filter by name. Can be repeated. Default: all that estimate a pose.
    #[arg(long = "estimator", value_name = "NAME")]
    pub estimators: Vec<String>,
    /// Number of runs of each scenario. Default: that of its file, mostly 40.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(posebridge_sim::montecarlo::MAX_RUNS)))]
    pub runs: Option<u32>,
    /// Base seed. Default: that of each scenario.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Help text with all scenarios and estimators, from their tables.
pub(super) fn accuracy_help() -> String {
    let scenarios = SCENARIOS.iter().map(|(name, _)| format!("  {name}\n"));
    let estimators =
        Estimator::all().into_iter().map(|estimator| format!("  {:20} {}\n", estimator.name(), estimator.summary()));
    let lines: Vec<String> = std::iter::once("Scenarios:\n".to_owned())
        .chain(scenarios)
        .chain(std::iter::once("Estimators:\n".to_owned()))
        .chain(estimators)
        .collect();
    lines.concat()
}

pub fn execute(args: &LabAccuracyArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let started = timer.now();
    let estimators = estimators(args).before_start()?;
    let planned = plan_scenarios(args).before_start()?;
    let folder = args.output.folder()?;
    let runs: u64 = planned.iter().map(|planned| u64::from(planned.runs)).sum();
    let scored = score_all(planned, &estimators, &timer).before_start()?;
    args.output.write_outcome(&folder, &report(&scored, &estimators))?;
    let bounds = scored.iter().fold(TimeDelta::ZERO, |sum, scored| sum + scored.bound_duration);
    print_line(&format!(
        "{runs} runs with {} estimators in {:.1} s, bounds: {:.1} s of one core",
        estimators.len(),
        (timer.now() - started).as_secs_f64(),
        bounds.as_secs_f64()
    ));
    Ok(())
}

fn estimators(args: &LabAccuracyArgs) -> Result<Vec<Estimator>> {
    if args.estimators.is_empty() {
        return Ok(Estimator::all());
    }
    let named = args.estimators.iter().map(|name| Estimator::from_name(name));
    Ok(named.collect::<Result<_, _>>()?)
}

fn plan_scenarios(args: &LabAccuracyArgs) -> Result<Vec<PlannedScenario>> {
    let names: Vec<String> = if args.scenarios.is_empty() {
        SCENARIOS.iter().map(|(name, _)| (*name).to_owned()).collect()
    } else {
        args.scenarios.clone()
    };
    let planned = names.into_iter().map(|requested| {
        let (name, mut scenario) = load_scenario(&requested)?;
        if let Some(seed) = args.seed {
            scenario = scenario.with_seed(seed);
        }
        Ok(PlannedScenario { name, runs: args.runs.unwrap_or(scenario.runs), scenario })
    });
    planned.collect()
}

fn report(scored: &[ScenarioScores], estimators: &[Estimator]) -> Report {
    let chart = chart(scored, estimators);
    let mut report = Report::new("lab-accuracy", chart.title.as_str());
    report.background(
        "Every estimator gets the same drives. rms is the error of its position, claimed what it says about itself; an ANEES of 1 is \
         an honest claim.",
    );
    let names = names(estimators);
    add_verdicts(&mut report, scored, &names);
    let scenarios = scored.iter().map(|scored| add_scenario(&mut report, scored, &names)).collect();
    report.data("scenarios", scenarios);
    report.figure(render_accuracy_chart(&chart), "Errors (discs) and claims of the estimators, per scenario");
    report
}

struct EstimatorRow<'a> {
    name: &'a str,
    bound_m: Option<f64>,
    scores: &'a EstimatorScores,
    runs: u32,
    limits: Option<Limits>,
}

impl EstimatorRow<'_> {
    /// `None` without limits, and for another filter than the main one.
    fn verdict(&self) -> Option<Verdict> {
        let limits = self.limits.filter(|_| self.name == MAIN_FILTER)?;
        let score = &self.scores.score;
        let (mm, number) = (Format::three_digits(Unit::Millimetres), Format::three_digits(Unit::None));
        let seconds = Format::new(Unit::Named("s"), 2);
        let require = |name, measured, most, format| Requirement { name, measured, least: None, most, format };
        let disturbances = &score.disturbances;
        Some(Verdict::new(&[
            require("rms", score.position_rms_m(), limits.rms_m, mm),
            require("rms/bound", score.ratio_to_bound(self.bound_m), limits.rms_per_bound, number),
            require("rms/undisturbed", self.rms_per_undisturbed(), limits.rms_per_undisturbed, number),
            Requirement { least: limits.anees_least, ..require("ANEES", score.anees(), limits.anees_most, number) },
            require("recovery", self.recovery_s(1.0), limits.recovery_s, seconds),
            require(
                "resets",
                Some(disturbances.resets as f64),
                limits.resets.map(f64::from),
                Format::new(Unit::None, 0),
            ),
            require(
                "fixes gated after slips, of a run,",
                Some(self.fixes_gated_after_slips()),
                limits.fixes_gated_after_slips,
                Format::new(Unit::None, 2),
            ),
        ]))
    }

    /// `None` in a scenario without bursts of wrong fixes.
    fn rms_per_undisturbed(&self) -> Option<f64> {
        self.scores.score.ratio_to_bound(self.scores.undisturbed.position_rms_m())
    }

    /// What this share of the recoveries does not exceed.
    fn recovery_s(&self, share: f64) -> Option<f64> {
        self.scores.score.disturbances.recovery_s(share)
    }

    /// Of a run.
    fn fixes_gated_after_slips(&self) -> f64 {
        self.scores.score.disturbances.fixes_gated_after_slips as f64 / f64::from(self.runs)
    }
}

fn rows<'a>(scored: &'a ScenarioScores, names: &'a [String]) -> Vec<EstimatorRow<'a>> {
    let rows = names.iter().zip(&scored.results).map(|(name, scores)| EstimatorRow {
        name,
        bound_m: scored.bound_rms_m(),
        scores,
        runs: scored.planned.runs,
        limits: scored.planned.scenario.limits,
    });
    rows.collect()
}

/// The scenarios with limits and how the main filter keeps them.
fn add_verdicts(report: &mut Report, scored: &[ScenarioScores], names: &[String]) {
    let of_scenario = scored.iter().filter_map(|scored| {
        let row = rows(scored, names).into_iter().find_map(|row| Some((row.verdict()?, row)));
        row.map(|(verdict, row)| (scored.planned.name.as_str(), row, verdict))
    });
    let judged: Vec<(&str, EstimatorRow<'_>, Verdict)> = of_scenario.collect();
    if judged.is_empty() {
        return;
    }
    let three = Format::three_digits(Unit::None);
    let table = Table::of(&judged)
        .text("", format!("`{MAIN_FILTER}` in"), |(name, ..)| (*name).to_owned())
        .number("", "rms", Format::three_digits(Unit::Millimetres), |(_, row, _)| row.scores.score.position_rms_m())
        .number("", "rms/bound", three, |(_, row, _)| row.scores.score.ratio_to_bound(row.bound_m))
        .number("", "ANEES", three, |(_, row, _)| row.scores.score.anees())
        .number("", "recovery", Format::new(Unit::Named("s"), 2), |(_, row, _)| row.recovery_s(1.0))
        .text("", "limits", |(_, _, verdict)| verdict.as_text().to_owned());
    report.table("", &table);
    for (name, _, verdict) in judged.iter().filter(|(_, _, verdict)| !verdict.failures.is_empty()) {
        report.verdict(verdict.tone(), format!("{name}:"), verdict.failures.join("; "));
    }
}

/// Adds the text of a scenario to the report and returns its JSON object.
fn add_scenario(report: &mut Report, scored: &ScenarioScores, names: &[String]) -> Value {
    let (bound_m, bound_note) = (scored.bound_rms_m(), scored.bound_kind.note());
    let rows = rows(scored, names);
    let table = estimator_table(&rows);
    report.heading(headline(scored));
    report.table("", &table);
    if let Some(table) = disturbance_table(&scored.planned.scenario, &rows) {
        report.table("", &table);
    }
    report.list(rows.iter().map(|row| format!("{}: {}", row.name, row.scores.score.sources_text())));
    report.paragraph(bound_text(bound_m, bound_note.as_deref()));
    report.list(rows.iter().flat_map(|row| row.scores.score.footnotes(row.name)));
    report.list(rows.iter().filter_map(refusal_summary));
    json!({
        "name": scored.planned.name,
        "seed": scored.planned.scenario.seed,
        "runs": scored.planned.runs,
        "bound_rms_m": bound_m,
        "bound_note": bound_note,
        "estimators": table.json(),
    })
}

fn estimator_table<'a>(rows: &'a [EstimatorRow<'a>]) -> Table<'a, EstimatorRow<'a>> {
    let mm = Format::three_digits(Unit::Millimetres);
    let three = Format::three_digits(Unit::None);
    Table::of(rows)
        .text("name", "estimator", |row| row.name.to_owned())
        .number("position_rms_m", "rms", mm, |row| row.scores.score.position_rms_m())
        .number("", "rms/bound", three, |row| row.scores.score.ratio_to_bound(row.bound_m))
        .number("position_mean_m", "mean", mm, |row| row.scores.score.position_mean_m())
        .number("position_max_m", "max", mm, |row| row.scores.score.position_max_m)
        .number("heading_rms_rad", "heading rms", Format::new(Unit::Degrees, 2), |row| {
            row.scores.score.heading_rms_rad()
        })
        .number("claimed_rms_m", "claimed", mm, |row| row.scores.score.claimed_rms_m())
        .number("anees", "ANEES", three, |row| row.scores.score.anees())
        .data("anees_band", |row| json!(row.scores.score.verdict().anees.map(|(_, band)| [band.low, band.high])))
        .text("consistency", "verdict", |row| row.scores.score.verdict().finding.to_string())
        .data("sources", |row| row.scores.score.sources.iter().map(source_json).collect())
        .data("recoveries_s", |row| json!(row.scores.score.disturbances.recoveries_s))
        .data("resets", |row| json!(row.scores.score.disturbances.resets))
        .data("fixes_gated_after_slips", |row| json!(row.scores.score.disturbances.fixes_gated_after_slips))
        .data("rms_per_undisturbed", |row| json!(row.rms_per_undisturbed()))
        .data("limits_missed", |row| json!(row.verdict().map(|verdict| verdict.failures)))
        .data("steps", |row| json!(row.scores.score.steps()))
        .data("steps_without_estimate", |row| json!(row.scores.score.steps_without_estimate))
        .data("steps_not_finite", |row| json!(row.scores.score.steps_not_finite))
        .data("refused_covariances", |row| json!(row.scores.score.refused_covariances))
        .data("run_rms_m", |row| json!(row.scores.score.run_rms_m))
        .data("refused_runs", |row| {
            let refusals = row.scores.refusals.iter();
            refusals.map(|(run, refusal)| json!({ "run": run, "reason": refusal.to_string() })).collect()
        })
}

/// How the estimators get over what happens to the robot; `None` where nothing does.
fn disturbance_table<'a>(scenario: &Scenario, rows: &'a [EstimatorRow<'a>]) -> Option<Table<'a, EstimatorRow<'a>>> {
    let mut table = Table::of(rows).text("", "estimator", |row| row.name.to_owned());
    let (has_landings, has_bursts) =
        (scenario.kidnaps.is_some() || scenario.told.start_is_unknown, scenario.has_bursts());
    if has_landings {
        let seconds = Format::new(Unit::Named("s"), 2);
        for (name, share) in [("recovery: median", 0.5), ("90 %", 0.9), ("worst", 1.0)] {
            table = table.number("", name, seconds, move |row| row.recovery_s(share));
        }
    }
    if has_bursts {
        let three = Format::three_digits(Unit::None);
        table = table.number("", "rms/undisturbed", three, EstimatorRow::rms_per_undisturbed);
    }
    if scenario.slip_bursts.is_some() {
        let two = Format::new(Unit::None, 2);
        table = table.number("", "gated after slips/run", two, |row| Some(row.fixes_gated_after_slips()));
    }
    let is_disturbed = has_landings || has_bursts || scenario.slip_bursts.is_some();
    is_disturbed.then(|| table.count("", "resets", |row| row.scores.score.disturbances.resets as usize))
}

fn source_json(tally: &SourceTally) -> Value {
    json!({
        "name": tally.sensor.name(),
        "used": tally.used + tally.reset_to,
        "gated": tally.gated,
        "too_old": tally.too_old,
        "unused": tally.unused,
        "mean_nis_per_dof": tally.mean_nis_per_dof(),
        "consistency": tally.verdict().finding.as_text(),
    })
}

/// The runs without a result; only the first reason is named.
fn refusal_summary(row: &EstimatorRow<'_>) -> Option<String> {
    let (run, reason) = row.scores.refusals.first()?;
    let count = row.scores.refusals.len();
    Some(format!("{}: says nothing of {count} runs; of run {run}: {reason}", row.name))
}

fn names(estimators: &[Estimator]) -> Vec<String> {
    estimators.iter().map(Estimator::name).collect()
}

fn headline(scored: &ScenarioScores) -> String {
    let planned = &scored.planned;
    format!("{}: {} runs, seed {}", planned.name, planned.runs, planned.scenario.seed)
}

fn chart(scored: &[ScenarioScores], estimators: &[Estimator]) -> AccuracyChart {
    let names = names(estimators);
    let panels = scored.iter().map(|scored| AccuracyPanel {
        title: headline(scored),
        marks: names
            .iter()
            .zip(&scored.results)
            .map(|(name, EstimatorScores { score, .. })| AccuracyMark {
                name: name.clone(),
                rms_m: score.position_rms_m(),
                claimed_m: score.claimed_rms_m(),
                anees: score.anees(),
            })
            .collect(),
    });
    AccuracyChart {
        title: "Accuracy of the estimators over the Monte-Carlo scenarios".to_owned(),
        panels: panels.collect(),
    }
}

// Each job draws one drive and runs every estimator over it. Scores are added up in the order of the runs, so that the result does
// not depend on the number of cores, to the last bit.

struct PlannedScenario {
    name: String,
    scenario: Scenario,
    runs: u32,
}

struct ScenarioScores {
    planned: PlannedScenario,
    results: Vec<EstimatorScores>,
    /// Lower bound of any filter's error, where it applies.
    bound: Option<RunningMean>,
    bound_kind: BoundKind,
    bound_duration: TimeDelta,
}

#[derive(Clone, Default)]
struct EstimatorScores {
    score: FilterScore,
    /// Over the same drives without bursts of wrong fixes; empty in a scenario without them.
    undisturbed: FilterScore,
    /// The runs without a result, and why.
    refusals: Vec<(u32, OfflineError)>,
}

struct DriveScores {
    results: Vec<DriveScore>,
    undisturbed: Vec<DriveScore>,
    bound: Option<RunningMean>,
    bound_duration: TimeDelta,
}

fn score_all(
    planned: Vec<PlannedScenario>,
    estimators: &[Estimator],
    timer: &HostTimer,
) -> Result<Vec<ScenarioScores>> {
    let score = |planned: &PlannedScenario, run| score_drive(planned, run, estimators, timer);
    let by_scenario = run_cases(&planned, |planned| planned.runs, "runs", score)?;
    let scored = planned.into_iter().zip(by_scenario).map(|(planned, drives)| {
        let mut scored = ScenarioScores {
            bound_kind: BoundKind::for_scenario(&planned.scenario),
            planned,
            results: vec![EstimatorScores::default(); estimators.len()],
            bound: None,
            bound_duration: TimeDelta::ZERO,
        };
        for (run, drive) in (0..).zip(drives) {
            scored.add(run, drive.with_context(|| format!("scenario `{}`", scored.planned.name))?);
        }
        Ok(scored)
    });
    scored.collect()
}

fn score_drive(
    planned: &PlannedScenario,
    run: u32,
    estimators: &[Estimator],
    timer: &HostTimer,
) -> Result<DriveScores> {
    let scenario = &planned.scenario;
    let score_all = |drive: &Drive, known: &ReferenceDrive| -> Result<Vec<DriveScore>> {
        let config = filter_config(&drive.prior)?;
        Ok(estimators.iter().map(|estimator| estimator.score(drive, known, &config)).collect())
    };
    let drive = scenario.drive(run);
    let known = known_drive(&drive);
    let before = timer.now();
    let bound = BoundKind::for_scenario(scenario).compute(&drive, &known);
    let bound_took = timer.now() - before;
    let undisturbed = scenario.has_bursts().then(|| scenario.clone().without_bursts().drive(run));
    Ok(DriveScores {
        results: score_all(&drive, &known)?,
        undisturbed: undisturbed.map_or(Ok(Vec::new()), |drive| score_all(&drive, &known_drive(&drive)))?,
        bound,
        bound_duration: bound_took,
    })
}

impl ScenarioScores {
    fn add(&mut self, run: u32, driven: DriveScores) {
        for (sum, verdict) in self.results.iter_mut().zip(driven.results) {
            sum.score.merge(&verdict.score);
            sum.refusals.extend(verdict.refusal.map(|refusal| (run, refusal)));
        }
        for (sum, drive) in self.results.iter_mut().zip(driven.undisturbed) {
            sum.undisturbed.merge(&drive.score);
        }
        if let Some(bound) = driven.bound {
            self.bound.get_or_insert_with(RunningMean::default).merge(&bound);
        }
        self.bound_duration += driven.bound_duration;
    }

    /// Root mean square of the bound over steps and runs.
    fn bound_rms_m(&self) -> Option<f64> {
        self.bound.as_ref().and_then(RunningMean::root)
    }
}

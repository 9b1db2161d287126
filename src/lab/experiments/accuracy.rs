//! `posebridge lab accuracy`: every estimator over the Monte-Carlo scenarios, as a table and a picture.
//!
//! Scenarios and their numbers are files (`config/scenarios/accuracy/`); docs/lab-accuracy.md says what they are for.

use anyhow::Result;
use clap::Args;
use posebridge_lab::accuracy::{ScoreRow, bound_text, score_table};
use posebridge_link::HostTimer;
use posebridge_report::chart::{AccuracyChart, AccuracyMark, AccuracyPanel, render_accuracy_chart};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_sim::montecarlo::SCENARIOS;
use posebridge_telemetry::TimeDelta;

use super::Estimator;
use super::accuracy_json as json;
use super::accuracy_runs::{EstimatorScores, PlannedScenario, ScenarioScores, score_all};
use crate::console::{print_line, progress_bar};
use crate::exit::{ExitStage, Failure};
use crate::lab::drives::load_scenario;
use crate::tools::experiment_output::{ExperimentOutcome, OutputArgs};

/// Flags of `lab accuracy`.
#[derive(Args, Clone, Debug)]
pub struct LabAccuracyArgs {
    /// A bundled scenario's name or a TOML file; may be repeated. Without it all bundled ones.
    #[arg(long = "scenario", value_name = "NAME|FILE.toml")]
    pub scenarios: Vec<String>,
    /// An estimator's name; may be repeated. Without it all that estimate a pose.
    #[arg(long = "estimator", value_name = "NAME")]
    pub estimators: Vec<String>,
    /// Runs of each scenario, instead of what its file says (mostly 40).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(posebridge_sim::montecarlo::MAX_RUNS)))]
    pub runs: Option<u32>,
    /// Base seed, instead of each scenario's.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// What `lab accuracy` can run, from the tables.
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

/// Runs the experiment.
///
/// # Errors
/// A scenario or an estimator does not exist or makes no sense, or an output cannot be written.
pub fn execute(args: &LabAccuracyArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let started = timer.now();
    let estimators = estimators(args).before_start()?;
    let planned = plan_scenarios(args).before_start()?;
    let folder = args.output.folder()?;
    let runs: u64 = planned.iter().map(|planned| u64::from(planned.runs)).sum();
    let bar = progress_bar(runs, "runs").before_start()?;
    let scored = score_all(planned, &estimators, &timer, || bar.inc(1));
    bar.finish_and_clear();
    let text = tables(&scored, &estimators);
    let outcome = ExperimentOutcome {
        name: "lab-accuracy",
        page: page(&text, &chart(&scored, &estimators)),
        json: json::object(&scored, &estimators).while_running()?,
        text,
    };
    args.output.write_outcome(&folder, &outcome)?;
    print_line(&format!(
        "{runs} runs with {} estimators in {:.1} s, bounds: {:.1} s of one core",
        estimators.len(),
        (timer.now() - started).as_secs_f64(),
        bounds_duration(&scored).as_secs_f64()
    ));
    Ok(())
}

fn bounds_duration(scored: &[ScenarioScores]) -> TimeDelta {
    scored.iter().fold(TimeDelta::ZERO, |sum, scored| sum + scored.bound_duration)
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
    let planned = names.into_iter().map(|asked| {
        let (name, mut scenario) = load_scenario(&asked)?;
        if let Some(seed) = args.seed {
            scenario = scenario.with_seed(seed);
        }
        Ok(PlannedScenario { name, runs: args.runs.unwrap_or(scenario.runs), scenario })
    });
    planned.collect()
}

fn tables(scored: &[ScenarioScores], estimators: &[Estimator]) -> String {
    let names = names(estimators);
    let tables: Vec<String> = scored.iter().map(|scored| table(scored, &names)).collect();
    tables.join("\n")
}

fn page(tables: &str, chart: &AccuracyChart) -> ReportPage {
    ReportPage {
        title: chart.title.clone(),
        blocks: vec![
            ReportBlock::Text(
                "Every estimator gets the same drives. rms is the error of its position, claimed what it says about itself; an ANEES of 1 is \
                 an honest claim."
                    .to_owned(),
            ),
            ReportBlock::PreformattedText(tables.to_owned()),
            ReportBlock::Figure {
                svg: render_accuracy_chart(chart),
                caption: "Errors (discs) and claims of the estimators, per scenario".to_owned(),
            },
        ],
    }
}

fn table(scored: &ScenarioScores, names: &[String]) -> String {
    let bound_m = scored.bound_rms_m();
    let rows: Vec<ScoreRow<'_>> = names
        .iter()
        .zip(&scored.results)
        .map(|(name, EstimatorScores { score, .. })| ScoreRow { name, score, bound_m })
        .collect();
    let refusals = names.iter().zip(&scored.results);
    let refusals: Vec<String> = refusals.filter_map(|(name, scores)| refusal_summary(name, scores)).collect();
    format!(
        "{}\n{}{}{}",
        headline(scored),
        score_table(&rows),
        bound_text(bound_m, scored.bound_kind.note().as_deref()),
        refusals.concat()
    )
}

/// The runs for which an estimator gives no result; the first reason stands for all.
fn refusal_summary(name: &str, scores: &EstimatorScores) -> Option<String> {
    let (run, reason) = scores.refusals.first()?;
    let count = scores.refusals.len();
    Some(format!("{name}: says nothing of {count} runs; of run {run}: {reason}\n"))
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

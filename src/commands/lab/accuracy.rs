//! `posebridge lab accuracy`: every estimator over the Monte-Carlo scenarios, as a table and a picture.
//!
//! Scenarios and their numbers are files (`config/scenarios/accuracy/`); docs/lab-accuracy.md says what they are for.

use anyhow::Result;
use posebridge_analysis::figures::{AccuracyChart, AccuracyMark, AccuracyPanel, accuracy_chart};
use posebridge_analysis::report::page::{Page, Part};
use posebridge_analysis::report::{ScoreRow, bound_line, score_table};
use posebridge_link::HostTimer;
use posebridge_sim::montecarlo::SCENARIOS;
use posebridge_telemetry::Span;

use super::Estimator;
use super::accuracy_json as json;
use super::accuracy_runs::{Planned, Scored, Scores, score_all};
use super::outcome::Outcome;
use crate::cli::LabAccuracyArgs;
use crate::commands::{Failure, Stage};
use crate::drawn::scenario;
use crate::progress;
use crate::stderr::say;

/// Runs the experiment.
///
/// # Errors
/// A scenario or an estimator does not exist or makes no sense, or an output cannot be written.
pub fn execute(args: &LabAccuracyArgs) -> Result<(), Failure> {
    let timer = HostTimer::start();
    let started = timer.now();
    let estimators = estimators(args).at_start()?;
    let planned = planned(args).at_start()?;
    let folder = args.output.folder()?;
    let runs: u64 = planned.iter().map(|planned| u64::from(planned.runs)).sum();
    let bar = progress::bar(runs, "runs").at_start()?;
    let scored = score_all(planned, &estimators, &timer, || bar.inc(1));
    bar.finish_and_clear();
    let text = tables(&scored, &estimators);
    let outcome = Outcome {
        name: "lab-accuracy",
        page: page(&text, &chart(&scored, &estimators)),
        json: json::object(&scored, &estimators).while_running()?,
        text,
    };
    args.output.deliver(&folder, &outcome)?;
    say(&format!(
        "{runs} runs with {} estimators in {:.1} s, bounds: {:.1} s of one core",
        estimators.len(),
        (timer.now() - started).as_secs_f64(),
        bounds_took(&scored).as_secs_f64()
    ));
    Ok(())
}

fn bounds_took(scored: &[Scored]) -> Span {
    scored.iter().fold(Span::ZERO, |sum, scored| sum + scored.bound_took)
}

fn estimators(args: &LabAccuracyArgs) -> Result<Vec<Estimator>> {
    if args.estimators.is_empty() {
        return Ok(Estimator::all());
    }
    let named = args.estimators.iter().map(|name| Estimator::named(name));
    Ok(named.collect::<Result<_, _>>()?)
}

fn planned(args: &LabAccuracyArgs) -> Result<Vec<Planned>> {
    let names: Vec<String> = if args.scenarios.is_empty() {
        SCENARIOS.iter().map(|(name, _)| (*name).to_owned()).collect()
    } else {
        args.scenarios.clone()
    };
    let planned = names.into_iter().map(|asked| {
        let (name, mut scenario) = scenario(&asked)?;
        if let Some(seed) = args.seed {
            scenario = scenario.with_seed(seed);
        }
        Ok(Planned { name, runs: args.runs.unwrap_or(scenario.runs), scenario })
    });
    planned.collect()
}

fn tables(scored: &[Scored], estimators: &[Estimator]) -> String {
    let names = names(estimators);
    let tables: Vec<String> = scored.iter().map(|scored| table(scored, &names)).collect();
    tables.join("\n")
}

fn page(tables: &str, chart: &AccuracyChart) -> Page {
    Page {
        title: chart.title.clone(),
        parts: vec![
            Part::Text(
                "Every estimator gets the same drives. rms is the error of its position, claimed what it says about itself; an ANEES of 1 is \
                 an honest claim."
                    .to_owned(),
            ),
            Part::Lines(tables.to_owned()),
            Part::Figure {
                svg: accuracy_chart(chart),
                caption: "Errors (discs) and claims of the estimators, per scenario".to_owned(),
            },
        ],
    }
}

fn table(scored: &Scored, names: &[String]) -> String {
    let bound_m = scored.bound_rms_m();
    let rows: Vec<ScoreRow<'_>> = names
        .iter()
        .zip(&scored.results)
        .map(|(name, Scores { score, .. })| ScoreRow { name, score, bound_m })
        .collect();
    let refusals = names.iter().zip(&scored.results);
    let refusals: Vec<String> = refusals.filter_map(refusals_of).collect();
    format!(
        "{}\n{}{}{}",
        headline(scored),
        score_table(&rows),
        bound_line(bound_m, scored.bounded.note().as_deref()),
        refusals.concat()
    )
}

/// Of which runs an estimator says nothing; the first reason stands for all.
fn refusals_of((name, scores): (&String, &Scores)) -> Option<String> {
    let (run, reason) = scores.refusals.first()?;
    let count = scores.refusals.len();
    Some(format!("{name}: says nothing of {count} runs; of run {run}: {reason}\n"))
}

fn names(estimators: &[Estimator]) -> Vec<String> {
    estimators.iter().map(Estimator::name).collect()
}

fn headline(scored: &Scored) -> String {
    let planned = &scored.planned;
    format!("{}: {} runs, seed {}", planned.name, planned.runs, planned.scenario.seed)
}

fn chart(scored: &[Scored], estimators: &[Estimator]) -> AccuracyChart {
    let names = names(estimators);
    let panels = scored.iter().map(|scored| AccuracyPanel {
        title: headline(scored),
        marks: names
            .iter()
            .zip(&scored.results)
            .map(|(name, Scores { score, .. })| AccuracyMark {
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

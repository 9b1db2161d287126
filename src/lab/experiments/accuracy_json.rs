//! `lab accuracy --json`: one object, documented in docs/lab-accuracy.md. The same seeds give the same text.

use anyhow::Result;
use posebridge_report::{ConsistencyBand, SourceTally};
use serde::Serialize;
use serde_json::Value;

use super::Estimator;
use super::accuracy_runs::{EstimatorScores, ScenarioScores};

#[derive(Serialize)]
struct Report<'a> {
    scenarios: Vec<ScenarioRow<'a>>,
}

#[derive(Serialize)]
struct ScenarioRow<'a> {
    name: &'a str,
    seed: u64,
    runs: u32,
    bound_rms_m: Option<f64>,
    bound_note: Option<String>,
    estimators: Vec<EstimatorRow<'a>>,
}

#[derive(Serialize)]
struct EstimatorRow<'a> {
    name: String,
    position_rms_m: Option<f64>,
    position_mean_m: Option<f64>,
    position_max_m: Option<f64>,
    heading_rms_rad: Option<f64>,
    claimed_rms_m: Option<f64>,
    anees: Option<f64>,
    anees_band: Option<[f64; 2]>,
    consistency: &'static str,
    steps: u64,
    steps_without_estimate: u64,
    steps_not_finite: u64,
    refused_covariances: u64,
    run_rms_m: &'a [f64],
    refused_runs: Vec<RefusedRun>,
    sources: Vec<SourceRow>,
}

#[derive(Serialize)]
struct RefusedRun {
    run: u32,
    reason: String,
}

#[derive(Serialize)]
struct SourceRow {
    name: &'static str,
    used: u64,
    gated: u64,
    too_old: u64,
    unused: u64,
    mean_nis_per_dof: Option<f64>,
    consistency: &'static str,
}

/// The object.
///
/// # Errors
/// Never for finite figures; a figure that cannot be had is null.
pub(super) fn object(scored: &[ScenarioScores], estimators: &[Estimator]) -> Result<Value> {
    let scenarios = scored.iter().map(|scored| ScenarioRow {
        name: &scored.planned.name,
        seed: scored.planned.scenario.seed,
        runs: scored.planned.runs,
        bound_rms_m: scored.bound_rms_m(),
        bound_note: scored.bound_kind.note(),
        estimators: estimators
            .iter()
            .zip(&scored.results)
            .map(|(estimator, scores)| estimator_row(estimator, scores))
            .collect(),
    });
    let report = Report { scenarios: scenarios.collect() };
    Ok(serde_json::to_value(&report)?)
}

fn estimator_row<'a>(estimator: &Estimator, scores: &'a EstimatorScores) -> EstimatorRow<'a> {
    let score = &scores.score;
    let refused = scores.refusals.iter().map(|(run, refusal)| RefusedRun { run: *run, reason: refusal.to_string() });
    EstimatorRow {
        name: estimator.name(),
        position_rms_m: score.position_rms_m(),
        position_mean_m: score.position_mean_m(),
        position_max_m: score.position_max_m(),
        heading_rms_rad: score.heading_rms_rad(),
        claimed_rms_m: score.claimed_rms_m(),
        anees: score.anees(),
        anees_band: score.band().map(|ConsistencyBand { low, high }| [low, high]),
        consistency: score.consistency().as_text(),
        steps: score.steps(),
        steps_without_estimate: score.steps_without_estimate(),
        steps_not_finite: score.steps_not_finite(),
        refused_covariances: score.refused_covariances(),
        run_rms_m: score.run_rms_m(),
        refused_runs: refused.collect(),
        sources: score.sources().iter().map(source_row).collect(),
    }
}

fn source_row(tally: &SourceTally) -> SourceRow {
    SourceRow {
        name: tally.sensor.name(),
        used: tally.used + tally.reset_to,
        gated: tally.gated,
        too_old: tally.too_old,
        unused: tally.unused,
        mean_nis_per_dof: tally.mean_nis_per_dof(),
        consistency: tally.consistency().as_text(),
    }
}

//! `replay --json`: one object, documented in docs/replay-json.md and stable.

use anyhow::Result;
use posebridge_analysis::SourceTally;
use posebridge_telemetry::Span;
use serde::Serialize;

use crate::commands::replay::{Outcome, Replayed};

#[derive(Serialize)]
struct Report<'a> {
    recording: &'a str,
    observations: u64,
    wall_seconds: f64,
    cpu_seconds: f64,
    estimators: Vec<Estimator<'a>>,
    runs: &'a [String],
    bad_rows: u64,
}

#[derive(Serialize)]
struct Estimator<'a> {
    name: &'a str,
    position_rms_m: Option<f64>,
    position_max_m: Option<f64>,
    position_end_m: Option<f64>,
    heading_rms_rad: Option<f64>,
    anees: Option<f64>,
    sources: Vec<Source>,
}

#[derive(Serialize)]
struct Source {
    name: &'static str,
    used: u64,
    gated: u64,
    too_old: u64,
    mean_nis_per_dof: Option<f64>,
}

/// The object as one line of text.
///
/// # Errors
/// Never for finite figures; a figure that cannot be had is null.
pub fn text(replayed: &Replayed, wall: Span, cpu: Span) -> Result<String> {
    let report = Report {
        recording: &replayed.recording,
        observations: replayed.observations,
        wall_seconds: wall.as_secs_f64(),
        cpu_seconds: cpu.as_secs_f64(),
        estimators: replayed.outcomes.iter().map(estimator).collect(),
        runs: &replayed.runs,
        bad_rows: replayed.bad_rows,
    };
    Ok(serde_json::to_string(&report)?)
}

fn estimator(outcome: &Outcome) -> Estimator<'_> {
    let errors = &outcome.errors;
    Estimator {
        name: &outcome.name,
        position_rms_m: errors.position_rms_m,
        position_max_m: errors.position_max_m,
        position_end_m: errors.position_end_m,
        heading_rms_rad: errors.heading_rms_rad,
        anees: errors.anees,
        sources: outcome.sources.iter().map(source).collect(),
    }
}

fn source(tally: &SourceTally) -> Source {
    Source {
        name: tally.sensor.name(),
        used: tally.used + tally.reset_to,
        gated: tally.gated,
        too_old: tally.too_old,
        mean_nis_per_dof: tally.mean_nis_per_dof(),
    }
}

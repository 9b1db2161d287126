//! `report --json`: one object, documented in docs/reports.md.

use std::collections::BTreeMap;

use posebridge_report::report::Report;
use posebridge_telemetry::{TimeDelta, UncertainValue};
use serde_json::{Map, Value, json};

use super::summary::{LINK_COUNTERS, RunSummary, ScoreReference, SessionSummary, SourceSummary};
use crate::config::CALIBRATION_KEYS;

/// Adds what programs get.
pub fn add(report: &mut Report, session: &SessionSummary) {
    let facts: BTreeMap<&str, &str> =
        session.facts.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    report.data("recording", json!(session.recording));
    report.data("facts", json!(facts));
    report.data("filter", json!(session.filter));
    report.data("changed", json!(session.changed));
    report.data("notes", json!(session.notes));
    report.data("runs", session.runs.iter().map(run).collect());
}

fn run(run: &RunSummary) -> Value {
    let errors = &run.errors;
    let history = &run.history;
    let reference = match run.reference {
        ScoreReference::Truth => Some("truth"),
        ScoreReference::WithheldFixes => Some("withheld"),
        ScoreReference::None => None,
    };
    let entries = history.timeline.entries.iter();
    json!({
        "name": run.name,
        "length_s": history.length().as_secs_f64(),
        "observations": history.collector.observations,
        "verdict": run.verdict().2,
        "yardstick": reference,
        "position_rms_m": errors.position_rms_m,
        "position_max_m": errors.position_max_m,
        "position_end_m": errors.position_end_m,
        "heading_rms_rad": errors.heading_rms_rad,
        "anees": errors.anees,
        "sources": run.source_summaries().iter().map(source).collect::<Vec<_>>(),
        "calibration": calibration(run),
        "links": links(run),
        "happenings": entries.map(|one| json!({ "t_s": one.t_s, "what": one.text })).collect::<Vec<_>>(),
        "further_happenings": history.timeline.omitted,
    })
}

fn source(verdict: &SourceSummary) -> Value {
    let (tally, judgement) = (&verdict.tally, &verdict.assessment);
    json!({
        "name": verdict.sensor.name(),
        "used": tally.used + tally.reset_to,
        "gated": tally.gated,
        "too_old": tally.too_old,
        "mean_nis_per_dof": tally.mean_nis_per_dof(),
        "degrees_of_freedom": tally.degrees_of_freedom(),
        "finding": judgement.finding.as_text(),
        "due": judgement.band.map(|band| [band.low, band.high]),
        "correlation": judgement.correlation,
        "correlation_bound": judgement.correlation_bound,
        "gated_share": judgement.gated_share,
        "verdict": judgement.to_string(),
    })
}

fn calibration(run: &RunSummary) -> Option<Value> {
    let learned = run.learned.as_ref()?;
    let entries = CALIBRATION_KEYS.iter().map(|entry| {
        let UncertainValue { value, sigma } = (entry.read)(&learned.calibration);
        (entry.key.to_owned(), json!({ "value": value, "sigma": sigma }))
    });
    Some(Value::Object(entries.collect::<Map<String, Value>>()))
}

fn links(run: &RunSummary) -> Value {
    let links = run.history.collector.links.iter().map(|(id, report)| {
        let health = &report.health;
        let mut fields = json!({ "link": id.0, "round_trip_s": health.round_trip.map(TimeDelta::as_secs_f64) });
        for counter in LINK_COUNTERS {
            fields[counter.key] = json!((counter.read)(health));
        }
        fields
    });
    Value::Array(links.collect())
}

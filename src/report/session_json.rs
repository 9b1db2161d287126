//! `report --json`: one object, documented in docs/report.md.

use std::collections::BTreeMap;

use posebridge_telemetry::{Known, Span};
use serde_json::{Map, Value, json};

use super::story::{RunStory, SourceVerdict, Story, Yardstick};
use crate::config::CALIBRATION_KEYS;

/// The object.
#[must_use]
pub fn object(story: &Story) -> Value {
    let facts: BTreeMap<&str, &str> = story.facts.iter().map(|(name, value)| (name.as_str(), value.as_str())).collect();
    json!({
        "recording": story.recording,
        "facts": facts,
        "filter": story.filter,
        "changed": story.changed,
        "notes": story.notes,
        "runs": story.runs.iter().map(run).collect::<Vec<_>>(),
    })
}

fn run(run: &RunStory) -> Value {
    let errors = &run.errors;
    let chronicle = &run.chronicle;
    let yardstick = match run.yardstick {
        Yardstick::Truth => Some("truth"),
        Yardstick::WithheldFixes => Some("withheld"),
        Yardstick::None => None,
    };
    let happenings = chronicle.happenings.all.iter();
    json!({
        "name": run.name,
        "length_s": chronicle.length().as_secs_f64(),
        "observations": chronicle.collector.observations,
        "verdict": run.verdict().2,
        "yardstick": yardstick,
        "position_rms_m": errors.position_rms_m,
        "position_max_m": errors.position_max_m,
        "position_end_m": errors.position_end_m,
        "heading_rms_rad": errors.heading_rms_rad,
        "anees": errors.anees,
        "sources": run.verdicts().iter().map(source).collect::<Vec<_>>(),
        "calibration": calibration(run),
        "links": links(run),
        "happenings": happenings.map(|one| json!({ "t_s": one.t_s, "what": one.what })).collect::<Vec<_>>(),
        "further_happenings": chronicle.happenings.more,
    })
}

fn source(verdict: &SourceVerdict) -> Value {
    let (tally, judgement) = (&verdict.tally, &verdict.judgement);
    json!({
        "name": verdict.sensor.name(),
        "used": tally.used + tally.reset_to,
        "gated": tally.gated,
        "too_old": tally.too_old,
        "mean_nis_per_dof": tally.mean_nis_per_dof(),
        "degrees_of_freedom": tally.degrees_of_freedom(),
        "finding": judgement.finding.in_words(),
        "due": judgement.band.map(|band| [band.low, band.high]),
        "correlation": judgement.correlation,
        "correlation_bound": judgement.correlation_bound,
        "gated_share": judgement.gated_share,
        "verdict": judgement.to_string(),
    })
}

fn calibration(run: &RunStory) -> Option<Value> {
    let learned = run.learned.as_ref()?;
    let entries = CALIBRATION_KEYS.iter().map(|entry| {
        let Known { value, sigma } = (entry.read)(&learned.calibration);
        (entry.key.to_owned(), json!({ "value": value, "sigma": sigma }))
    });
    Some(Value::Object(entries.collect::<Map<String, Value>>()))
}

fn links(run: &RunStory) -> Value {
    let links = run.chronicle.collector.links.iter().map(|(id, report)| {
        let health = &report.health;
        json!({
            "link": id.0,
            "frames_in": health.frames_in,
            "frames_out": health.frames_out,
            "frames_lost": health.frames_lost,
            "checksum_errors": health.checksum_errors,
            "garbage_bytes": health.garbage_bytes,
            "stalls": health.stalls,
            "drops_out": health.drops_out + health.port.drops_out,
            "reconnects": health.reconnects,
            "round_trip_s": health.round_trip.map(Span::as_secs_f64),
        })
    });
    Value::Array(links.collect())
}

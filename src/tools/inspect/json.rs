//! What `inspect --json` prints. Keys are described in docs/recordings.md.

use posebridge_protocol::dialect::message_name;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::statistics::{MessageStatistics, SenderStatistics, TrafficGap, TrafficStatistics};
use posebridge_recording::tlog::ByteOrder;
use posebridge_telemetry::{HostClock, Timestamp};
use serde_json::{Map, Value, json};

use super::descriptor::RunFacts;
use super::facts::{FramedFacts, InspectResult, RecordingFacts, TlogFacts};
use crate::station::input_file::InputKind;

/// The object as text, with a line feed.
pub(super) fn text(file: &str, kind: InputKind, size: u64, found: &InspectResult) -> String {
    let mut object = Map::new();
    object.insert("file".to_owned(), json!(file));
    object.insert("kind".to_owned(), json!(kind_name(kind)));
    object.insert("file_bytes".to_owned(), json!(size));
    match found {
        InspectResult::Framed(framed) => add_framed(&mut object, framed),
        InspectResult::Runs(runs) => {
            let runs: Vec<Value> = runs.iter().map(run_of).collect();
            object.insert("runs".to_owned(), json!(runs));
        }
    }
    format!("{:#}\n", Value::Object(object))
}

/// The name of a kind of file.
pub(super) const fn kind_name(kind: InputKind) -> &'static str {
    match kind {
        InputKind::Own => "posebridge",
        InputKind::Tlog => "tlog",
        InputKind::Bytes => "bytes",
        InputKind::Descriptor => "descriptor",
    }
}

fn add_framed(object: &mut Map<String, Value>, framed: &FramedFacts) {
    let census = &framed.census;
    let all = census.all();
    let mut add = |key: &str, value: Value| object.insert(key.to_owned(), value);
    add("bytes", json!(framed.bytes));
    add("frames", json!(all.frames));
    add("bytes_outside", json!(framed.bytes_outside));
    add("unknown_frames", json!(framed.unknown_frames));
    add("unknown_bytes", json!(framed.unknown_bytes));
    add("versions", versions_of(census));
    add("signed_frames", json!(census.signed()));
    add("first_utc_micros", utc_micros(framed, all.first));
    add("last_utc_micros", utc_micros(framed, all.last));
    add("duration_s", json!(duration_s(all)));
    add("times_backwards", json!(census.time_reversals()));
    let (gaps, count) = census.gaps();
    let gaps: Vec<Value> = gaps.iter().map(|gap| gap_of(gap, all)).collect();
    add("gap_count", json!(count));
    add("gaps", json!(gaps));
    let sources: Vec<Value> = census.sources().iter().map(source_of).collect();
    add("sources", json!(sources));
    let mut messages: Vec<(u32, MessageStatistics)> = census.messages().into_iter().collect();
    messages.sort_by_key(|(id, tally)| (std::cmp::Reverse(tally.frames), *id));
    let messages: Vec<Value> = messages.iter().map(|(id, tally)| message_of(*id, tally)).collect();
    add("messages", json!(messages));
    add("frames_of_further_sources", json!(census.untracked_frames()));
    if let Some(facts) = &framed.tlog {
        add("tlog", tlog_of(facts));
    }
    if let Some(facts) = &framed.own {
        add("recording", own_of(facts));
    }
}

/// Only the layouts that occur.
fn versions_of(census: &TrafficStatistics) -> Value {
    let versions = [("1", WireVersion::V1), ("2", WireVersion::V2)];
    let counts = versions.map(|(name, version)| (name.to_owned(), census.frames_of_version(version)));
    let occurring = counts.into_iter().filter(|(_, count)| *count > 0);
    Value::Object(occurring.map(|(name, count)| (name, json!(count))).collect())
}

fn utc_micros(framed: &FramedFacts, at: Option<Timestamp<HostClock>>) -> Value {
    let utc = framed.epoch_micros.zip(at).map(|(epoch, at)| i128::from(epoch) + i128::from(at.as_micros()));
    json!(utc.and_then(|utc| u64::try_from(utc).ok()))
}

/// From the first to the last, s; nothing without times, or where the last lies before the first: such times give no duration.
pub(super) fn duration_s(all: &MessageStatistics) -> Option<f64> {
    let duration_s = (all.last? - all.first?).as_secs_f64();
    (duration_s >= 0.0).then_some(duration_s)
}

fn gap_of(gap: &TrafficGap, all: &MessageStatistics) -> Value {
    let from = all.first.map(|first| (gap.from - first).as_secs_f64());
    json!({ "from_s": from, "length_s": gap.length.as_secs_f64() })
}

fn source_of(source: &SenderStatistics) -> Value {
    let messages = source.messages.iter();
    let messages: Vec<Value> = messages.map(|(id, tally)| message_of(*id, tally)).collect();
    let clock = source.clock.map(|clock| {
        json!({
            "message": message_name(clock.message_id),
            "drift_ppm": clock.drift_ppm(),
            "offset_s": clock.offset_s(),
            "restarts": clock.restarts,
        })
    });
    json!({
        "link": source.link.0,
        "system": source.address.system.0,
        "component": source.address.component.0,
        "frames": source.total.frames,
        "bytes": source.total.bytes,
        "rate_hz": source.total.rate_hz(),
        "lost": source.lost(),
        "sequence_steps": source.sequence_steps,
        "longest_silence_s": silence_s(&source.total),
        "clock": clock,
        "messages": messages,
    })
}

fn message_of(id: u32, tally: &MessageStatistics) -> Value {
    json!({
        "id": id,
        "name": message_name(id),
        "frames": tally.frames,
        "bytes": tally.bytes,
        "rate_hz": tally.rate_hz(),
        "longest_silence_s": silence_s(tally),
    })
}

/// Nothing without times.
fn silence_s(tally: &MessageStatistics) -> Option<f64> {
    tally.first.map(|_| tally.longest_silence.as_secs_f64())
}

fn tlog_of(facts: &TlogFacts) -> Value {
    let order = match facts.order {
        ByteOrder::Big => "big",
        ByteOrder::Little => "little",
    };
    json!({ "byte_order": order, "link_bits": facts.link_bits, "links": facts.links() })
}

fn own_of(facts: &RecordingFacts) -> Value {
    let links: Vec<Value> = facts
        .links
        .iter()
        .map(|(id, link)| {
            json!({
                "link": id.0,
                "url": link.url,
                "brick": link.brick,
                "chunks": link.chunks,
                "bytes": link.bytes,
                "ups": link.ups,
                "downs": link.downs,
            })
        })
        .collect();
    json!({
        "format": facts.header.format,
        "program_version": facts.header.program_version,
        "utc_start_micros": facts.header.utc_start_micros,
        "duration_s": facts.duration_s(),
        "part": facts.part,
        "continued_by": facts.continued_by,
        "lack": facts.missing_start,
        "inputs": facts.inputs,
        "observations": facts.observations,
        "commands": facts.commands,
        "torn": facts.truncation,
        "damages": facts.damages,
        "links": links,
    })
}

fn run_of(run: &RunFacts) -> Value {
    let observations: Vec<Value> = run
        .observations
        .iter()
        .map(|(name, series)| {
            json!({
                "kind": name,
                "count": series.count,
                "rate_hz": series.rate_hz(),
                "first_s": series.first.as_secs_f64(),
                "last_s": series.last.as_secs_f64(),
                "longest_gap_s": series.longest_gap.as_secs_f64(),
            })
        })
        .collect();
    let bad_rows: Map<String, Value> =
        run.bad_rows.iter().map(|(reason, count)| ((*reason).to_owned(), json!(count))).collect();
    json!({
        "name": run.name,
        "observations": observations,
        "truth": run.truth,
        "withheld": run.withheld,
        "bad_rows": bad_rows,
    })
}

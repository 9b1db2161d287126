//! Output of `inspect`: text tables, or one JSON object, whose keys are described in docs/recordings.md.

use std::fmt::Write as _;

use posebridge_protocol::dialect::message_name;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::statistics::{MessageStatistics, SenderStatistics, TrafficStatistics};
use posebridge_recording::tlog::ByteOrder;
use posebridge_report::tables::{NO_VALUE, TextTable, wrapped};
use posebridge_telemetry::{HostClock, Timestamp};
use serde_json::{Map, Value, json};

use super::facts::{FramedFacts, InspectResult, RecordingFacts, RunFacts, TlogFacts};
use crate::station::input_file::InputKind;

/// With a line feed.
pub(super) fn json_text(file: &str, kind: InputKind, size: u64, found: &InspectResult) -> String {
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

pub(super) const fn kind_name(kind: InputKind) -> &'static str {
    match kind {
        InputKind::Own => "posebridge",
        InputKind::Tlog => "tlog",
        InputKind::Messages => "messages",
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
    let gaps = gaps.iter().map(|gap| {
        let from = all.first.map(|first| (gap.from - first).as_secs_f64());
        json!({ "from_s": from, "length_s": gap.length.as_secs_f64() })
    });
    let gaps: Vec<Value> = gaps.collect();
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

/// From the first to the last; `None` without times, or if the last is earlier than the first, because such times give no duration.
pub(super) fn duration_s(all: &MessageStatistics) -> Option<f64> {
    let duration_s = (all.last? - all.first?).as_secs_f64();
    (duration_s >= 0.0).then_some(duration_s)
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

/// `None` without times.
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
    let links = facts.links.iter().map(|(id, link)| {
        let mut fields = json!(link);
        fields["link"] = json!(id.0);
        fields
    });
    let links: Vec<Value> = links.collect();
    let header = &facts.header;
    let mut fields = json!(facts);
    for (key, value) in [
        ("format", json!(header.format)),
        ("program_version", json!(header.program_version)),
        ("utc_start_micros", json!(header.utc_start_micros)),
        ("duration_s", json!(facts.duration_s())),
        ("links", json!(links)),
    ] {
        fields[key] = value;
    }
    fields
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

const MAX_GAPS: usize = 5;

pub(super) fn table_text(file: &str, kind: InputKind, found: &InspectResult) -> String {
    let mut text = format!("{file}: {}\n", kind_in_words(kind));
    match found {
        InspectResult::Framed(framed) => text += &framed_text(framed),
        InspectResult::Runs(runs) => text.extend(runs.iter().map(run_text)),
    }
    text
}

fn kind_in_words(kind: InputKind) -> String {
    match kind {
        InputKind::Own => "recording of posebridge".to_owned(),
        InputKind::Tlog => "telemetry log".to_owned(),
        InputKind::Messages => "messages of `posebridge export --messages`".to_owned(),
        InputKind::Bytes => "bytes of a link, without times".to_owned(),
        InputKind::Descriptor => kind_name(kind).to_owned(),
    }
}

fn framed_text(framed: &FramedFacts) -> String {
    let census = &framed.census;
    let mut text = summary(framed);
    if let Some(facts) = &framed.own {
        text += &own_text(facts);
    }
    if let Some(facts) = &framed.tlog {
        text += &tlog_text(facts);
    }
    text += &gaps_text(census);
    if census.all().frames > 0 {
        text = text + "\n" + &sources(census) + "\n" + &messages(census);
    }
    text
}

fn summary(framed: &FramedFacts) -> String {
    let (census, bytes) = (&framed.census, framed.bytes);
    let all = census.all();
    if framed.own.is_some() && framed.bytes == 0 {
        return "no MAVLink frames\n".to_owned();
    }
    let mut text = format!("{} frames in {bytes} bytes", all.frames);
    if let Some(duration_s) = duration_s(all) {
        // Writing to a String cannot fail.
        let _ = write!(text, ", {duration_s:.3} s");
    }
    for (name, version) in [("MAVLink 1", WireVersion::V1), ("MAVLink 2", WireVersion::V2)] {
        let count = census.frames_of_version(version);
        if count > 0 && count < all.frames {
            let _ = write!(text, ", {count} of {name}");
        } else if count > 0 {
            let _ = write!(text, ", {name}");
        }
    }
    let _ = write!(text, "\n{} bytes outside frames", framed.bytes_outside);
    let counts = [
        (framed.unknown_frames, "perhaps frames of unknown messages"),
        (census.signed(), "signed"),
        (census.time_reversals(), "times go back"),
        (census.untracked_frames(), "frames of further senders"),
    ];
    for (count, name) in counts {
        if count > 0 {
            let _ = write!(text, ", {count} {name}");
        }
    }
    text + "\n"
}

fn own_text(facts: &RecordingFacts) -> String {
    let mut text = format!("written by posebridge {}, {} inputs\n", facts.header.program_version, facts.inputs);
    if let Some(lack) = &facts.missing_start {
        let _ = writeln!(text, "{lack}");
    }
    if let Some(next) = facts.continued_by.first() {
        let count = facts.continued_by.len();
        let _ = writeln!(
            text,
            "this is part {}; {count} more continue it, from `{next}` on, and are not counted here: replay, report and export join them",
            facts.part
        );
    }
    for (id, link) in &facts.links {
        let brick = link.brick.as_deref().unwrap_or("mavlink");
        let facts = format!(
            "{}  {brick}  {} bytes in {} chunks, up {} times, down {} times",
            link.url, link.bytes, link.chunks, link.ups, link.downs
        );
        text += &wrapped(&format!("link {id}     "), &facts);
    }
    for damage in &facts.damages {
        let _ = writeln!(text, "damaged: {damage}");
    }
    if let Some(truncation) = &facts.truncation {
        let _ = writeln!(text, "cut off at {truncation}");
    }
    text
}

fn tlog_text(facts: &TlogFacts) -> String {
    let mut text = String::new();
    if facts.order == ByteOrder::Little {
        text += "the times are little-endian, against the format: other programs may refuse the file; `posebridge export --format tlog` writes it anew\n";
    }
    let links = facts.links();
    if links.len() > 1 {
        let names: Vec<String> = links.iter().map(ToString::to_string).collect();
        let _ = writeln!(text, "the times hold links {}", names.join(", "));
    }
    text
}

fn gaps_text(census: &TrafficStatistics) -> String {
    let (gaps, count) = census.gaps();
    let mut text = String::new();
    if let Some(first) = census.all().first {
        for gap in gaps.iter().take(MAX_GAPS) {
            let (from_s, length_s) = ((gap.from - first).as_secs_f64(), gap.length.as_secs_f64());
            let _ = writeln!(text, "silent for {length_s:.1} s from {from_s:.1} s on");
        }
    }
    let unnamed = count.saturating_sub(MAX_GAPS as u64);
    if unnamed > 0 {
        let _ = writeln!(text, "{unnamed} more silences of a second or longer");
    }
    text
}

fn sources(census: &TrafficStatistics) -> String {
    let header = ["sender", "frames", "lost", "per second", "longest silence", "clock"];
    let mut table = TextTable::new(header);
    for source in census.sources() {
        table.push([
            format!("link {} {}", source.link, source.address),
            source.total.frames.to_string(),
            source.lost().to_string(),
            or_none(source.total.rate_hz(), "", 1),
            or_none(silence_s(&source.total), " s", 2),
            clock(source),
        ]);
    }
    table.render()
}

fn clock(source: &SenderStatistics) -> String {
    let Some(clock) = source.clock else {
        return NO_VALUE.to_owned();
    };
    let mut text = or_none(clock.drift_ppm(), " ppm", 0);
    if clock.restarts > 0 {
        let _ = write!(text, ", began anew {} times", clock.restarts);
    }
    text
}

fn messages(census: &TrafficStatistics) -> String {
    let mut rows: Vec<_> = census.messages().into_iter().collect();
    rows.sort_by_key(|(id, tally)| (std::cmp::Reverse(tally.frames), *id));
    let mut table = TextTable::new(["message", "id", "frames", "bytes", "per second"]);
    for (id, tally) in rows {
        table.push([
            message_name(id).unwrap_or(NO_VALUE).to_owned(),
            id.to_string(),
            tally.frames.to_string(),
            tally.bytes.to_string(),
            or_none(tally.rate_hz(), "", 2),
        ]);
    }
    table.render()
}

fn or_none(value: Option<f64>, unit: &str, decimals: usize) -> String {
    value.map_or_else(|| NO_VALUE.to_owned(), |value| format!("{value:.decimals$}{unit}"))
}

fn run_text(run: &RunFacts) -> String {
    let mut text = format!("\nrun {}\n", run.name);
    let header = ["observations", "count", "per second", "from", "to", "longest gap"];
    let mut table = TextTable::new(header);
    for (name, series) in &run.observations {
        table.push([
            name.clone(),
            series.count.to_string(),
            or_none(series.rate_hz(), "", 2),
            format!("{:.3} s", series.first.as_secs_f64()),
            format!("{:.3} s", series.last.as_secs_f64()),
            format!("{:.3} s", series.longest_gap.as_secs_f64()),
        ]);
    }
    text += &table.render();
    let counts = [(run.truth, "true poses"), (run.withheld, "fixes are withheld")];
    for (count, name) in counts {
        if count > 0 {
            let _ = writeln!(text, "{count} {name}");
        }
    }
    for (reason, count) in &run.bad_rows {
        let _ = writeln!(text, "{count} rows: {reason}");
    }
    text
}

//! The report of `inspect` for people.

use std::fmt::Write as _;

use posebridge_protocol::dialect::message_name;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::statistics::{SenderStatistics, TrafficStatistics};
use posebridge_recording::tlog::ByteOrder;
use posebridge_report::tables::{NO_VALUE, TextTable};

use super::descriptor::RunFacts;
use super::facts::{FramedFacts, InspectResult, RecordingFacts, TlogFacts};
use super::json::{duration_s, kind_name};
use crate::station::input_file::InputKind;

/// Most gaps that are listed.
const MAX_GAPS: usize = 5;

/// The tables, one below the other.
pub(super) fn text(file: &str, kind: InputKind, found: &InspectResult) -> String {
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
        let _ = writeln!(
            text,
            "link {id}  {}  {brick}  {} bytes in {} chunks, up {} times, down {} times",
            link.url, link.bytes, link.chunks, link.ups, link.downs
        );
    }
    for damage in &facts.damages {
        let _ = writeln!(text, "damaged: {damage}");
    }
    if let Some(torn) = &facts.truncation {
        let _ = writeln!(text, "cut off at {torn}");
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
            or_none(silence_s(source), " s", 2),
            clock(source),
        ]);
    }
    table.render()
}

fn silence_s(source: &SenderStatistics) -> Option<f64> {
    let all = &source.total;
    all.first.map(|_| all.longest_silence.as_secs_f64())
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

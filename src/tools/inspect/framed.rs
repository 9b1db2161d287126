//! Telemetry logs and bare captures.

use anyhow::Result;
use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, parse_verified};
use posebridge_recording::tlog::{FrameCheck, LINK_BITS, TlogRecord};
use posebridge_telemetry::{LinkId, Timestamp};

use super::facts::{FramedFacts, TlogFacts};
use crate::console::progress_bar;
use crate::station::input_file::InputFile;
use crate::tools::tlog_records::records;

/// The only link of a file that does not tell links apart.
const LINK: LinkId = LinkId(0);

/// Inspects a telemetry log.
///
/// # Errors
/// It cannot be read.
pub(super) fn tlog(file: InputFile) -> Result<FramedFacts> {
    let mut framed = FramedFacts { epoch_micros: Some(0), ..FramedFacts::default() };
    let mut facts = TlogFacts::default();
    let reader = records(file, |record| {
        record_tlog_frame(&mut framed, &mut facts, &record);
    })?;
    let counts = reader.counts();
    framed.bytes = counts.bytes;
    framed.unknown_frames = counts.unknown;
    framed.unknown_bytes = counts.unknown_bytes;
    framed.bytes_outside = counts.skipped_bytes + counts.unknown_bytes;
    facts.order = reader.byte_order().unwrap_or_default();
    framed.tlog = Some(facts);
    Ok(framed)
}

fn record_tlog_frame(framed: &mut FramedFacts, facts: &mut TlogFacts, record: &TlogRecord<'_, ()>) {
    if !matches!(record.check, FrameCheck::Valid(())) {
        return;
    }
    let bits = (record.micros & LINK_BITS) as usize;
    if let Some(count) = facts.link_bits.get_mut(bits) {
        *count += 1;
    }
    if let Some(frame) = parse_verified(record.frame) {
        let at = Timestamp::from_micros(i64::try_from(record.micros).unwrap_or(i64::MAX));
        framed.census.record_logged(bits, &frame, at);
    }
}

/// Inspects bytes as they came off a link.
///
/// # Errors
/// They cannot be read.
pub(super) fn bytes(mut file: InputFile) -> Result<FramedFacts> {
    let mut framed = FramedFacts::default();
    let mut framer = inspection_framer();
    let bar = progress_bar(file.size, "bytes")?;
    file.chunks(|chunk| {
        framed.bytes += chunk.len() as u64;
        let mut take = |found: FramerOutput<'_>| record_frame(&mut framed, LINK, found, None);
        framer.push(Timestamp::ZERO, chunk, &mut take);
        bar.inc(chunk.len() as u64);
    })?;
    framer.finish(&mut |found| record_frame(&mut framed, LINK, found, None));
    bar.finish_and_clear();
    framed.bytes_outside = framer.counters().garbage_bytes + framed.unknown_bytes;
    Ok(framed)
}

/// A framer for recordings of other programs: of both versions and every dialect.
pub(super) fn inspection_framer() -> Framer {
    Framer::with_all_dialects(FramerConfig { accept_v1: true, ..FramerConfig::default() })
}

/// Counts what a framer has found.
pub(super) fn record_frame(
    framed: &mut FramedFacts,
    link: LinkId,
    found: FramerOutput<'_>,
    at: Option<Timestamp<posebridge_telemetry::HostClock>>,
) {
    match found {
        FramerOutput::Frame(frame) => framed.census.record(link, &frame, at),
        FramerOutput::UnknownFrame(frame) => {
            framed.unknown_frames += 1;
            framed.unknown_bytes += frame.raw.len() as u64;
        }
        FramerOutput::Error(_) => {}
    }
}

//! Telemetry logs and bare captures.

use anyhow::Result;
use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig, verified_before};
use posebridge_recording::tlog::{Judged, LINK_BITS, Record};
use posebridge_telemetry::{LinkId, Stamp};

use super::{Framed, TlogFacts};
use crate::input_file::InputFile;
use crate::progress;
use crate::tlog::records;

/// The only link of a file that does not tell links apart.
const LINK: LinkId = LinkId(0);

/// Inspects a telemetry log.
///
/// # Errors
/// It cannot be read.
pub(super) fn tlog(file: InputFile) -> Result<Framed> {
    let mut framed = Framed { epoch_micros: Some(0), ..Framed::default() };
    let mut facts = TlogFacts::default();
    let reader = records(file, |record| {
        take_record(&mut framed, &mut facts, &record);
    })?;
    let counts = reader.counts();
    framed.bytes = counts.bytes;
    framed.unknown_frames = counts.unknown;
    framed.unknown_bytes = counts.unknown_bytes;
    framed.bytes_outside = counts.bytes_outside + counts.unknown_bytes;
    facts.order = reader.byte_order().unwrap_or_default();
    framed.tlog = Some(facts);
    Ok(framed)
}

fn take_record(framed: &mut Framed, facts: &mut TlogFacts, record: &Record<'_, ()>) {
    if !matches!(record.judged, Judged::Whole(())) {
        return;
    }
    let bits = (record.micros & LINK_BITS) as usize;
    if let Some(count) = facts.link_bits.get_mut(bits) {
        *count += 1;
    }
    if let Some(frame) = verified_before(record.frame) {
        let at = Stamp::from_micros(i64::try_from(record.micros).unwrap_or(i64::MAX));
        framed.census.take_logged(bits, &frame, at);
    }
}

/// Inspects bytes as they came off a link.
///
/// # Errors
/// They cannot be read.
pub(super) fn bytes(mut file: InputFile) -> Result<Framed> {
    let mut framed = Framed::default();
    let mut scanner = inspecting_scanner();
    let bar = progress::bar(file.size, "bytes")?;
    file.chunks(|chunk| {
        framed.bytes += chunk.len() as u64;
        let mut take = |found: Scanned<'_>| take_scanned(&mut framed, LINK, found, None);
        scanner.push(Stamp::ZERO, chunk, &mut take);
        bar.inc(chunk.len() as u64);
    })?;
    scanner.finish(&mut |found| take_scanned(&mut framed, LINK, found, None));
    bar.finish_and_clear();
    framed.bytes_outside = scanner.counters().garbage_bytes + framed.unknown_bytes;
    Ok(framed)
}

/// A scanner for what somebody else has recorded: of both versions and every dialect.
pub(super) fn inspecting_scanner() -> Scanner {
    Scanner::of_every_dialect(ScannerConfig { accept_v1: true, ..ScannerConfig::default() })
}

/// Counts what a scanner has found.
pub(super) fn take_scanned(
    framed: &mut Framed,
    link: LinkId,
    found: Scanned<'_>,
    at: Option<Stamp<posebridge_telemetry::HostClock>>,
) {
    match found {
        Scanned::Frame(frame) => framed.census.take(link, &frame, at),
        Scanned::Unknown(frame) => {
            framed.unknown_frames += 1;
            framed.unknown_bytes += frame.raw.len() as u64;
        }
        Scanned::Defect(_) => {}
    }
}

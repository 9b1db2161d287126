//! Any bytes as a telemetry log: every byte is accounted for, chunks change nothing, and what was read can be written
//! and read again.

use posebridge_protocol::framing::{VerifiedFrame, parse_verified, verify};
use posebridge_recording::tlog::{FrameCheck, TIME_BYTES, TlogCounts, TlogReader, TlogRecord, TlogWriter};

/// A record: where it began, its time, its frame, and whether that was whole.
type OwnedTlogRecord = (u64, u64, Vec<u8>, bool);

/// Input: one byte that says how large the chunks are, then the file.
pub(crate) fn check(data: &[u8]) {
    let [chunk, file @ ..] = data else {
        return;
    };
    let (whole, counts) = read(file, file.len().max(1));
    let (chunked, chunked_counts) = read(file, usize::from(*chunk) + 1);
    assert!(whole == chunked && counts == chunked_counts, "chunks of {chunk} + 1");
    assert_eq!(counts.bytes, file.len() as u64);
    let length = |(_, _, frame, _): &OwnedTlogRecord| (TIME_BYTES + frame.len()) as u64;
    let inside: u64 = whole.iter().map(length).sum();
    assert_eq!(inside + counts.skipped_bytes, counts.bytes);
    assert!(whole.is_sorted_by(|one, next| one.0 + length(one) <= next.0));
    for (_, _, frame, _) in &whole {
        assert!(parse_verified(frame).is_some());
    }
    check_rewritten(&whole);
}

fn classify(raw: &[u8]) -> FrameCheck<()> {
    match verify(raw) {
        VerifiedFrame::Frame(_) => FrameCheck::Valid(()),
        VerifiedFrame::UnknownFrame(_) => FrameCheck::Unknown(()),
        VerifiedFrame::Invalid => FrameCheck::Invalid,
    }
}

fn read(file: &[u8], chunk: usize) -> (Vec<OwnedTlogRecord>, TlogCounts) {
    let mut reader = TlogReader::new();
    let mut records = Vec::new();
    let mut take = |record: TlogRecord<'_, ()>| {
        let is_whole = record.check == FrameCheck::Valid(());
        records.push((record.offset, record.micros, record.frame.to_vec(), is_whole));
    };
    for chunk in file.chunks(chunk) {
        reader.push(chunk, &mut classify, &mut take);
    }
    reader.finish(&mut classify, &mut take);
    (records, reader.counts())
}

/// The verified records, written and read again: the same frames at times that never step back.
fn check_rewritten(records: &[OwnedTlogRecord]) {
    let mut writer = TlogWriter::new(Vec::new());
    let whole: Vec<&OwnedTlogRecord> = records.iter().filter(|(.., is_whole)| *is_whole).collect();
    for (_, micros, frame, _) in &whole {
        // Later than any date, a time could be taken for one the wrong way round.
        assert!(writer.record(micros >> 16, frame).is_ok());
    }
    let Ok(file) = writer.finish() else {
        panic!("a vector takes everything");
    };
    let (again, counts) = read(&file, file.len().max(1));
    assert_eq!((counts.valid, counts.skipped_bytes), (whole.len() as u64, 0));
    assert!(again.is_sorted_by_key(|(_, micros, ..)| *micros));
    for ((_, _, before, _), (_, _, after, _)) in whole.iter().zip(&again) {
        assert_eq!(before, after);
    }
}

//! Any bytes as a telemetry log: every byte is accounted for, chunks change nothing, and what was read can be written and read again.

use posebridge_protocol::framing::{Verified, verified_before, verify};
use posebridge_recording::tlog::{Counts, Judged, Reader, Record, TIME_BYTES, Writer};

/// A record: where it began, its time, its frame, and whether that was whole.
type Read = (u64, u64, Vec<u8>, bool);

/// Input: one byte that says how large the chunks are, then the file.
pub(crate) fn check(data: &[u8]) {
    let [chunk, file @ ..] = data else {
        return;
    };
    let (whole, counts) = read(file, file.len().max(1));
    let (chunked, chunked_counts) = read(file, usize::from(*chunk) + 1);
    assert!(whole == chunked && counts == chunked_counts, "chunks of {chunk} + 1");
    assert_eq!(counts.bytes, file.len() as u64);
    let length = |(_, _, frame, _): &Read| (TIME_BYTES + frame.len()) as u64;
    let inside: u64 = whole.iter().map(length).sum();
    assert_eq!(inside + counts.bytes_outside, counts.bytes);
    assert!(whole.is_sorted_by(|one, next| one.0 + length(one) <= next.0));
    for (_, _, frame, _) in &whole {
        assert!(verified_before(frame).is_some());
    }
    check_rewritten(&whole);
}

fn judge(raw: &[u8]) -> Judged<()> {
    match verify(raw) {
        Verified::Frame(_) => Judged::Whole(()),
        Verified::Unknown(_) => Judged::Unknown(()),
        Verified::Not => Judged::Not,
    }
}

fn read(file: &[u8], chunk: usize) -> (Vec<Read>, Counts) {
    let mut reader = Reader::new();
    let mut records = Vec::new();
    let mut take = |record: Record<'_, ()>| {
        let is_whole = record.judged == Judged::Whole(());
        records.push((record.offset, record.micros, record.frame.to_vec(), is_whole));
    };
    for chunk in file.chunks(chunk) {
        reader.push(chunk, &mut judge, &mut take);
    }
    reader.finish(&mut judge, &mut take);
    (records, reader.counts())
}

/// The verified records, written and read again: the same frames at times that never step back.
fn check_rewritten(records: &[Read]) {
    let mut writer = Writer::new(Vec::new());
    let whole: Vec<&Read> = records.iter().filter(|(.., is_whole)| *is_whole).collect();
    for (_, micros, frame, _) in &whole {
        // Later than any date, a time could be taken for one the wrong way round.
        assert!(writer.record(micros >> 16, frame).is_ok());
    }
    let Ok(file) = writer.finish() else {
        panic!("a vector takes everything");
    };
    let (again, counts) = read(&file, file.len().max(1));
    assert_eq!((counts.whole, counts.bytes_outside), (whole.len() as u64, 0));
    assert!(again.is_sorted_by_key(|(_, micros, ..)| *micros));
    for ((_, _, before, _), (_, _, after, _)) in whole.iter().zip(&again) {
        assert_eq!(before, after);
    }
}

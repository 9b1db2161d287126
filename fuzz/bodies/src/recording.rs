//! Any bytes as a recording: reading ends, errors have the right offset, and what was read can be written and read
//! again.

use std::io::Cursor;

use flate2::Crc;
use posebridge_recording::container::{
    ReadError, RecordingEnd, RecordingHeader, RecordingReader, RecordingWriter, read_truth,
};
use posebridge_telemetry::{HostClock, Input, Timestamp};

/// Bit of the first byte: mend the checksums of the messages, so that damage reaches what stands behind them.
const REPAIR: u8 = 1;
/// The magic at the start of an MCAP file.
const MAGIC_BYTES: usize = 8;
/// Opcode and length in front of every record, MCAP specification, "Records".
const RECORD_HEADER_BYTES: usize = 9;
/// Opcode of a message, MCAP specification, "Message (op=0x05)".
const MESSAGE: u8 = 0x05;
/// Where channel (2), sequence (4), log time (8) and publish time (8) of a message end.
const MESSAGE_HEADER_BYTES: usize = 22;
/// Sequence and log time in a message's header: docs/recording-format.md says how its checksum covers them.
const SEQUENCE: std::ops::Range<usize> = 2..6;
const LOG_TIME: std::ops::Range<usize> = 6..14;
/// Opcode of a chunk, MCAP specification, "Chunk (op=0x06)".
const CHUNK: u8 = 0x06;
/// First and last time (8 each), size (8), checksum (4), name of the compression (4 and none), length of the records (8).
const CHUNK_HEADER_BYTES: usize = 40;
/// The checksum in it.
const CHUNK_CHECKSUM: std::ops::Range<usize> = 24..28;
/// Bytes of the checksum at the end of a message.
const CHECKSUM_BYTES: usize = 4;

/// Input: one byte of options, then the file.
pub(crate) fn check(data: &[u8]) {
    let [options, file @ ..] = data else {
        return;
    };
    let mut file = file.to_vec();
    if options & REPAIR != 0 {
        repair_checksums(&mut file);
    }
    let mut reader = match RecordingReader::open(&file) {
        Ok(reader) => reader,
        Err(error) => return assert_inside(&error, file.len()),
    };
    if let RecordingEnd::Truncated { offset, .. } = reader.recording_end() {
        assert!(offset <= file.len() as u64);
    }
    if let Err(error) = read_truth(&file) {
        assert_inside(&error, file.len());
    }
    let header = reader.header().clone();
    let mut inputs = Vec::new();
    // A message takes more than one byte, and no error repeats itself.
    for _ in 0..=2 * file.len() {
        match reader.next() {
            Some(Ok((now, input))) => {
                assert!(now >= Timestamp::ZERO, "{now:?} is before the session");
                inputs.push((now, input));
            }
            Some(Err(error)) => assert_inside(&error, file.len()),
            None => return check_rewritten(&header, &inputs),
        }
    }
    panic!("the iteration does not end");
}

fn assert_inside(error: &ReadError, length: usize) {
    assert!(!error.to_string().is_empty());
    let (ReadError::NoHeader { offset, .. }
    | ReadError::Compressed { offset, .. }
    | ReadError::Chunk { offset, .. }
    | ReadError::Truth { offset, .. }
    | ReadError::Damaged { offset, .. }
    | ReadError::Message { offset, .. }
    | ReadError::Gap { offset, .. }) = error
    else {
        return;
    };
    assert!(*offset <= length as u64, "{error}");
}

/// What was read is written and read again without loss.
fn check_rewritten(header: &RecordingHeader, inputs: &[(Timestamp<HostClock>, Input)]) {
    let once = write(header, inputs);
    let Ok(reader) = RecordingReader::open(&once) else {
        panic!("what was written is no recording");
    };
    assert_eq!(reader.header(), header);
    assert_eq!(reader.recording_end(), RecordingEnd::Complete);
    let again: Vec<_> = reader.filter_map(Result::ok).collect();
    assert_eq!(again.len(), inputs.len());
    // Compared as bytes, because a number that is none differs from itself.
    assert_eq!(write(header, &again), once);
}

fn write(header: &RecordingHeader, inputs: &[(Timestamp<HostClock>, Input)]) -> Vec<u8> {
    let written = RecordingWriter::create(Cursor::new(Vec::new()), header).and_then(|mut writer| {
        for (now, input) in inputs {
            writer.record(*now, input)?;
        }
        writer.finish()
    });
    match written {
        Ok(file) => file.into_inner(),
        Err(error) => panic!("what was read cannot be written: {error}"),
    }
}

/// Gives every whole message, and every chunk, the checksum that its bytes ask for.
fn repair_checksums(file: &mut [u8]) {
    // Since format 3 the times in the file are UTC, and a message's checksum covers the time since the start of the session.
    let zero = RecordingReader::open(file).map_or(0, |reader| match reader.header().format {
        ..=2 => 0,
        _ => reader.header().utc_start_micros * 1_000,
    });
    repair_records(file.get_mut(MAGIC_BYTES..).unwrap_or_default(), zero);
}

fn repair_records(mut rest: &mut [u8], zero: u64) {
    while let Some((header, content)) = rest.split_first_chunk_mut::<RECORD_HEADER_BYTES>() {
        let [opcode, length @ ..] = *header;
        let length = usize::try_from(u64::from_le_bytes(length)).unwrap_or(usize::MAX);
        let Some((body, behind)) = content.split_at_mut_checked(length) else {
            return;
        };
        match opcode {
            MESSAGE => repair_message(body, zero),
            CHUNK => repair_chunk(body, zero),
            _ => {}
        }
        rest = behind;
    }
}

/// Of a chunk without compression: its records, then its checksum.
fn repair_chunk(body: &mut [u8], zero: u64) {
    let Some((head, records)) = body.split_at_mut_checked(CHUNK_HEADER_BYTES) else {
        return;
    };
    repair_records(records, zero);
    let mut crc = Crc::new();
    crc.update(records);
    head[CHUNK_CHECKSUM].copy_from_slice(&crc.sum().to_le_bytes());
}

fn repair_message(body: &mut [u8], zero: u64) {
    let Some((head, data)) = body.split_at_mut_checked(MESSAGE_HEADER_BYTES) else {
        return;
    };
    let Some((data, checksum)) = data.split_last_chunk_mut::<CHECKSUM_BYTES>() else {
        return;
    };
    let (sequence, time) = (&head[SEQUENCE], &head[LOG_TIME]);
    let mut log_time = [0; 8];
    log_time.copy_from_slice(time);
    let since_start = u64::from_le_bytes(log_time).wrapping_sub(zero);
    let mut crc = Crc::new();
    crc.update(sequence);
    crc.update(&since_start.to_le_bytes());
    crc.update(data);
    *checksum = crc.sum().to_le_bytes();
}

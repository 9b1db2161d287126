//! Any bytes as a recording: reading ends, errors stand where they say, and what was read can be written and read again.

use std::io::Cursor;

use flate2::Crc;
use posebridge_recording::container::{Ending, Header, ReadError, Reader, Writer};
use posebridge_telemetry::{HostClock, Input, Stamp};

/// Bit of the first byte: mend the checksums of the messages, so that damage reaches what stands behind them.
const MEND: u8 = 1;
/// The magic at the start of an MCAP file.
const MAGIC_BYTES: usize = 8;
/// Opcode and length in front of every record, MCAP specification, "Records".
const RECORD_HEADER_BYTES: usize = 9;
/// Opcode of a message, MCAP specification, "Message (op=0x05)".
const MESSAGE: u8 = 0x05;
/// Where channel (2), sequence (4), log time (8) and publish time (8) of a message end.
const MESSAGE_HEADER_BYTES: usize = 22;
/// Sequence and log time in a message's header, which its checksum covers: docs/recording-format.md.
const COVERED: std::ops::Range<usize> = 2..14;
/// Bytes of the checksum at the end of a message.
const CHECKSUM_BYTES: usize = 4;

/// Input: one byte of options, then the file.
pub(crate) fn check(data: &[u8]) {
    let [options, file @ ..] = data else {
        return;
    };
    let mut file = file.to_vec();
    if options & MEND != 0 {
        mend_checksums(&mut file);
    }
    let mut reader = match Reader::open(&file) {
        Ok(reader) => reader,
        Err(error) => return assert_inside(&error, file.len()),
    };
    if let Ending::Torn { offset, .. } = reader.ending() {
        assert!(offset <= file.len() as u64);
    }
    let header = reader.header().clone();
    let mut inputs = Vec::new();
    // A message takes more than one byte, and no error repeats itself.
    for _ in 0..=2 * file.len() {
        match reader.next() {
            Some(Ok((now, input))) => {
                assert!(now >= Stamp::ZERO, "{now:?} is before the session");
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
    | ReadError::Chunked { offset }
    | ReadError::Damaged { offset, .. }
    | ReadError::Message { offset, .. }
    | ReadError::Gap { offset, .. }) = error
    else {
        return;
    };
    assert!(*offset <= length as u64, "{error}");
}

/// What was read is written and read again without loss.
fn check_rewritten(header: &Header, inputs: &[(Stamp<HostClock>, Input)]) {
    let once = write(header, inputs);
    let Ok(reader) = Reader::open(&once) else {
        panic!("what was written is no recording");
    };
    assert_eq!(reader.header(), header);
    assert_eq!(reader.ending(), Ending::Complete);
    let again: Vec<_> = reader.filter_map(Result::ok).collect();
    assert_eq!(again.len(), inputs.len());
    // Compared as bytes, because a number that is none differs from itself.
    assert_eq!(write(header, &again), once);
}

fn write(header: &Header, inputs: &[(Stamp<HostClock>, Input)]) -> Vec<u8> {
    let written = Writer::create(Cursor::new(Vec::new()), header).and_then(|mut writer| {
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

/// Gives every whole message the checksum that its bytes ask for.
fn mend_checksums(file: &mut [u8]) {
    let mut rest = file.get_mut(MAGIC_BYTES..).unwrap_or_default();
    while let Some((header, content)) = rest.split_first_chunk_mut::<RECORD_HEADER_BYTES>() {
        let [opcode, length @ ..] = *header;
        let length = usize::try_from(u64::from_le_bytes(length)).unwrap_or(usize::MAX);
        let Some((body, behind)) = content.split_at_mut_checked(length) else {
            return;
        };
        if opcode == MESSAGE {
            mend_message(body);
        }
        rest = behind;
    }
}

fn mend_message(body: &mut [u8]) {
    let Some((head, data)) = body.split_at_mut_checked(MESSAGE_HEADER_BYTES) else {
        return;
    };
    let Some((data, checksum)) = data.split_last_chunk_mut::<CHECKSUM_BYTES>() else {
        return;
    };
    let mut crc = Crc::new();
    crc.update(&head[COVERED]);
    crc.update(data);
    *checksum = crc.sum().to_le_bytes();
}

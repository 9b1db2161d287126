//! Splits a `.tlog` file into records.
//!
//! A record counts if the caller verifies its frame. After damage the search continues byte by byte, so that the next intact record is
//! found at any offset. A frame that cannot be verified counts as such, and only between other records.
//!
//! Every byte belongs to exactly one of: a whole record, an unverified one, or the bytes outside. The result does not
//! depend on how the file is split into chunks.

use super::{ByteOrder, TIME_BYTES};

const START_V2: u8 = 0xFD;
const START_V1: u8 = 0xFE;
/// Header and checksum of a MAVLink 2 frame.
const ENVELOPE_V2_BYTES: usize = 12;
/// Header and checksum of a MAVLink 1 frame.
const ENVELOPE_V1_BYTES: usize = 8;
const SIGNATURE_BYTES: usize = 13;
const FLAG_SIGNED: u8 = 0x01;

const MAX_FRAME_BYTES: usize = ENVELOPE_V2_BYTES + 255 + SIGNATURE_BYTES;
const MAX_RECORD_BYTES: usize = TIME_BYTES + MAX_FRAME_BYTES;
/// Number of bytes that decide whether a record begins at the first of them: an unverified one must not contain the beginning of a
/// valid one, and another must begin after it.
const LOOKAHEAD_BYTES: usize = 2 * MAX_RECORD_BYTES;

/// The caller's verdict on bytes with the length of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameCheck<T> {
    /// The checksum matches; with the caller's own data.
    Valid(T),
    /// Of a message that the caller does not know and cannot verify.
    Unknown(T),
    Invalid,
}

/// A record of a telemetry log: time and frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TlogRecord<'a, T> {
    pub offset: u64,
    /// Receive or send time since 1970 UTC, as in the file.
    pub micros: u64,
    pub frame: &'a [u8],
    /// Never [`FrameCheck::Invalid`].
    pub check: FrameCheck<T>,
}

/// Classification of the bytes so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TlogCounts {
    pub bytes: u64,
    /// Records with an intact frame.
    pub valid: u64,
    /// Records whose frame could not be verified.
    pub unknown: u64,
    /// With their timestamps.
    pub unknown_bytes: u64,
    /// Outside records.
    pub skipped_bytes: u64,
}

/// Splits chunks of a file into records.
///
/// # Examples
/// ```
/// use posebridge_recording::tlog::{FrameCheck, TlogReader};
///
/// // Ten seconds after 1970, a heartbeat of a ground rover, 1/1; and three bytes outside a record.
/// let mut file = 10_000_000_u64.to_be_bytes().to_vec();
/// file.extend([0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB]);
/// file.extend([1, 2, 3]);
/// let mut reader = TlogReader::new();
/// let mut times = Vec::new();
/// let check_frame = &mut |_frame: &[u8]| FrameCheck::Valid(());
/// reader.push(&file, check_frame, &mut |record| times.push(record.micros));
/// reader.finish(check_frame, &mut |record| times.push(record.micros));
/// assert_eq!(times, [10_000_000]);
/// assert_eq!(reader.counts().skipped_bytes, 3);
/// ```
#[derive(Clone, Debug, Default)]
pub struct TlogReader {
    /// Bytes that are not classified yet.
    buffer: Vec<u8>,
    order: Option<ByteOrder>,
    counts: TlogCounts,
}

enum ParseStep<'a, T> {
    Record { frame: &'a [u8], check: FrameCheck<T> },
    Skip(usize),
}

impl TlogReader {
    pub fn new() -> Self {
        Self::default()
    }

    /// Parses the next chunk of the file; passes the records that are certain now to `sink`, in order.
    pub fn push<T: Copy>(
        &mut self,
        chunk: &[u8],
        check_frame: &mut impl FnMut(&[u8]) -> FrameCheck<T>,
        sink: &mut impl FnMut(TlogRecord<'_, T>),
    ) {
        self.buffer.extend_from_slice(chunk);
        self.scan(LOOKAHEAD_BYTES, check_frame, sink);
    }

    /// Ends the file: passes the remaining records to `sink`.
    pub fn finish<T: Copy>(
        &mut self,
        check_frame: &mut impl FnMut(&[u8]) -> FrameCheck<T>,
        sink: &mut impl FnMut(TlogRecord<'_, T>),
    ) {
        self.scan(1, check_frame, sink);
    }

    pub const fn counts(&self) -> TlogCounts {
        self.counts
    }

    /// `None` before the first record.
    pub const fn byte_order(&self) -> Option<ByteOrder> {
        self.order
    }

    /// Classifies every position followed by at least `needed` bytes.
    fn scan<T: Copy>(
        &mut self,
        needed: usize,
        check_frame: &mut impl FnMut(&[u8]) -> FrameCheck<T>,
        sink: &mut impl FnMut(TlogRecord<'_, T>),
    ) {
        let waiting = std::mem::take(&mut self.buffer);
        let mut rest = waiting.as_slice();
        while rest.len() >= needed {
            let step = parse_step(rest, check_frame);
            let taken = match step {
                ParseStep::Record { frame, check } => {
                    self.emit(rest, frame, check, sink);
                    TIME_BYTES + frame.len()
                }
                ParseStep::Skip(bytes) => {
                    self.counts.skipped_bytes += bytes as u64;
                    bytes
                }
            };
            self.counts.bytes += taken as u64;
            rest = rest.get(taken..).unwrap_or_default();
        }
        let decided = waiting.len() - rest.len();
        self.buffer = waiting;
        self.buffer.drain(..decided);
    }

    fn emit<T: Copy>(
        &mut self,
        record: &[u8],
        frame: &[u8],
        check: FrameCheck<T>,
        sink: &mut impl FnMut(TlogRecord<'_, T>),
    ) {
        let Some(time) = record.first_chunk::<TIME_BYTES>() else {
            return;
        };
        let order = *self.order.get_or_insert_with(|| ByteOrder::of_first(*time));
        match check {
            FrameCheck::Valid(_) => self.counts.valid += 1,
            FrameCheck::Unknown(_) => {
                self.counts.unknown += 1;
                self.counts.unknown_bytes += (TIME_BYTES + frame.len()) as u64;
            }
            FrameCheck::Invalid => {}
        }
        sink(TlogRecord { offset: self.counts.bytes, micros: order.micros(*time), frame, check });
    }
}

/// Classifies the first of the bytes.
#[inline]
fn parse_step<'a, T: Copy>(bytes: &'a [u8], check_frame: &mut impl FnMut(&[u8]) -> FrameCheck<T>) -> ParseStep<'a, T> {
    let Some(frame) = frame_after_time(bytes) else {
        return ParseStep::Skip(bytes_to_next_start(bytes));
    };
    let check = check_frame(frame);
    let is_record = match check {
        FrameCheck::Valid(_) => true,
        FrameCheck::Unknown(_) => is_between_records(bytes, frame.len(), check_frame),
        FrameCheck::Invalid => false,
    };
    if is_record { ParseStep::Record { frame, check } } else { ParseStep::Skip(bytes_to_next_start(bytes)) }
}

/// The frame of a record that begins here.
#[inline]
fn frame_after_time(bytes: &[u8]) -> Option<&[u8]> {
    split_frame(bytes.get(TIME_BYTES..)?)
}

const fn is_start(byte: u8) -> bool {
    matches!(byte, START_V1 | START_V2)
}

/// The first frame in `bytes`; `None` if none begins there or it is incomplete.
#[inline]
fn split_frame(bytes: &[u8]) -> Option<&[u8]> {
    let length = match *bytes {
        [START_V2, payload, flags, ..] => {
            let signature = if flags & FLAG_SIGNED == 0 { 0 } else { SIGNATURE_BYTES };
            ENVELOPE_V2_BYTES + usize::from(payload) + signature
        }
        [START_V1, payload, ..] => ENVELOPE_V1_BYTES + usize::from(payload),
        _ => return None,
    };
    bytes.get(..length)
}

/// Distance to the next possible start of a record; all bytes if there is none.
fn bytes_to_next_start(bytes: &[u8]) -> usize {
    let behind = bytes.get(TIME_BYTES + 1..).unwrap_or_default();
    let next = behind.iter().position(|byte| is_start(*byte));
    // Where the bytes end, the start of the next record's frame may be just beyond them.
    next.map_or_else(|| bytes.len().saturating_sub(TIME_BYTES).max(1), |at| at + 1)
}

/// Whether an unverifiable frame is plausible: the file ends after it or continues with a possible record, and no valid record begins
/// inside.
fn is_between_records<T: Copy>(
    bytes: &[u8],
    frame: usize,
    check_frame: &mut impl FnMut(&[u8]) -> FrameCheck<T>,
) -> bool {
    let end = TIME_BYTES + frame;
    let behind = bytes.get(end..).unwrap_or_default();
    let is_followed = behind.is_empty() || behind.get(TIME_BYTES).copied().is_some_and(is_start);
    let mut inside = 1..end;
    is_followed
        && !inside.any(|at| {
            let record = bytes.get(at..).and_then(frame_after_time);
            record.is_some_and(|frame| matches!(check_frame(frame), FrameCheck::Valid(_)))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stands for a checksum: frames of message 1 that are filled to their end are whole, those of 2 unknown.
    fn check_frame(frame: &[u8]) -> FrameCheck<u8> {
        match frame.get(7) {
            Some(1) if frame[10..].iter().all(|byte| *byte == 0x55) => FrameCheck::Valid(1),
            Some(2) => FrameCheck::Unknown(2),
            _ => FrameCheck::Invalid,
        }
    }

    fn frame(id: u8, payload: u8) -> Vec<u8> {
        let mut frame = vec![0xFD, payload, 0, 0, 0, 1, 1, id, 0, 0];
        frame.resize(12 + usize::from(payload), 0x55);
        frame
    }

    fn record(micros: u64, id: u8, payload: u8) -> Vec<u8> {
        [micros.to_be_bytes().to_vec(), frame(id, payload)].concat()
    }

    /// Offsets and times, read in chunks of this number of bytes.
    fn read(file: &[u8], chunk: usize) -> (Vec<(u64, u64)>, TlogCounts) {
        let mut reader = TlogReader::new();
        let mut found = Vec::new();
        for chunk in file.chunks(chunk) {
            reader.push(chunk, &mut check_frame, &mut |one| {
                found.push((one.offset, one.micros));
            });
        }
        reader.finish(&mut check_frame, &mut |one| found.push((one.offset, one.micros)));
        (found, reader.counts())
    }

    #[test]
    fn damage_costs_its_own_bytes_and_no_record_behind_it() {
        let whole = record(7, 1, 20);
        let truncated = &whole[..17];
        let file = [whole.as_slice(), truncated, &whole, &[0xFD; 30], &whole, &whole[..9]].concat();
        let at = [0, 57, 127].map(|at| (at, 7));
        for chunk in 1..=file.len() {
            let (found, counts) = read(&file, chunk);
            assert_eq!(found, at, "chunks of {chunk}");
            assert_eq!(counts.skipped_bytes, 17 + 30 + 9);
            assert_eq!(counts.bytes, file.len() as u64);
        }
    }

    #[test]
    fn the_longest_records_are_whole_however_they_are_cut() {
        let file = [record(1, 1, 255), record(2, 1, 255)].concat();
        for chunk in [1, 100, 275, 276, file.len()] {
            let (found, counts) = read(&file, chunk);
            assert_eq!(found, [(0, 1), (275, 2)], "chunks of {chunk}");
            assert_eq!(counts.skipped_bytes, 0);
        }
    }

    #[test]
    fn an_unknown_frame_counts_between_records_and_not_where_it_swallows_one() {
        let file = [record(1, 1, 3), record(2, 2, 9), record(3, 1, 3)].concat();
        for chunk in [1, 13, file.len()] {
            let (found, counts) = read(&file, chunk);
            assert_eq!(found.len(), 3);
            assert_eq!((counts.valid, counts.unknown), (2, 1));
            assert_eq!((counts.unknown_bytes, counts.skipped_bytes), (29, 0));
        }
        let greedy = [record(2, 2, 60)[..20].to_vec(), record(3, 1, 3), record(4, 1, 3), vec![0; 40]];
        let (found, counts) = read(&greedy.concat(), 7);
        assert_eq!(found, [(20, 3), (43, 4)]);
        assert_eq!((counts.unknown, counts.skipped_bytes), (0, 60));
    }

    #[test]
    fn times_the_wrong_way_round_are_told_by_the_first_of_them() {
        let micros = 1_742_581_143_368_055_u64;
        for (time, order) in [(micros.to_be_bytes(), ByteOrder::Big), (micros.to_le_bytes(), ByteOrder::Little)] {
            assert_eq!(ByteOrder::of_first(time), order);
            assert_eq!(order.micros(time), micros);
        }
        // A clock that counts from its own start stays as it is.
        assert_eq!(ByteOrder::of_first(47_333_000_u64.to_be_bytes()), ByteOrder::Big);
    }

    #[test]
    fn nothing_is_kept_beyond_what_decides() {
        let mut reader = TlogReader::new();
        for _ in 0..1_000 {
            reader.push(&[0xFE; 999], &mut check_frame, &mut |_record| {});
            assert!(reader.buffer.len() < LOOKAHEAD_BYTES);
        }
    }
}

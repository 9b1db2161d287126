//! The outcome of the frames in one direction of a link, from its byte log.
//!
//! The link handles only bytes and units. The ledger scans the offered bytes for frames and looks up every byte in the log: a frame has
//! arrived if all of its bytes have, unchanged. This is the ground truth for a receiver's loss counters; it uses no sequence number.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
use posebridge_telemetry::{Address, HostClock, ReceiveError, Timestamp};
use serde::Serialize;

use super::byte_log::{ByteOutcome, LogEntry};

/// Newest frames and units that are kept after their outcome is known: a copy may still arrive.
const MAX_RETAINED: usize = 2_048;
/// Half the range of an 8-bit sequence number.
const HALF_CIRCLE: u64 = 128;
/// Bounds the entries that wait for the rest of a frame.
const MAX_PENDING: usize = 65_536;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    pub sent: u64,
    pub whole: u64,
    pub lost: u64,
    /// Complete copies.
    pub repeated: u64,
    /// Frames and copies that arrived whole after one that was sent more than 128 frames later: an 8-bit sequence number cannot order
    /// them.
    pub undatable: u64,
    /// Frames lost between the first and the newest that arrived whole: the loss that a receiver can detect.
    pub missing_between: u64,
}

#[derive(Clone, Copy, Debug, Default)]
struct SenderAccount {
    counts: FrameCounts,
    /// Frame number, counted from 1.
    first_intact: Option<u64>,
    latest_intact: u64,
}

impl SenderAccount {
    const fn count_undatable(&mut self, number: u64) {
        if number + HALF_CIRCLE < self.latest_intact {
            self.counts.undatable += 1;
        }
    }
}

#[derive(Clone, Debug)]
struct FrameInTransit {
    byte_range: Range<u64>,
    source: Address,
    /// Counted from 1 per sender.
    number: u64,
    undecided_bytes: u64,
    duplicated_bytes: u64,
    is_damaged: bool,
}

/// A unit and the offset of its first byte among all offered bytes.
#[derive(Clone, Copy, Debug)]
struct UnitOffset {
    number: u64,
    start: u64,
}

/// Outcome of a range of bytes, by offsets among all offered bytes.
#[derive(Clone, Debug)]
struct RangeOutcome {
    byte_range: Range<u64>,
    outcome: ByteOutcome,
}

#[derive(Debug)]
pub struct FrameLedger {
    framer: Framer,
    offered: u64,
    /// Bytes that are assigned to a frame or to none.
    scanned: u64,
    units: VecDeque<UnitOffset>,
    frames: VecDeque<FrameInTransit>,
    waiting: VecDeque<RangeOutcome>,
    accounts: BTreeMap<Address, SenderAccount>,
}

impl Default for FrameLedger {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameLedger {
    pub fn new() -> Self {
        Self {
            framer: Framer::new(FramerConfig::default()),
            offered: 0,
            scanned: 0,
            units: VecDeque::new(),
            frames: VecDeque::new(),
            waiting: VecDeque::new(),
            accounts: BTreeMap::new(),
        }
    }

    /// Scans what was offered as unit `number` at `now`. A frame may begin in one unit and end in a later one.
    pub fn offer(&mut self, now: Timestamp<HostClock>, number: u64, bytes: &[u8]) {
        let start = self.offered;
        self.units.push_back(UnitOffset { number, start });
        self.offered += bytes.len() as u64;
        let (scanned, frames, accounts) = (&mut self.scanned, &mut self.frames, &mut self.accounts);
        self.framer.push(now, bytes, &mut |found| match found {
            FramerOutput::Frame(frame) => {
                let range = *scanned..*scanned + frame.raw.len() as u64;
                *scanned = range.end;
                let account = accounts.entry(frame.source).or_default();
                account.counts.sent += 1;
                frames.push_back(FrameInTransit {
                    undecided_bytes: range.end - range.start,
                    byte_range: range,
                    source: frame.source,
                    number: account.counts.sent,
                    duplicated_bytes: 0,
                    is_damaged: false,
                });
            }
            FramerOutput::UnknownFrame(frame) => *scanned += frame.raw.len() as u64,
            FramerOutput::Error(ReceiveError::UnframedBytes { bytes }) => *scanned += u64::from(bytes),
            FramerOutput::Error(_) => {}
        });
    }

    /// Applies the direction's log, which must be complete.
    pub fn apply_log(&mut self, log: &[LogEntry]) {
        for entry in log {
            if matches!(entry.outcome, ByteOutcome::Stalled { .. } | ByteOutcome::HeldBack { .. }) {
                continue;
            }
            let found = self.units.binary_search_by_key(&entry.unit, |unit| unit.number);
            let Some(unit) = found.ok().and_then(|index| self.units.get(index)) else {
                continue;
            };
            let range = unit.start + entry.bytes.start as u64..unit.start + entry.bytes.end as u64;
            if self.waiting.len() >= MAX_PENDING {
                self.waiting.pop_front();
            }
            self.waiting.push_back(RangeOutcome { byte_range: range, outcome: entry.outcome });
        }
        self.apply_pending();
        self.drop_decided();
    }

    pub fn counts(&self) -> impl Iterator<Item = (Address, FrameCounts)> {
        self.accounts.iter().map(|(source, account)| {
            let mut counts = account.counts;
            if let Some(first) = account.first_intact {
                counts.missing_between = account.latest_intact + 1 - first - counts.whole;
            }
            (*source, counts)
        })
    }

    /// Applies the pending entries about bytes whose frames are known.
    fn apply_pending(&mut self) {
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting.retain(|range| {
            let is_known = range.byte_range.end <= self.scanned;
            if is_known {
                self.apply(range);
            }
            !is_known
        });
        self.waiting = waiting;
    }

    fn apply(&mut self, range: &RangeOutcome) {
        let first = self.frames.partition_point(|frame| frame.byte_range.end <= range.byte_range.start);
        for frame in self.frames.range_mut(first..) {
            if frame.byte_range.start >= range.byte_range.end {
                break;
            }
            let shared =
                frame.byte_range.end.min(range.byte_range.end) - frame.byte_range.start.max(range.byte_range.start);
            let account = self.accounts.entry(frame.source).or_default();
            match range.outcome {
                ByteOutcome::Flipped { .. } => frame.is_damaged = true,
                ByteOutcome::Duplicated { .. } => frame.count_duplicate(shared, account),
                ByteOutcome::Delivered { .. } => frame.count_bytes(shared, account),
                ByteOutcome::Lost(_) => {
                    frame.is_damaged = true;
                    frame.count_bytes(shared, account);
                }
                ByteOutcome::Stalled { .. } | ByteOutcome::HeldBack { .. } => {}
            }
        }
    }

    /// Drops frames and units that no further entry can change.
    fn drop_decided(&mut self) {
        while self.frames.len() > MAX_RETAINED && self.frames.front().is_some_and(|frame| frame.undecided_bytes == 0) {
            self.frames.pop_front();
        }
        let oldest = self.frames.front().map_or(self.scanned, |frame| frame.byte_range.start);
        // The log may still name the unit in which the oldest frame begins.
        while self.units.len() > MAX_RETAINED && self.units.get(1).is_some_and(|next| next.start <= oldest) {
            self.units.pop_front();
        }
    }
}

impl FrameInTransit {
    fn count_bytes(&mut self, bytes: u64, account: &mut SenderAccount) {
        self.undecided_bytes = self.undecided_bytes.saturating_sub(bytes);
        if self.undecided_bytes > 0 {
            return;
        }
        if self.is_damaged {
            account.counts.lost += 1;
            return;
        }
        account.counts.whole += 1;
        account.count_undatable(self.number);
        let first = account.first_intact.get_or_insert(self.number);
        *first = (*first).min(self.number);
        account.latest_intact = account.latest_intact.max(self.number);
    }

    const fn count_duplicate(&mut self, bytes: u64, account: &mut SenderAccount) {
        self.duplicated_bytes += bytes;
        if !self.is_damaged && self.duplicated_bytes == self.byte_range.end - self.byte_range.start {
            account.counts.repeated += 1;
            account.count_undatable(self.number);
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::impairment::byte_log::LossCause;

    use super::*;

    /// A heartbeat of a ground rover, 1/1, number 0.
    const FRAME: [u8; 21] = [0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB];
    const AT: Timestamp<HostClock> = Timestamp::ZERO;
    const ARRIVED: ByteOutcome = ByteOutcome::Delivered { at: AT };

    fn apply(ledger: &mut FrameLedger, log: &[(u64, Range<usize>, ByteOutcome)]) -> FrameCounts {
        let entries: Vec<LogEntry> = log
            .iter()
            .map(|(unit, bytes, outcome)| LogEntry { unit: *unit, bytes: bytes.clone(), outcome: *outcome })
            .collect();
        ledger.apply_log(&entries);
        ledger.counts().next().map_or_else(FrameCounts::default, |(_, counts)| counts)
    }

    /// A ledger of so many frames, each in a unit of its own.
    fn offered(frames: u64) -> FrameLedger {
        let mut ledger = FrameLedger::new();
        (0..frames).for_each(|unit| ledger.offer(AT, unit, &FRAME));
        ledger
    }

    #[test]
    fn a_frame_counts_once_all_its_bytes_are_decided_whatever_units_they_came_in() {
        let mut ledger = FrameLedger::new();
        ledger.offer(AT, 0, &FRAME[..10]);
        apply(&mut ledger, &[(0, 0..10, ARRIVED)]);
        ledger.offer(AT, 1, &[&FRAME[10..], &FRAME, &FRAME[..3]].concat());
        let counts = apply(&mut ledger, &[(1, 0..11, ARRIVED)]);
        assert_eq!((counts.sent, counts.whole, counts.lost), (2, 1, 0));
        apply(&mut ledger, &[(1, 11..35, ARRIVED)]);
        ledger.offer(AT, 2, &FRAME[3..]);
        let counts = apply(&mut ledger, &[(2, 0..18, ARRIVED)]);
        assert_eq!(counts, FrameCounts { sent: 3, whole: 3, ..FrameCounts::default() });
    }

    #[test]
    fn a_missing_byte_a_turned_bit_and_a_lost_unit_each_cost_a_frame_and_a_copy_is_no_second_one() {
        let log = [
            (0, 0..21, ARRIVED),
            (0, 0..21, ByteOutcome::Duplicated { at: AT }),
            (1, 5..6, ByteOutcome::Lost(LossCause::Byte)),
            (1, 0..5, ARRIVED),
            (1, 6..21, ARRIVED),
            (2, 20..21, ByteOutcome::Flipped { bit: 3 }),
            (2, 0..21, ARRIVED),
            (3, 0..21, ByteOutcome::Lost(LossCause::LinkDown)),
            (4, 0..21, ARRIVED),
            (5, 0..21, ByteOutcome::Lost(LossCause::LinkDown)),
        ];
        let expected =
            FrameCounts { sent: 6, whole: 2, lost: 4, repeated: 1, missing_between: 3, ..FrameCounts::default() };
        assert_eq!(apply(&mut offered(6), &log), expected);
    }

    #[test]
    fn a_frame_that_comes_more_than_half_a_circle_late_cannot_be_dated() {
        for (newer, expected) in [(128, 0), (129, 1)] {
            let counts = apply(&mut offered(newer + 1), &[(newer, 0..21, ARRIVED), (0, 0..21, ARRIVED)]);
            assert_eq!(counts.undatable, expected, "{newer} newer ones");
        }
    }

    #[test]
    fn what_is_decided_is_forgotten() {
        let mut ledger = FrameLedger::new();
        for unit in 0..5_000 {
            ledger.offer(AT, unit, &FRAME);
            assert_eq!(apply(&mut ledger, &[(unit, 0..21, ARRIVED)]).whole, unit + 1);
        }
        assert!(ledger.frames.len() <= MAX_RETAINED && ledger.units.len() <= MAX_RETAINED + 1);
        assert!(ledger.waiting.is_empty());
    }
}

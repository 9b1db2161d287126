//! What a direction of a link did to the frames that travelled on it, by its log.
//!
//! The link itself knows bytes and units only. Here the bytes that are offered are scanned, so that every frame has its place in them,
//! and the log says of every byte what became of it: a frame has arrived if all of its bytes have, with every bit as it was. That
//! is the truth that a receiver's account of its losses is held against; it uses no sequence number.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig};
use posebridge_telemetry::{Address, Defect, HostClock, Stamp};
use serde::Serialize;

use super::account::{Fate, LogEntry};

/// Frames and units of which all is known are kept while they are among the newest so many: a copy may still arrive.
const KEPT: usize = 2_048;
/// Half the numbers of 8 bits.
const HALF_CIRCLE: u64 = 128;
/// Most entries that wait for the rest of a frame.
const WAITING: usize = 65_536;

/// What became of the frames of one sender.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FrameCounts {
    /// Frames sent.
    pub sent: u64,
    /// Frames that arrived whole.
    pub whole: u64,
    /// Frames of which something is missing or changed.
    pub lost: u64,
    /// Copies that arrived whole.
    pub repeated: u64,
    /// Frames and copies that arrived whole after one that was sent more than 128 frames later: an 8-bit number does not tell them
    /// from newer ones.
    pub undatable: u64,
    /// Frames that are missing between the first and the newest that arrived whole: those of which a receiver can know.
    pub missing_between: u64,
}

/// The account of one sender.
#[derive(Clone, Copy, Debug, Default)]
struct Account {
    counts: FrameCounts,
    /// Number of the first frame that arrived whole, counted from 1.
    first_whole: Option<u64>,
    /// Number of the newest.
    newest_whole: u64,
}

impl Account {
    const fn tell_age(&mut self, number: u64) {
        if number + HALF_CIRCLE < self.newest_whole {
            self.counts.undatable += 1;
        }
    }
}

/// A frame on its way.
#[derive(Clone, Debug)]
struct Travelling {
    place: Range<u64>,
    source: Address,
    /// Which of its sender's frames, counted from 1.
    number: u64,
    undecided: u64,
    copied: u64,
    is_hurt: bool,
}

/// A unit and where its bytes begin among all that were offered.
#[derive(Clone, Copy, Debug)]
struct Unit {
    number: u64,
    start: u64,
}

/// What became of a range of bytes, by their places among all that were offered.
#[derive(Clone, Debug)]
struct Verdict {
    place: Range<u64>,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Arrived,
    Copied,
    Lost,
    Changed,
}

/// Follows the frames of one direction.
#[derive(Debug)]
pub struct FrameLedger {
    scanner: Scanner,
    /// Bytes offered.
    offered: u64,
    /// Bytes that belong to a frame or to none.
    scanned: u64,
    units: VecDeque<Unit>,
    frames: VecDeque<Travelling>,
    waiting: VecDeque<Verdict>,
    accounts: BTreeMap<Address, Account>,
}

impl Default for FrameLedger {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameLedger {
    /// A ledger of a direction on which nothing travels yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            scanner: Scanner::new(ScannerConfig::default()),
            offered: 0,
            scanned: 0,
            units: VecDeque::new(),
            frames: VecDeque::new(),
            waiting: VecDeque::new(),
            accounts: BTreeMap::new(),
        }
    }

    /// Takes what was offered as unit `number` at `now`. A frame may begin in one unit and end in a later one.
    pub fn offer(&mut self, now: Stamp<HostClock>, number: u64, bytes: &[u8]) {
        let start = self.offered;
        self.units.push_back(Unit { number, start });
        self.offered += bytes.len() as u64;
        let (scanned, frames, accounts) = (&mut self.scanned, &mut self.frames, &mut self.accounts);
        self.scanner.push(now, bytes, &mut |found| match found {
            Scanned::Frame(frame) => {
                let place = *scanned..*scanned + frame.raw.len() as u64;
                *scanned = place.end;
                let account = accounts.entry(frame.source).or_default();
                account.counts.sent += 1;
                frames.push_back(Travelling {
                    undecided: place.end - place.start,
                    place,
                    source: frame.source,
                    number: account.counts.sent,
                    copied: 0,
                    is_hurt: false,
                });
            }
            Scanned::Unknown(frame) => *scanned += frame.raw.len() as u64,
            Scanned::Defect(Defect::Garbage { bytes }) => *scanned += u64::from(bytes),
            Scanned::Defect(_) => {}
        });
    }

    /// Takes the direction's log, which must be told of without a hole.
    pub fn follow(&mut self, log: &[LogEntry]) {
        for entry in log {
            let kind = match entry.fate {
                Fate::Delivered { .. } => Kind::Arrived,
                Fate::Repeated { .. } => Kind::Copied,
                Fate::Lost(_) => Kind::Lost,
                Fate::Flipped { .. } => Kind::Changed,
                Fate::Stalled { .. } | Fate::HeldBack { .. } => continue,
            };
            let found = self.units.binary_search_by_key(&entry.unit, |unit| unit.number);
            let Some(unit) = found.ok().and_then(|index| self.units.get(index)) else {
                continue;
            };
            let place = unit.start + entry.bytes.start as u64..unit.start + entry.bytes.end as u64;
            if self.waiting.len() >= WAITING {
                self.waiting.pop_front();
            }
            self.waiting.push_back(Verdict { place, kind });
        }
        self.judge();
        self.forget();
    }

    /// What became of the frames of each sender so far.
    pub fn counts(&self) -> impl Iterator<Item = (Address, FrameCounts)> {
        self.accounts.iter().map(|(source, account)| {
            let mut counts = account.counts;
            if let Some(first) = account.first_whole {
                counts.missing_between = account.newest_whole + 1 - first - counts.whole;
            }
            (*source, counts)
        })
    }

    /// Applies what waits and speaks of bytes whose frames are known.
    fn judge(&mut self) {
        let mut waiting = std::mem::take(&mut self.waiting);
        waiting.retain(|verdict| {
            let is_known = verdict.place.end <= self.scanned;
            if is_known {
                self.apply(verdict);
            }
            !is_known
        });
        self.waiting = waiting;
    }

    fn apply(&mut self, verdict: &Verdict) {
        let first = self.frames.partition_point(|frame| frame.place.end <= verdict.place.start);
        for frame in self.frames.range_mut(first..) {
            if frame.place.start >= verdict.place.end {
                break;
            }
            let shared = frame.place.end.min(verdict.place.end) - frame.place.start.max(verdict.place.start);
            let account = self.accounts.entry(frame.source).or_default();
            match verdict.kind {
                Kind::Changed => frame.is_hurt = true,
                Kind::Copied => frame.copy(shared, account),
                Kind::Arrived => frame.decide(shared, account),
                Kind::Lost => {
                    frame.is_hurt = true;
                    frame.decide(shared, account);
                }
            }
        }
    }

    /// Drops what nothing can be said of any more.
    fn forget(&mut self) {
        while self.frames.len() > KEPT && self.frames.front().is_some_and(|frame| frame.undecided == 0) {
            self.frames.pop_front();
        }
        let oldest = self.frames.front().map_or(self.scanned, |frame| frame.place.start);
        // The unit in which the oldest frame begins is still spoken of.
        while self.units.len() > KEPT && self.units.get(1).is_some_and(|next| next.start <= oldest) {
            self.units.pop_front();
        }
    }
}

impl Travelling {
    /// So many of its bytes have arrived or are lost.
    fn decide(&mut self, bytes: u64, account: &mut Account) {
        self.undecided = self.undecided.saturating_sub(bytes);
        if self.undecided > 0 {
            return;
        }
        if self.is_hurt {
            account.counts.lost += 1;
            return;
        }
        account.counts.whole += 1;
        account.tell_age(self.number);
        let first = account.first_whole.get_or_insert(self.number);
        *first = (*first).min(self.number);
        account.newest_whole = account.newest_whole.max(self.number);
    }

    /// So many bytes of a copy have arrived.
    const fn copy(&mut self, bytes: u64, account: &mut Account) {
        self.copied += bytes;
        if !self.is_hurt && self.copied == self.place.end - self.place.start {
            account.counts.repeated += 1;
            account.tell_age(self.number);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::impairment::account::Cause;

    /// A heartbeat of a ground rover, 1/1, number 0.
    const FRAME: [u8; 21] = [0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB];
    const AT: Stamp<HostClock> = Stamp::ZERO;

    fn entry(unit: u64, bytes: Range<usize>, fate: Fate) -> LogEntry {
        LogEntry { unit, bytes, fate }
    }

    fn arrived(unit: u64, bytes: Range<usize>) -> LogEntry {
        entry(unit, bytes, Fate::Delivered { at: AT })
    }

    fn counts(ledger: &FrameLedger) -> FrameCounts {
        ledger.counts().next().unwrap().1
    }

    #[test]
    fn a_frame_counts_once_all_its_bytes_are_decided_whatever_units_they_came_in() {
        let mut ledger = FrameLedger::new();
        ledger.offer(AT, 0, &FRAME[..10]);
        ledger.follow(&[arrived(0, 0..10)]);
        let rest = [&FRAME[10..], &FRAME, &FRAME[..3]].concat();
        ledger.offer(AT, 1, &rest);
        assert_eq!(counts(&ledger).sent, 2);
        ledger.follow(&[arrived(1, 0..11)]);
        assert_eq!((counts(&ledger).whole, counts(&ledger).lost), (1, 0));
        ledger.follow(&[arrived(1, 11..35)]);
        ledger.offer(AT, 2, &FRAME[3..]);
        ledger.follow(&[arrived(2, 0..18)]);
        let expected = FrameCounts { sent: 3, whole: 3, ..FrameCounts::default() };
        assert_eq!(counts(&ledger), expected);
    }

    #[test]
    fn a_missing_byte_a_turned_bit_and_a_lost_unit_each_cost_a_frame() {
        let mut ledger = FrameLedger::new();
        for unit in 0..6 {
            ledger.offer(AT, unit, &FRAME);
        }
        ledger.follow(&[
            arrived(0, 0..21),
            entry(1, 5..6, Fate::Lost(Cause::Byte)),
            arrived(1, 0..5),
            arrived(1, 6..21),
            entry(2, 20..21, Fate::Flipped { bit: 3 }),
            arrived(2, 0..21),
            entry(3, 0..21, Fate::Lost(Cause::LinkDown)),
            arrived(4, 0..21),
            entry(5, 0..21, Fate::Lost(Cause::LinkDown)),
        ]);
        let expected = FrameCounts { sent: 6, whole: 2, lost: 4, missing_between: 3, ..FrameCounts::default() };
        assert_eq!(counts(&ledger), expected);
    }

    #[test]
    fn a_copy_is_not_a_second_frame() {
        let mut ledger = FrameLedger::new();
        ledger.offer(AT, 0, &FRAME);
        ledger.follow(&[arrived(0, 0..21), entry(0, 0..21, Fate::Repeated { at: AT })]);
        assert_eq!((counts(&ledger).whole, counts(&ledger).repeated), (1, 1));
    }

    #[test]
    fn a_frame_that_comes_more_than_half_a_circle_late_cannot_be_dated() {
        for (newer, expected) in [(128, 0), (129, 1)] {
            let mut ledger = FrameLedger::new();
            for unit in 0..=newer {
                ledger.offer(AT, unit, &FRAME);
            }
            ledger.follow(&[arrived(newer, 0..21), arrived(0, 0..21)]);
            assert_eq!(counts(&ledger).undatable, expected, "{newer} newer ones");
        }
    }

    #[test]
    fn what_is_decided_is_forgotten() {
        let mut ledger = FrameLedger::new();
        for unit in 0..5_000 {
            ledger.offer(AT, unit, &FRAME);
            ledger.follow(&[arrived(unit, 0..21)]);
        }
        assert_eq!(counts(&ledger).whole, 5_000);
        assert!(ledger.frames.len() <= KEPT && ledger.units.len() <= KEPT + 1);
        assert!(ledger.waiting.is_empty());
    }
}

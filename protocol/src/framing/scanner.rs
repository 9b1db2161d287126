//! The scanner: one per link and direction, fed with chunks and time.
//!
//! # Model
//! ```text
//!            settled          cursor            end of what has come
//!  ...frames...|...undecided...|...not yet looked at...|
//! ```
//! Everything before `settled` was handed out or counted as garbage. Between `settled` and `cursor` lie claims of unknown
//! frames ([`super::tentative`]). The scan stops at a start byte whose frame is not whole yet; those bytes wait in `tail`.
//! When nothing waits, the scan runs on the caller's slice and copies nothing.
//!
//! A candidate that fails costs one byte, never its claimed length: a real frame may begin inside it.
//!
//! A frame may stop in its middle for longer than the gap, where a link stalls between two reads. If whole frames hide behind its
//! beginning, the beginning was torn and is given up; a frame that stops behind them is kept. If none do, it costs nothing to keep it:
//! it is `overdue`, and what comes next, in however many pieces, completes it or brings frames behind it to light and so gives it up.

use posebridge_telemetry::{Defect, HostClock, Stamp};

use super::candidate::{Candidate, Header, judge};
use super::crc::checksum;
use super::tentative::{Claim, Claims};
use super::{Framing, START_V1, START_V2, ScanCounters, Scanned, ScannerConfig};
use crate::dialect::catalogue::{CATALOGUE, Catalogue, EVERYTHING};

/// Who is told what was found.
type Sink<'s> = dyn FnMut(Scanned<'_>) + 's;

/// Finds the frames in the bytes of one link.
///
/// # Examples
/// ```
/// use posebridge_protocol::framing::{Scanned, Scanner, ScannerConfig};
/// use posebridge_telemetry::Stamp;
///
/// // A heartbeat of a ground rover, 1/1.
/// let bytes = [
///     0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB,
/// ];
/// let mut scanner = Scanner::new(ScannerConfig::default());
/// let mut ids = Vec::new();
/// scanner.push(Stamp::ZERO, &bytes, &mut |found| {
///     if let Scanned::Frame(frame) = found {
///         ids.push(frame.message_id);
///     }
/// });
/// assert_eq!(ids, [0]);
/// ```
#[derive(Debug)]
pub struct Scanner {
    config: ScannerConfig,
    catalogue: &'static Catalogue,
    tail: Vec<u8>,
    progress: Progress,
    last_byte: Stamp<HostClock>,
    /// The gap has passed over what waits, and nothing hides behind it.
    is_overdue: bool,
    /// Over the candidates that begin before this offset of `tail` the gap has passed once: they may still be completed, but are given
    /// up when whole frames hide behind them.
    doubted: usize,
    counters: ScanCounters,
}

/// How far the bytes in `tail` were looked at.
#[derive(Clone, Debug, Default)]
struct Progress {
    cursor: usize,
    settled: usize,
    /// Where the last frame ends that was handed out of the buffer.
    frames_end: usize,
    claims: Claims,
}

/// Which candidates must not be waited for.
#[derive(Clone, Copy)]
enum Patience {
    /// Those that begin before this offset; 0 waits for all.
    NotBefore(usize),
    /// All: nothing more will come.
    Over,
}

impl Patience {
    const fn is_over_at(self, offset: usize) -> bool {
        match self {
            Self::NotBefore(limit) => offset < limit,
            Self::Over => true,
        }
    }
}

impl Scanner {
    /// A scanner that has heard nothing.
    #[must_use]
    pub fn new(config: ScannerConfig) -> Self {
        Self {
            config,
            catalogue: &CATALOGUE,
            tail: Vec::new(),
            progress: Progress::default(),
            last_byte: Stamp::ZERO,
            is_overdue: false,
            doubted: 0,
            counters: ScanCounters::default(),
        }
    }

    /// One that verifies the messages of foreign dialects as well: for looking at recordings. A live link passes them on unverified,
    /// because its peers may speak a newer version of theirs.
    #[must_use]
    pub fn of_every_dialect(config: ScannerConfig) -> Self {
        Self { catalogue: &EVERYTHING, ..Self::new(config) }
    }

    /// Takes one chunk, which arrived at `now`, and hands out what became certain by it, in the order of the bytes.
    ///
    /// A late continuation is still welcome: if it completes the waiting frame, the gap is forgiven.
    pub fn push(&mut self, now: Stamp<HostClock>, bytes: &[u8], sink: &mut Sink<'_>) {
        if bytes.is_empty() {
            return;
        }
        if !self.tail.is_empty() && now - self.last_byte >= self.config.gap {
            self.doubted = self.tail.len();
        }
        self.last_byte = now;
        if self.tail.is_empty() {
            let patience = self.patience(bytes);
            self.run(bytes, patience, sink);
            self.keep(&bytes[self.progress.settled..]);
        } else {
            let mut joined = std::mem::take(&mut self.tail);
            joined.extend_from_slice(bytes);
            let patience = self.patience(&joined);
            self.run(&joined, patience, sink);
            joined.drain(..self.progress.settled);
            self.tail = joined;
        }
        self.is_overdue = false;
        self.rebase();
    }

    /// When [`Scanner::tick`] has something to do if nothing more has come; `None` when nothing waits for the gap.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<HostClock>> {
        let waits = !self.tail.is_empty() && !self.is_overdue;
        waits.then(|| self.last_byte + self.config.gap)
    }

    /// The gap has passed since [`Scanner::deadline`] was set: hands out what hides behind a torn frame, or notes that a frame has
    /// stopped in its middle; does nothing before.
    pub fn tick(&mut self, now: Stamp<HostClock>, sink: &mut Sink<'_>) {
        if self.deadline().is_none_or(|deadline| now < deadline) {
            return;
        }
        let hidden = self.hidden(&self.tail, Patience::Over);
        if hidden == Some(self.tail.len()) {
            self.finish(sink);
            return;
        }
        if let Some(end) = hidden {
            let mut tail = std::mem::take(&mut self.tail);
            self.run(&tail, Patience::NotBefore(end), sink);
            tail.drain(..self.progress.settled);
            self.tail = tail;
            self.rebase();
            self.is_overdue = true;
            return;
        }
        self.is_overdue = true;
        let bytes = (self.tail.len() - self.progress.cursor) as u32;
        if bytes > 0 {
            self.counters.stalls += 1;
            sink(Scanned::Defect(Defect::Stall { bytes }));
        }
    }

    /// Nothing more will come: gives up what waits, so that every byte is in a frame or counted.
    pub fn finish(&mut self, sink: &mut Sink<'_>) {
        let tail = std::mem::take(&mut self.tail);
        self.run(&tail, Patience::Over, sink);
        self.progress = Progress::default();
        self.is_overdue = false;
        self.doubted = 0;
    }

    /// The line broke: hands out the whole frames that hide behind a torn one. What is left was neither sent badly nor stalled, so it is
    /// dropped without a word.
    pub fn break_off(&mut self, sink: &mut Sink<'_>) {
        if self.hidden(&self.tail, Patience::Over).is_some() {
            self.finish(sink);
        }
        self.tail.clear();
        self.progress = Progress::default();
        self.is_overdue = false;
        self.doubted = 0;
    }

    /// What this scanner has counted.
    #[must_use]
    pub const fn counters(&self) -> &ScanCounters {
        &self.counters
    }

    fn keep(&mut self, rest: &[u8]) {
        self.tail.extend_from_slice(rest);
    }

    fn rebase(&mut self) {
        let gone = self.progress.settled;
        self.progress.claims.rebase(gone);
        self.progress.cursor -= gone;
        self.progress.settled = 0;
        self.progress.frames_end = 0;
        self.doubted = self.doubted.saturating_sub(gone);
    }

    /// Which candidates need not be waited for in `buffer`, of which the last bytes have just come.
    fn patience(&self, buffer: &[u8]) -> Patience {
        match self.config.transport {
            Framing::Datagram => Patience::Over,
            Framing::Stream => {
                let without_doubted = Patience::NotBefore(self.doubted);
                if self.doubted > 0 && self.hidden(buffer, without_doubted).is_some() {
                    without_doubted
                } else {
                    Patience::NotBefore(0)
                }
            }
        }
    }

    /// Where the last of the frames ends that a run over `buffer` would bring to light; `None` if it would bring none.
    fn hidden(&self, buffer: &[u8], patience: Patience) -> Option<usize> {
        let mut progress = self.progress.clone();
        Pass {
            buffer,
            accept_v1: self.config.accept_v1,
            catalogue: self.catalogue,
            progress: &mut progress,
            counters: &mut self.counters.clone(),
            sink: &mut |_| {},
            has_stalled: true,
        }
        .run(patience);
        (progress.frames_end > 0).then_some(progress.frames_end)
    }

    fn run(&mut self, buffer: &[u8], patience: Patience, sink: &mut Sink<'_>) {
        Pass {
            buffer,
            accept_v1: self.config.accept_v1,
            catalogue: self.catalogue,
            progress: &mut self.progress,
            counters: &mut self.counters,
            sink,
            has_stalled: self.is_overdue,
        }
        .run(patience);
    }
}

/// One run over a buffer.
struct Pass<'p, 'b, 's> {
    buffer: &'b [u8],
    accept_v1: bool,
    catalogue: &'static Catalogue,
    progress: &'p mut Progress,
    counters: &'p mut ScanCounters,
    sink: &'p mut Sink<'s>,
    has_stalled: bool,
}

impl Pass<'_, '_, '_> {
    fn run(&mut self, patience: Patience) {
        while self.find_start() {
            let at = self.progress.cursor;
            let rest = &self.buffer[at..];
            match judge(rest, self.catalogue) {
                Candidate::Known { header, crc_extra } if header.total <= rest.len() => {
                    self.verify(&header, crc_extra);
                }
                Candidate::Known { .. } | Candidate::Incomplete => {
                    if !patience.is_over_at(at) {
                        break;
                    }
                    self.give_up();
                }
                Candidate::Unknown { header } => {
                    let end = at + header.total;
                    self.progress.claims.push(Claim { start: at, end });
                    self.progress.cursor += 1;
                }
                Candidate::Impossible { message_id, length } => {
                    self.counters.impossible_headers += 1;
                    (self.sink)(Scanned::Defect(Defect::ImpossibleHeader { message_id, length }));
                    self.progress.cursor += 1;
                }
            }
        }
        match patience {
            Patience::Over => self.settle_all(),
            Patience::NotBefore(_) => self.settle_decided(),
        }
    }

    /// Moves the cursor to the next start byte; to the end when there is none.
    #[inline]
    fn find_start(&mut self) -> bool {
        let rest = &self.buffer[self.progress.cursor..];
        // Most frames stand back to back: look before searching.
        if rest.first() == Some(&START_V2) {
            return true;
        }
        let skipped =
            if self.accept_v1 { memchr::memchr2(START_V2, START_V1, rest) } else { memchr::memchr(START_V2, rest) };
        self.progress.cursor += skipped.unwrap_or(rest.len());
        skipped.is_some()
    }

    #[inline]
    fn verify(&mut self, header: &Header, crc_extra: u8) {
        let at = self.progress.cursor;
        let raw = &self.buffer[at..at + header.total];
        let (covered, found) = header.covered(raw);
        let expected = checksum(covered, crc_extra);
        if found == expected {
            self.settle_to(at);
            self.counters.frames += 1;
            (self.sink)(Scanned::Frame(header.frame(raw)));
            self.progress.cursor += header.total;
            self.progress.settled = self.progress.cursor;
            self.progress.frames_end = self.progress.cursor;
        } else {
            self.counters.checksum_errors += 1;
            (self.sink)(Scanned::Defect(Defect::Checksum { message_id: header.message_id(), found, expected }));
            self.progress.cursor += 1;
        }
    }

    fn give_up(&mut self) {
        if !self.has_stalled {
            self.has_stalled = true;
            self.counters.stalls += 1;
            let bytes = (self.buffer.len() - self.progress.cursor) as u32;
            (self.sink)(Scanned::Defect(Defect::Stall { bytes }));
        }
        self.progress.cursor += 1;
    }

    /// Decides everything before `end`, where a verified frame begins or the bytes end.
    #[inline]
    fn settle_to(&mut self, end: usize) {
        if self.progress.settled == end {
            self.progress.claims.clear();
            return;
        }
        for claim in self.progress.claims.chain_to(end) {
            self.discard_to(claim.start);
            self.hand_out_unknown(claim);
        }
        self.discard_to(end);
        self.progress.claims.clear();
    }

    fn hand_out_unknown(&mut self, claim: Claim) {
        let raw = &self.buffer[claim.start..claim.end];
        if let Candidate::Unknown { header } = judge(raw, self.catalogue) {
            self.counters.unknown_ids += 1;
            (self.sink)(Scanned::Unknown(header.frame(raw)));
            self.progress.settled = claim.end;
            self.progress.frames_end = claim.end;
        }
    }

    fn settle_all(&mut self) {
        self.settle_to(self.buffer.len());
    }

    fn settle_decided(&mut self) {
        let claims = &mut self.progress.claims;
        if !claims.is_empty() {
            claims.prune(self.progress.cursor);
        }
        let undecided = claims.first_start().unwrap_or(self.progress.cursor);
        self.discard_to(undecided);
    }

    /// Counts everything from `settled` to `end` as garbage.
    fn discard_to(&mut self, end: usize) {
        let skipped = end - self.progress.settled;
        if skipped > 0 {
            self.counters.garbage_bytes += skipped as u64;
            (self.sink)(Scanned::Defect(Defect::Garbage { bytes: skipped as u32 }));
            self.progress.settled = end;
        }
    }
}

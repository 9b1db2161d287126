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

use posebridge_telemetry::{HostClock, ReceiveError, Timestamp};

use super::candidate::{FrameCandidate, FrameHeader, classify};
use super::checksum::checksum;
use super::unknown_spans::{UnknownSpan, UnknownSpans};
use super::{FramerConfig, FramerCounters, FramerOutput, START_BYTE_V1, START_BYTE_V2, TransportKind};
use crate::dialect::catalogue::{CATALOGUE, FULL_CATALOGUE, MessageCatalogue};

/// Who is told what was found.
type FramerSink<'s> = dyn FnMut(FramerOutput<'_>) + 's;

/// Finds the frames in the bytes of one link.
///
/// # Examples
/// ```
/// use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput};
/// use posebridge_telemetry::Timestamp;
///
/// // A heartbeat of a ground rover, 1/1.
/// let bytes = [
///     0xFD, 9, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 10, 0, 0, 4, 3, 0xDE, 0xEB,
/// ];
/// let mut framer = Framer::new(FramerConfig::default());
/// let mut ids = Vec::new();
/// framer.push(Timestamp::ZERO, &bytes, &mut |found| {
///     if let FramerOutput::Frame(frame) = found {
///         ids.push(frame.message_id);
///     }
/// });
/// assert_eq!(ids, [0]);
/// ```
#[derive(Debug)]
pub struct Framer {
    config: FramerConfig,
    catalogue: &'static MessageCatalogue,
    pending: Vec<u8>,
    progress: ScanProgress,
    last_byte: Timestamp<HostClock>,
    /// The gap has passed over what waits, and nothing hides behind it.
    is_overdue: bool,
    /// Over the candidates that begin before this offset of `tail` the gap has passed once: they may still be completed, but are given
    /// up when whole frames hide behind them.
    doubtful_end: usize,
    counters: FramerCounters,
}

/// How far the bytes in `tail` were looked at.
#[derive(Clone, Debug, Default)]
struct ScanProgress {
    cursor: usize,
    decided: usize,
    /// Where the last frame ends that was handed out of the buffer.
    frames_end: usize,
    unknown_spans: UnknownSpans,
}

/// Which candidates must not be waited for.
#[derive(Clone, Copy)]
enum WaitPolicy {
    /// Those that begin before this offset; 0 waits for all.
    WaitFrom(usize),
    /// All: nothing more will come.
    GiveUp,
}

impl WaitPolicy {
    const fn has_expired_at(self, offset: usize) -> bool {
        match self {
            Self::WaitFrom(limit) => offset < limit,
            Self::GiveUp => true,
        }
    }
}

impl Framer {
    /// A scanner that has heard nothing.
    #[must_use]
    pub fn new(config: FramerConfig) -> Self {
        Self {
            config,
            catalogue: &CATALOGUE,
            pending: Vec::new(),
            progress: ScanProgress::default(),
            last_byte: Timestamp::ZERO,
            is_overdue: false,
            doubtful_end: 0,
            counters: FramerCounters::default(),
        }
    }

    /// One that verifies the messages of foreign dialects as well: for looking at recordings. A live link passes them on unverified,
    /// because its peers may speak a newer version of theirs.
    #[must_use]
    pub fn with_all_dialects(config: FramerConfig) -> Self {
        Self { catalogue: &FULL_CATALOGUE, ..Self::new(config) }
    }

    /// Takes one chunk, which arrived at `now`, and hands out what became certain by it, in the order of the bytes.
    ///
    /// A late continuation is still welcome: if it completes the waiting frame, the gap is forgiven.
    pub fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: &mut FramerSink<'_>) {
        if bytes.is_empty() {
            return;
        }
        if !self.pending.is_empty() && now - self.last_byte >= self.config.gap {
            self.doubtful_end = self.pending.len();
        }
        self.last_byte = now;
        if self.pending.is_empty() {
            let patience = self.wait_policy(bytes);
            self.run(bytes, patience, sink);
            self.keep_pending(&bytes[self.progress.decided..]);
        } else {
            let mut joined = std::mem::take(&mut self.pending);
            joined.extend_from_slice(bytes);
            let patience = self.wait_policy(&joined);
            self.run(&joined, patience, sink);
            joined.drain(..self.progress.decided);
            self.pending = joined;
        }
        self.is_overdue = false;
        self.drop_decided();
    }

    /// When [`Framer::tick`] has something to do if nothing more has come; `None` when nothing waits for the gap.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let waits = !self.pending.is_empty() && !self.is_overdue;
        waits.then(|| self.last_byte + self.config.gap)
    }

    /// The gap has passed since [`Framer::deadline`] was set: hands out what hides behind a torn frame, or notes that a frame has
    /// stopped in its middle; does nothing before.
    pub fn tick(&mut self, now: Timestamp<HostClock>, sink: &mut FramerSink<'_>) {
        if self.deadline().is_none_or(|deadline| now < deadline) {
            return;
        }
        let hidden = self.end_of_hidden_frames(&self.pending, WaitPolicy::GiveUp);
        if hidden == Some(self.pending.len()) {
            self.finish(sink);
            return;
        }
        if let Some(end) = hidden {
            let mut tail = std::mem::take(&mut self.pending);
            self.run(&tail, WaitPolicy::WaitFrom(end), sink);
            tail.drain(..self.progress.decided);
            self.pending = tail;
            self.drop_decided();
            self.is_overdue = true;
            return;
        }
        self.is_overdue = true;
        let bytes = (self.pending.len() - self.progress.cursor) as u32;
        if bytes > 0 {
            self.counters.stalls += 1;
            sink(FramerOutput::Error(ReceiveError::Timeout { bytes }));
        }
    }

    /// Nothing more will come: gives up what waits, so that every byte is in a frame or counted.
    pub fn finish(&mut self, sink: &mut FramerSink<'_>) {
        let tail = std::mem::take(&mut self.pending);
        self.run(&tail, WaitPolicy::GiveUp, sink);
        self.progress = ScanProgress::default();
        self.is_overdue = false;
        self.doubtful_end = 0;
    }

    /// The line broke: hands out the whole frames that hide behind a torn one. What is left was neither sent badly nor stalled, so it is
    /// dropped without a word.
    pub fn handle_link_loss(&mut self, sink: &mut FramerSink<'_>) {
        if self.end_of_hidden_frames(&self.pending, WaitPolicy::GiveUp).is_some() {
            self.finish(sink);
        }
        self.pending.clear();
        self.progress = ScanProgress::default();
        self.is_overdue = false;
        self.doubtful_end = 0;
    }

    /// What this scanner has counted.
    #[must_use]
    pub const fn counters(&self) -> &FramerCounters {
        &self.counters
    }

    fn keep_pending(&mut self, rest: &[u8]) {
        self.pending.extend_from_slice(rest);
    }

    fn drop_decided(&mut self) {
        let gone = self.progress.decided;
        self.progress.unknown_spans.shift(gone);
        self.progress.cursor -= gone;
        self.progress.decided = 0;
        self.progress.frames_end = 0;
        self.doubtful_end = self.doubtful_end.saturating_sub(gone);
    }

    /// Which candidates need not be waited for in `buffer`, of which the last bytes have just come.
    fn wait_policy(&self, buffer: &[u8]) -> WaitPolicy {
        match self.config.transport {
            TransportKind::Datagram => WaitPolicy::GiveUp,
            TransportKind::Stream => {
                let without_doubted = WaitPolicy::WaitFrom(self.doubtful_end);
                if self.doubtful_end > 0 && self.end_of_hidden_frames(buffer, without_doubted).is_some() {
                    without_doubted
                } else {
                    WaitPolicy::WaitFrom(0)
                }
            }
        }
    }

    /// Where the last of the frames ends that a run over `buffer` would bring to light; `None` if it would bring none.
    fn end_of_hidden_frames(&self, buffer: &[u8], patience: WaitPolicy) -> Option<usize> {
        let mut progress = self.progress.clone();
        ScanPass {
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

    fn run(&mut self, buffer: &[u8], patience: WaitPolicy, sink: &mut FramerSink<'_>) {
        ScanPass {
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
struct ScanPass<'p, 'b, 's> {
    buffer: &'b [u8],
    accept_v1: bool,
    catalogue: &'static MessageCatalogue,
    progress: &'p mut ScanProgress,
    counters: &'p mut FramerCounters,
    sink: &'p mut FramerSink<'s>,
    has_stalled: bool,
}

impl ScanPass<'_, '_, '_> {
    fn run(&mut self, patience: WaitPolicy) {
        while self.find_start() {
            let at = self.progress.cursor;
            let rest = &self.buffer[at..];
            match classify(rest, self.catalogue) {
                FrameCandidate::Supported { header, crc_extra } if header.total <= rest.len() => {
                    self.verify(&header, crc_extra);
                }
                FrameCandidate::Supported { .. } | FrameCandidate::Incomplete => {
                    if !patience.has_expired_at(at) {
                        break;
                    }
                    self.give_up();
                }
                FrameCandidate::Unknown { header } => {
                    let end = at + header.total;
                    self.progress.unknown_spans.push(UnknownSpan { start: at, end });
                    self.progress.cursor += 1;
                }
                FrameCandidate::Impossible { message_id, length } => {
                    self.counters.impossible_headers += 1;
                    (self.sink)(FramerOutput::Error(ReceiveError::ImpossibleHeader { message_id, length }));
                    self.progress.cursor += 1;
                }
            }
        }
        match patience {
            WaitPolicy::GiveUp => self.decide_all(),
            WaitPolicy::WaitFrom(_) => self.advance_decided(),
        }
    }

    /// Moves the cursor to the next start byte; to the end when there is none.
    #[inline]
    fn find_start(&mut self) -> bool {
        let rest = &self.buffer[self.progress.cursor..];
        // Most frames stand back to back: look before searching.
        if rest.first() == Some(&START_BYTE_V2) {
            return true;
        }
        let skipped = if self.accept_v1 {
            memchr::memchr2(START_BYTE_V2, START_BYTE_V1, rest)
        } else {
            memchr::memchr(START_BYTE_V2, rest)
        };
        self.progress.cursor += skipped.unwrap_or(rest.len());
        skipped.is_some()
    }

    #[inline]
    fn verify(&mut self, header: &FrameHeader, crc_extra: u8) {
        let at = self.progress.cursor;
        let raw = &self.buffer[at..at + header.total];
        let (covered, found) = header.covered(raw);
        let expected = checksum(covered, crc_extra);
        if found == expected {
            self.decide_to(at);
            self.counters.frames += 1;
            (self.sink)(FramerOutput::Frame(header.frame(raw)));
            self.progress.cursor += header.total;
            self.progress.decided = self.progress.cursor;
            self.progress.frames_end = self.progress.cursor;
        } else {
            self.counters.checksum_errors += 1;
            (self.sink)(FramerOutput::Error(ReceiveError::Checksum {
                message_id: header.message_id(),
                found,
                expected,
            }));
            self.progress.cursor += 1;
        }
    }

    fn give_up(&mut self) {
        if !self.has_stalled {
            self.has_stalled = true;
            self.counters.stalls += 1;
            let bytes = (self.buffer.len() - self.progress.cursor) as u32;
            (self.sink)(FramerOutput::Error(ReceiveError::Timeout { bytes }));
        }
        self.progress.cursor += 1;
    }

    /// Decides everything before `end`, where a verified frame begins or the bytes end.
    #[inline]
    fn decide_to(&mut self, end: usize) {
        if self.progress.decided == end {
            self.progress.unknown_spans.clear();
            return;
        }
        for claim in self.progress.unknown_spans.chain_to(end) {
            self.discard_to(claim.start);
            self.emit_unknown(claim);
        }
        self.discard_to(end);
        self.progress.unknown_spans.clear();
    }

    fn emit_unknown(&mut self, claim: UnknownSpan) {
        let raw = &self.buffer[claim.start..claim.end];
        if let FrameCandidate::Unknown { header } = classify(raw, self.catalogue) {
            self.counters.unknown_ids += 1;
            (self.sink)(FramerOutput::UnknownFrame(header.frame(raw)));
            self.progress.decided = claim.end;
            self.progress.frames_end = claim.end;
        }
    }

    fn decide_all(&mut self) {
        self.decide_to(self.buffer.len());
    }

    fn advance_decided(&mut self) {
        let claims = &mut self.progress.unknown_spans;
        if !claims.is_empty() {
            claims.prune(self.progress.cursor);
        }
        let undecided = claims.first_start().unwrap_or(self.progress.cursor);
        self.discard_to(undecided);
    }

    /// Counts everything from `settled` to `end` as garbage.
    fn discard_to(&mut self, end: usize) {
        let skipped = end - self.progress.decided;
        if skipped > 0 {
            self.counters.garbage_bytes += skipped as u64;
            (self.sink)(FramerOutput::Error(ReceiveError::UnframedBytes { bytes: skipped as u32 }));
            self.progress.decided = end;
        }
    }
}

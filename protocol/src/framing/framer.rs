//! The framer: finds MAVLink frames in the bytes of one link and direction, which arrive in chunks with their times.
//!
//! Everything before `decided` was emitted as frames or counted as garbage. Between `decided` and `cursor` lie claims of
//! unknown frames ([`UnknownSpans`]). The search stops at a start byte whose frame is not complete yet; these bytes stay in
//! `pending`. A candidate that fails costs one byte, never its claimed length: a real frame may begin inside it.
//!
//! When the gap has passed and complete frames follow an incomplete one, that one is dropped. When none follows, it is kept
//! and marked as overdue: the next bytes complete it, or they contain frames and it is dropped then.

use posebridge_telemetry::{HostClock, ReceiveError, Timestamp};

use super::candidate::{FrameCandidate, FrameHeader, UnknownSpan, UnknownSpans, classify};
use super::checksum::checksum;
use super::{FramerConfig, FramerCounters, FramerOutput, START_BYTE_V1, START_BYTE_V2, TransportKind};
use crate::dialect::definitions::MessageLayout;

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
    pending: Vec<u8>,
    progress: ScanProgress,
    last_byte: Timestamp<HostClock>,
    /// The gap has passed while bytes were pending, and no complete frame follows them.
    is_overdue: bool,
    /// The gap has passed once for candidates before this offset of `pending`: they may still be completed, but are dropped when
    /// complete frames follow them.
    overdue_end: usize,
    counters: FramerCounters,
}

#[derive(Clone, Debug, Default)]
struct ScanProgress {
    cursor: usize,
    decided: usize,
    frames_end: usize,
    unknown_spans: UnknownSpans,
}

/// Which incomplete candidates to wait for.
#[derive(Clone, Copy)]
enum WaitPolicy {
    /// Only those that begin at or after this offset; 0 waits for all.
    WaitFrom(usize),
    /// None: no more bytes will come.
    Never,
}

impl WaitPolicy {
    const fn has_expired_at(self, offset: usize) -> bool {
        match self {
            Self::WaitFrom(limit) => offset < limit,
            Self::Never => true,
        }
    }
}

impl Framer {
    pub fn new(config: FramerConfig) -> Self {
        Self {
            config,
            pending: Vec::new(),
            progress: ScanProgress::default(),
            last_byte: Timestamp::ZERO,
            is_overdue: false,
            overdue_end: 0,
            counters: FramerCounters::default(),
        }
    }

    /// Takes one chunk, which arrived at `now`, and emits what it completes, in the order of the bytes.
    ///
    /// A late chunk may still complete the pending frame; then the gap does not count.
    pub fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8], sink: &mut FramerSink<'_>) {
        if bytes.is_empty() {
            return;
        }
        if !self.pending.is_empty() && now - self.last_byte >= self.config.gap {
            self.overdue_end = self.pending.len();
        }
        self.last_byte = now;
        if self.pending.is_empty() {
            let wait_policy = self.wait_policy(bytes);
            self.run(bytes, wait_policy, sink);
            self.pending.extend_from_slice(&bytes[self.progress.decided..]);
        } else {
            let mut joined = std::mem::take(&mut self.pending);
            joined.extend_from_slice(bytes);
            let wait_policy = self.wait_policy(&joined);
            self.run(&joined, wait_policy, sink);
            joined.drain(..self.progress.decided);
            self.pending = joined;
        }
        self.is_overdue = false;
        self.drop_decided();
    }

    /// When [`Framer::tick`] must be called if no more bytes come; `None` when nothing waits for the gap.
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let waits = !self.pending.is_empty() && !self.is_overdue;
        waits.then(|| self.last_byte + self.config.gap)
    }

    /// Handles the end of the gap: emits the complete frames that follow an incomplete one, or reports that a frame is interrupted.
    /// Does nothing before [`Framer::deadline`].
    pub fn tick(&mut self, now: Timestamp<HostClock>, sink: &mut FramerSink<'_>) {
        if self.deadline().is_none_or(|deadline| now < deadline) {
            return;
        }
        let hidden = self.end_of_hidden_frames(&self.pending, WaitPolicy::Never);
        if hidden == Some(self.pending.len()) {
            self.finish(sink);
            return;
        }
        if let Some(end) = hidden {
            let mut buffer = std::mem::take(&mut self.pending);
            self.run(&buffer, WaitPolicy::WaitFrom(end), sink);
            buffer.drain(..self.progress.decided);
            self.pending = buffer;
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

    /// Ends the stream: drops the pending bytes, so that every byte is in a frame or counted.
    pub fn finish(&mut self, sink: &mut FramerSink<'_>) {
        let buffer = std::mem::take(&mut self.pending);
        self.run(&buffer, WaitPolicy::Never, sink);
        self.forget_pending();
    }

    /// Handles a loss of the link: emits the complete frames that follow an incomplete one. The remaining bytes were neither damaged
    /// nor late, so they are dropped without an error.
    pub fn handle_link_loss(&mut self, sink: &mut FramerSink<'_>) {
        if self.end_of_hidden_frames(&self.pending, WaitPolicy::Never).is_some() {
            self.finish(sink);
        }
        self.forget_pending();
    }

    fn forget_pending(&mut self) {
        self.pending.clear();
        self.progress = ScanProgress::default();
        self.is_overdue = false;
        self.overdue_end = 0;
    }

    pub const fn counters(&self) -> &FramerCounters {
        &self.counters
    }

    fn drop_decided(&mut self) {
        let decided = self.progress.decided;
        self.progress.unknown_spans.shift(decided);
        self.progress.cursor -= decided;
        self.progress.decided = 0;
        self.progress.frames_end = 0;
        self.overdue_end = self.overdue_end.saturating_sub(decided);
    }

    fn wait_policy(&self, buffer: &[u8]) -> WaitPolicy {
        match self.config.transport {
            TransportKind::Datagram => WaitPolicy::Never,
            TransportKind::Stream => {
                let skip_overdue = WaitPolicy::WaitFrom(self.overdue_end);
                if self.overdue_end > 0 && self.end_of_hidden_frames(buffer, skip_overdue).is_some() {
                    skip_overdue
                } else {
                    WaitPolicy::WaitFrom(0)
                }
            }
        }
    }

    /// The end of the last frame that a pass over `buffer` would emit; `None` if it would emit none.
    fn end_of_hidden_frames(&self, buffer: &[u8], wait_policy: WaitPolicy) -> Option<usize> {
        let mut progress = self.progress.clone();
        ScanPass {
            buffer,
            accept_v1: self.config.accept_v1,
            progress: &mut progress,
            counters: &mut self.counters.clone(),
            sink: &mut |_| {},
            has_stalled: true,
        }
        .run(wait_policy);
        (progress.frames_end > 0).then_some(progress.frames_end)
    }

    fn run(&mut self, buffer: &[u8], wait_policy: WaitPolicy, sink: &mut FramerSink<'_>) {
        ScanPass {
            buffer,
            accept_v1: self.config.accept_v1,
            progress: &mut self.progress,
            counters: &mut self.counters,
            sink,
            has_stalled: self.is_overdue,
        }
        .run(wait_policy);
    }
}

struct ScanPass<'p, 'b, 's> {
    buffer: &'b [u8],
    accept_v1: bool,
    progress: &'p mut ScanProgress,
    counters: &'p mut FramerCounters,
    sink: &'p mut FramerSink<'s>,
    has_stalled: bool,
}

impl ScanPass<'_, '_, '_> {
    fn run(&mut self, wait_policy: WaitPolicy) {
        while self.find_start() {
            let at = self.progress.cursor;
            let rest = &self.buffer[at..];
            match classify(rest) {
                FrameCandidate::Supported { header, layout } if header.total <= rest.len() => {
                    self.verify(&header, layout);
                }
                FrameCandidate::Supported { .. } | FrameCandidate::Incomplete => {
                    if !wait_policy.has_expired_at(at) {
                        break;
                    }
                    self.skip_incomplete();
                }
                FrameCandidate::Unknown { header } => self.claim_unknown(&header),
                FrameCandidate::Impossible { message_id, length } => {
                    self.counters.impossible_headers += 1;
                    (self.sink)(FramerOutput::Error(ReceiveError::ImpossibleHeader { message_id, length }));
                    self.progress.cursor += 1;
                }
            }
        }
        match wait_policy {
            WaitPolicy::Never => self.decide_to(self.buffer.len()),
            WaitPolicy::WaitFrom(_) => self.advance_decided(),
        }
    }

    #[inline]
    fn find_start(&mut self) -> bool {
        let rest = &self.buffer[self.progress.cursor..];
        // Most frames follow each other directly: check this byte before searching.
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
    fn verify(&mut self, header: &FrameHeader, layout: MessageLayout) {
        let at = self.progress.cursor;
        let raw = &self.buffer[at..at + header.total];
        let (covered, found) = header.covered(raw);
        let expected = checksum(covered, layout.crc_extra);
        if found == expected {
            self.decide_to(at);
            self.counters.frames += 1;
            self.counters.foreign_frames += u64::from(layout.is_foreign);
            (self.sink)(FramerOutput::Frame(header.frame(raw)));
            self.progress.cursor += header.total;
            self.progress.decided = self.progress.cursor;
            self.progress.frames_end = self.progress.cursor;
        } else if layout.is_foreign {
            // Another version of its dialect has another seed.
            self.claim_unknown(header);
        } else {
            self.counters.checksum_errors += 1;
            (self.sink)(FramerOutput::Error(ReceiveError::Checksum { message_id: header.message_id, found, expected }));
            self.progress.cursor += 1;
        }
    }

    fn claim_unknown(&mut self, header: &FrameHeader) {
        let start = self.progress.cursor;
        self.progress.unknown_spans.push(UnknownSpan { start, end: start + header.total });
        self.progress.cursor += 1;
    }

    fn skip_incomplete(&mut self) {
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
        for span in self.progress.unknown_spans.chain_to(end) {
            self.discard_to(span.start);
            self.emit_unknown(span);
        }
        self.discard_to(end);
        self.progress.unknown_spans.clear();
    }

    fn emit_unknown(&mut self, span: UnknownSpan) {
        let raw = &self.buffer[span.start..span.end];
        if let Some(header) = FrameHeader::parse(raw) {
            self.counters.unknown_ids += 1;
            (self.sink)(FramerOutput::UnknownFrame(header.frame(raw)));
            self.progress.decided = span.end;
            self.progress.frames_end = span.end;
        }
    }

    fn advance_decided(&mut self) {
        let spans = &mut self.progress.unknown_spans;
        if !spans.is_empty() {
            spans.prune(self.progress.cursor);
        }
        let undecided = spans.first_start().unwrap_or(self.progress.cursor);
        self.discard_to(undecided);
    }

    /// Counts everything from `decided` to `end` as garbage.
    fn discard_to(&mut self, end: usize) {
        let skipped = end - self.progress.decided;
        if skipped > 0 {
            self.counters.garbage_bytes += skipped as u64;
            (self.sink)(FramerOutput::Error(ReceiveError::UnframedBytes { bytes: skipped as u32 }));
            self.progress.decided = end;
        }
    }
}

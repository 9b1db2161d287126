//! Statistics of a recording or a link: by sender, by message, in time; the results of `posebridge inspect`.
//!
//! ```text
//! rate    = (frames - 1) / (last - first)         the frames of a burst have no rate
//! drift   = (change of stamp) / (change of arrival) - 1,  between the first and the last stamp that were decoded
//! ```
//! The link delays the first and the last timestamped message about alike: over ten seconds 10 ms of difference are 1000 ppm.

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, HostClock, LinkId, TimeDelta, Timestamp};

use crate::dialect;
use crate::framing::{FrameRef, SequenceCounter, WireVersion};

/// Shortest silence of all senders that is reported: it normally contains several heartbeats.
pub const MIN_GAP: TimeDelta = TimeDelta::from_millis(1_000);
/// Most gaps that are kept; the others are only counted.
const MAX_GAPS: usize = 100;
/// Most distinguished senders; the frames of others are counted together. A flood of invented addresses must not fill
/// the memory, and no fleet on one link is larger.
const MAX_SOURCES: usize = 4_096;
/// One of this number of frames of a sender is decoded for its stamp: decoding all would take longer than everything
/// else.
const STAMP_SAMPLE_PERIOD: u64 = 16;
/// A larger fall of a stamp is a clock restart, and not a message that was overtaken.
const RESTART_THRESHOLD_S: f64 = 1.0;
/// Over a shorter time a drift is dominated by the link, s.
const MIN_DRIFT_BASELINE_S: f64 = 10.0;

/// Counters of a set of frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MessageStatistics {
    pub frames: u64,
    /// Start byte to checksum or signature.
    pub bytes: u64,
    pub first: Option<Timestamp<HostClock>>,
    pub last: Option<Timestamp<HostClock>>,
    pub longest_silence: TimeDelta,
}

impl MessageStatistics {
    fn record(&mut self, bytes: usize, at: Option<Timestamp<HostClock>>) {
        self.frames += 1;
        self.bytes += bytes as u64;
        if let Some(at) = at {
            if let Some(last) = self.last {
                self.longest_silence = self.longest_silence.max(at - last);
            }
            self.first = self.first.or(Some(at));
            self.last = Some(at);
        }
    }

    /// The sum of two senders' counters; the silence is the longer of the two.
    pub fn merged(self, other: &Self) -> Self {
        Self {
            frames: self.frames + other.frames,
            bytes: self.bytes + other.bytes,
            first: [self.first, other.first].into_iter().flatten().min(),
            last: self.last.max(other.last),
            longest_silence: self.longest_silence.max(other.longest_silence),
        }
    }

    /// Frames per second; `None` for fewer than two frames, or without times.
    pub fn rate_hz(&self) -> Option<f64> {
        let elapsed_s = (self.last? - self.first?).as_secs_f64();
        (self.frames > 1 && elapsed_s > 0.0).then(|| (self.frames - 1) as f64 / elapsed_s)
    }
}

/// A sender's clock by the stamps of one message, the first with stamps that it sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SenderClockStatistics {
    pub message_id: u32,
    pub restarts: u64,
    /// Stamp and arrival, s, after the last restart.
    first: (f64, f64),
    last: (f64, f64),
}

impl SenderClockStatistics {
    fn record(&mut self, stamp_s: f64, at_s: f64) {
        if self.last.0 - stamp_s > RESTART_THRESHOLD_S {
            self.restarts += 1;
            self.first = (stamp_s, at_s);
        }
        self.last = (stamp_s, at_s);
    }

    /// Rate of the sender's clock against that of the arrivals, minus one; `None` over too short a time.
    pub fn drift_ppm(&self) -> Option<f64> {
        let elapsed_s = self.last.1 - self.first.1;
        (elapsed_s >= MIN_DRIFT_BASELINE_S).then(|| 1e6 * ((self.last.0 - self.first.0) / elapsed_s - 1.0))
    }

    /// The sender's clock at the last stamp minus that of the arrivals.
    pub fn offset_s(&self) -> f64 {
        self.last.0 - self.last.1
    }
}

/// One sender on one link.
#[derive(Clone, Debug)]
pub struct SenderStatistics {
    pub link: LinkId,
    pub address: Address,
    pub total: MessageStatistics,
    pub messages: BTreeMap<u32, MessageStatistics>,
    /// Missing frames by its sequence numbers, if all were of one link.
    lost: u64,
    /// The same with every step of the numbers counted as a loss, as simple counters do; meaningless for a sender that
    /// does not count by one.
    pub sequence_steps: u64,
    /// `None` without stamps or arrival times.
    pub clock: Option<SenderClockStatistics>,
    last_sequence: u8,
    numbers: SequenceCounter,
    /// The only link of a log with this sender.
    only_link: Option<usize>,
    /// Once the sender was seen on a second link.
    by_link: Option<Box<LinkLossCounter>>,
}

/// A sender's sequence numbers by link of a log.
#[derive(Clone, Debug, Default)]
struct LinkLossCounter {
    lost: u64,
    numbers: [SequenceCounter; MAX_LOG_LINKS],
}

/// Number of links that a log can distinguish: two bits. A sender counts on each link separately.
pub const MAX_LOG_LINKS: usize = 4;

/// A time without frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrafficGap {
    /// When the last frame before it arrived.
    pub from: Timestamp<HostClock>,
    pub length: TimeDelta,
}

/// Counts frames by sender, by message and in time.
#[derive(Clone, Debug, Default)]
pub struct TrafficStatistics {
    sources: Vec<SenderStatistics>,
    all: MessageStatistics,
    versions: [u64; 2],
    signed: u64,
    untracked: u64,
    gaps: Vec<TrafficGap>,
    gap_count: u64,
    backwards: u64,
    latest: usize,
}

impl TrafficStatistics {
    pub fn new() -> Self {
        Self::default()
    }

    /// Counts a frame of a log in which `number` may or may not distinguish links. The losses are those of the
    /// interpretation with fewer: a meaningless number splits a sequence, and links that are not distinguished mix
    /// several.
    pub fn record_logged(&mut self, number: usize, frame: &FrameRef<'_>, at: Timestamp<HostClock>) {
        if let Some(source) = self.count_frame(LinkId(0), frame, Some(at)) {
            source.follow_by_link(number, frame.sequence);
            source.record(frame, Some(at));
        }
    }

    /// `at` is when the frame was received or sent.
    pub fn record(&mut self, link: LinkId, frame: &FrameRef<'_>, at: Option<Timestamp<HostClock>>) {
        if let Some(source) = self.count_frame(link, frame, at) {
            source.record(frame, at);
        }
    }

    /// Counts a frame and returns its sender; `None` beyond the limit of senders.
    fn count_frame(
        &mut self,
        link: LinkId,
        frame: &FrameRef<'_>,
        at: Option<Timestamp<HostClock>>,
    ) -> Option<&mut SenderStatistics> {
        self.record_time(at);
        self.all.record(frame.raw.len(), at);
        match frame.version {
            WireVersion::V1 => self.versions[0] += 1,
            WireVersion::V2 => self.versions[1] += 1,
        }
        self.signed += u64::from(frame.is_signed());
        let index = self.source_index(link, frame);
        self.untracked += u64::from(index.is_none());
        self.sources.get_mut(index?)
    }

    /// In the order of their first frames.
    pub fn sources(&self) -> &[SenderStatistics] {
        &self.sources
    }

    /// By message id, over all senders.
    pub fn messages(&self) -> BTreeMap<u32, MessageStatistics> {
        let mut messages: BTreeMap<u32, MessageStatistics> = BTreeMap::new();
        for (id, tally) in self.sources.iter().flat_map(|source| &source.messages) {
            let sum = messages.entry(*id).or_default();
            *sum = sum.merged(tally);
        }
        messages
    }

    /// Over all senders.
    pub const fn all(&self) -> &MessageStatistics {
        &self.all
    }

    pub const fn frames_of_version(&self, version: WireVersion) -> u64 {
        let [v1, v2] = self.versions;
        match version {
            WireVersion::V1 => v1,
            WireVersion::V2 => v2,
        }
    }

    /// Frames with a signature, valid or not.
    pub const fn signed(&self) -> u64 {
        self.signed
    }

    /// Frames of senders beyond the limit.
    pub const fn untracked_frames(&self) -> u64 {
        self.untracked
    }

    /// The first silences of [`MIN_GAP`] or more, and the number of all.
    pub fn gaps(&self) -> (&[TrafficGap], u64) {
        (&self.gaps, self.gap_count)
    }

    /// How often a frame's time is earlier than that of the previous one.
    pub const fn time_reversals(&self) -> u64 {
        self.backwards
    }

    fn record_time(&mut self, at: Option<Timestamp<HostClock>>) {
        let (Some(at), Some(last)) = (at, self.all.last) else {
            return;
        };
        self.backwards += u64::from(at < last);
        let length = at - last;
        if length >= MIN_GAP {
            self.gap_count += 1;
            if self.gaps.len() < MAX_GAPS {
                self.gaps.push(TrafficGap { from: last, length });
            }
        }
    }

    /// The index of a sender; `None` beyond the limit.
    fn source_index(&mut self, link: LinkId, frame: &FrameRef<'_>) -> Option<usize> {
        let is_it = |source: &SenderStatistics| source.address == frame.source && source.link == link;
        // Most frames follow one of the same sender.
        if self.sources.get(self.latest).is_some_and(is_it) {
            return Some(self.latest);
        }
        if let Some(index) = self.sources.iter().position(is_it) {
            self.latest = index;
            return Some(index);
        }
        if self.sources.len() == MAX_SOURCES {
            return None;
        }
        self.latest = self.sources.len();
        self.sources.push(SenderStatistics {
            link,
            address: frame.source,
            total: MessageStatistics::default(),
            messages: BTreeMap::new(),
            lost: 0,
            sequence_steps: 0,
            clock: None,
            last_sequence: frame.sequence.wrapping_sub(1),
            numbers: SequenceCounter::default(),
            only_link: None,
            by_link: None,
        });
        Some(self.latest)
    }
}

impl SenderStatistics {
    /// Missing frames by its sequence numbers; up to half the circle is a loss, more is an old frame.
    pub fn lost(&self) -> u64 {
        let by_link = self.by_link.as_ref().map(|by_link| by_link.lost);
        self.lost.min(by_link.unwrap_or(u64::MAX))
    }

    /// Counts the number in the sequence of this link. With one link that is the normal counter.
    fn follow_by_link(&mut self, link: usize, sequence: u8) {
        let only = *self.only_link.get_or_insert(link);
        if only == link && self.by_link.is_none() {
            return;
        }
        let by_link = self.by_link.get_or_insert_with(|| {
            let mut by_link = Box::<LinkLossCounter>::default();
            by_link.lost = self.lost;
            if let Some(numbers) = by_link.numbers.get_mut(only) {
                numbers.clone_from(&self.numbers);
            }
            by_link
        });
        if let Some(numbers) = by_link.numbers.get_mut(link) {
            by_link.lost += u64::from(numbers.record_number(sequence));
        }
    }

    fn record(&mut self, frame: &FrameRef<'_>, at: Option<Timestamp<HostClock>>) {
        let step = frame.sequence.wrapping_sub(self.last_sequence).wrapping_sub(1);
        self.sequence_steps += u64::from(step);
        self.last_sequence = frame.sequence;
        self.lost += u64::from(self.numbers.record_number(frame.sequence));
        if let Some(at) = at
            && self.total.frames.is_multiple_of(STAMP_SAMPLE_PERIOD)
        {
            self.record_timestamp(frame, at);
        }
        let bytes = frame.raw.len();
        self.total.record(bytes, at);
        self.messages.entry(frame.message_id).or_default().record(bytes, at);
    }

    fn record_timestamp(&mut self, frame: &FrameRef<'_>, at: Timestamp<HostClock>) {
        let is_other = |clock: SenderClockStatistics| clock.message_id != frame.message_id;
        if self.clock.is_some_and(is_other) {
            return;
        }
        let Some(stamp) = dialect::timestamp_of(frame) else {
            return;
        };
        let (stamp_s, at_s) = (stamp.as_micros() as f64 * 1e-6, at.as_secs_f64());
        match &mut self.clock {
            Some(clock) => clock.record(stamp_s, at_s),
            None => {
                self.clock = Some(SenderClockStatistics {
                    message_id: frame.message_id,
                    restarts: 0,
                    first: (stamp_s, at_s),
                    last: (stamp_s, at_s),
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::Encoder;
    use crate::framing::{VerifiedFrame, verify};
    use crate::message::{Message, WireStamp};
    use posebridge_telemetry::Meters;

    fn stamped(millis: u32) -> Message {
        Message::WheelDistance {
            stamp: WireStamp::Micros64(u64::from(millis) * 1_000),
            left: Meters(0.5),
            right: Meters(0.25),
        }
    }

    fn census(frames: &[(u8, u8, u32, i64)]) -> TrafficStatistics {
        let mut census = TrafficStatistics::new();
        for &(system, sequence, stamp_ms, at_ms) in frames {
            let mut bytes = Vec::new();
            let mut encoder = Encoder::new(WireVersion::V2);
            for _ in 0..=sequence {
                bytes.clear();
                encoder.encode(Address::new(system, 1), &stamped(stamp_ms), &mut bytes);
            }
            let VerifiedFrame::Frame(frame) = verify(&bytes) else {
                panic!("it was just encoded");
            };
            census.record(LinkId(0), &frame, Some(Timestamp::from_millis(at_ms)));
        }
        census
    }

    #[test]
    fn senders_lose_frames_each_for_itself_and_rates_are_between_first_and_last() {
        let census = census(&[(1, 0, 0, 0), (2, 9, 0, 100), (1, 1, 0, 500), (2, 12, 0, 1_600), (1, 4, 0, 2_000)]);
        let [one, two] = census.sources() else {
            panic!("two senders");
        };
        assert_eq!((one.lost(), one.sequence_steps, two.lost()), (2, 2, 2));
        assert_eq!(one.total.rate_hz(), Some(1.0));
        assert_eq!(census.messages()[&9000].frames, 5);
        assert_eq!(census.messages()[&9000].rate_hz(), Some(2.0));
        assert_eq!(two.total.longest_silence, TimeDelta::from_millis(1_500));
        let (gaps, count) = census.gaps();
        assert_eq!((gaps.len(), count), (1, 1));
        assert_eq!(gaps[0].from, Timestamp::from_millis(500));
    }

    #[test]
    fn a_clock_that_runs_fast_or_restarts_is_reported() {
        let mut frames = Vec::new();
        for step in 0..=200_u32 {
            // 1001 ms of the sender's clock per second.
            frames.push((1, 0, step * 1_001, i64::from(step) * 1_000));
        }
        let fast = census(&frames).sources()[0].clock.unwrap();
        assert!((fast.drift_ppm().unwrap() - 1_000.0).abs() < 1.0);
        assert_eq!((fast.restarts, fast.message_id), (0, 9000));
        frames.push((1, 0, 5, 201_000));
        frames.extend((0..16).map(|step| (1, 0, 5 + step, 201_000 + i64::from(step))));
        let restarted = census(&frames).sources()[0].clock.unwrap();
        assert_eq!((restarted.restarts, restarted.drift_ppm()), (1, None));
    }

    #[test]
    fn a_sender_that_counts_for_each_link_of_a_log_has_lost_nothing() {
        let mut census = TrafficStatistics::new();
        let mut links = [(0, Encoder::new(WireVersion::V2)), (1, Encoder::new(WireVersion::V2))];
        // The second link is ahead by far.
        for _ in 0..60 {
            links[1].1.encode(Address::new(1, 197), &stamped(0), &mut Vec::new());
        }
        for step in 0..60_u32 {
            let (number, encoder) = &mut links[usize::from(step % 3 == 0)];
            let mut bytes = Vec::new();
            encoder.encode(Address::new(1, 197), &stamped(step), &mut bytes);
            let VerifiedFrame::Frame(frame) = verify(&bytes) else {
                panic!("it was just encoded");
            };
            census.record_logged(*number, &frame, Timestamp::from_millis(i64::from(step)));
        }
        let [station] = census.sources() else {
            panic!("one sender");
        };
        assert_eq!(station.lost(), 0);
        assert!(station.lost > 0 && station.sequence_steps > 100);
    }

    #[test]
    fn a_time_that_falls_is_counted() {
        let census = census(&[(1, 0, 0, 900), (1, 1, 0, 100), (1, 2, 0, 200)]);
        assert_eq!(census.time_reversals(), 1);
    }
}

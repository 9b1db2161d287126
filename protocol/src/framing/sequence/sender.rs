//! What came of one sender, and what is missing.
//!
//! From one stamped message to the next the frames are only noted. The second one tells how many were sent between them, and the
//! account of that interval is settled. Until then the gaps that the numbers show stand for what is missing.

use posebridge_telemetry::{HostClock, Span, Stamp};

use super::pace::Pace;
use super::sequence_set::SequenceSet;
use crate::message::WireStamp;

/// The largest advance of a number that stands for frames sent since; a larger one is an old frame. Half the circle.
const LARGEST_ADVANCE: u8 = 128;
/// The sender's clock and ours may disagree by so much over one interval, s: longer than any link holds a frame back.
const LARGEST_DELAY_S: f64 = 60.0;
/// A stamp may lie so far behind the one before it: a datagram that was overtaken. Further back is a clock that began anew, s.
const OVERTAKEN_S: f64 = 1.0;
/// A message is overtaken by no more frames than this.
const MOST_AHEAD: u8 = 64;
/// So many frames without another stamp of the same message, and stamps are given up: it is not sent any more.
const MOST_NOTED: u32 = 96;

/// The stamp of a message, and when it came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dated {
    pub(super) message_id: u32,
    pub(super) stamp: WireStamp,
    pub(super) arrival: Stamp<HostClock>,
}

/// The message with a stamp from which is counted, and what came since.
#[derive(Clone, Copy, Debug)]
struct Interval {
    from: u8,
    dated: Dated,
    noted: SequenceSet,
    /// Frames noted.
    received: u32,
    /// What the numbers alone say is missing.
    gaps: u32,
}

impl Interval {
    fn new(from: u8, dated: Dated) -> Self {
        Self {
            from,
            dated,
            noted: SequenceSet::default(),
            received: 0,
            gaps: 0,
        }
    }
}

/// One sender.
#[derive(Clone, Debug, Default)]
pub(super) struct Sender {
    /// The newest number; `None` before the first frame and after a break.
    newest: Option<u8>,
    frames: u64,
    /// Settled.
    lost: u64,
    /// What was last told of.
    told: u64,
    /// Which of the last half circle are missing: they may still come.
    missing: SequenceSet,
    /// An old frame that came last: a second one right behind it is no old frame but a sender that begins anew.
    stray: Option<u8>,
    interval: Option<Interval>,
    pace: Pace,
}

impl Sender {
    /// Frames that came.
    pub(super) const fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames that are missing.
    pub(super) fn lost(&self) -> u64 {
        let gaps = self.interval.map_or(0, |interval| interval.gaps);
        self.lost + u64::from(gaps)
    }

    /// How many more are missing than when it was last asked.
    pub(super) fn news(&mut self) -> u32 {
        let lost = self.lost();
        let news = lost.saturating_sub(self.told);
        self.told = lost;
        u32::try_from(news).unwrap_or(u32::MAX)
    }

    /// The link was away.
    pub(super) fn break_off(&mut self) {
        if self.interval.is_none() {
            self.newest = None;
        }
    }

    /// A frame without a stamp.
    pub(super) fn take(&mut self, sequence: u8) {
        self.frames += 1;
        self.follow(sequence);
        if self
            .interval
            .is_some_and(|interval| interval.received >= MOST_NOTED)
        {
            self.give_up_stamps();
        }
    }

    /// A frame with a stamp.
    pub(super) fn take_dated(&mut self, sequence: u8, dated: Dated) {
        let Some(interval) = self.interval else {
            self.take(sequence);
            if self.newest == Some(sequence) {
                self.interval = Some(Interval::new(sequence, dated));
            }
            return;
        };
        let elapsed_s = elapsed_s(&interval.dated, &dated);
        let Some(elapsed_s) = elapsed_s else {
            // Another message: its stamp may be that of another clock.
            self.take(sequence);
            return;
        };
        let silence_s = (dated.arrival - interval.dated.arrival).as_secs_f64();
        if elapsed_s < -OVERTAKEN_S || (elapsed_s - silence_s).abs() > LARGEST_DELAY_S {
            self.frames += 1;
            self.begin_anew(sequence, dated);
            return;
        }
        self.take(sequence);
        if elapsed_s > 0.0 {
            self.settle(sequence, dated, elapsed_s);
        }
    }

    /// What the number says by itself.
    fn follow(&mut self, sequence: u8) {
        let Some(newest) = self.newest else {
            self.newest = Some(sequence);
            return;
        };
        let advance = sequence.wrapping_sub(newest);
        let is_newer = (1..=LARGEST_ADVANCE).contains(&advance);
        if let Some(interval) = &mut self.interval {
            interval.noted.insert(sequence);
            interval.received += 1;
            if is_newer {
                interval.gaps += u32::from(advance - 1);
                self.newest = Some(sequence);
            }
        } else if is_newer {
            let mut came = SequenceSet::default();
            came.insert(sequence);
            self.close((newest, u32::from(advance)), &came, 1);
            self.newest = Some(sequence);
            self.stray = None;
        } else {
            self.take_old(sequence);
        }
    }

    /// A number from behind.
    fn take_old(&mut self, sequence: u8) {
        if self.missing.contains(sequence) {
            self.missing.remove(sequence);
            self.lost = self.lost.saturating_sub(1);
        } else if self.stray.replace(sequence) == Some(sequence.wrapping_sub(1)) {
            self.newest = Some(sequence);
            self.missing = SequenceSet::default();
        }
    }

    /// A stamped message that follows that of the interval by `elapsed_s` of the sender's time.
    fn settle(&mut self, sequence: u8, dated: Dated, elapsed_s: f64) {
        let Some(interval) = self.interval.take() else {
            return;
        };
        let advance = sequence.wrapping_sub(interval.from);
        match self.pace.sent(elapsed_s, advance, interval.received) {
            Some(sent) => {
                self.close((interval.from, sent), &interval.noted, interval.received);
                self.pace.learn(sent, elapsed_s);
                self.interval = Some(Interval::new(sequence, dated));
                self.newest = Some(sequence);
                self.carry_over(&interval.noted, sent);
            }
            None => self.begin_anew(sequence, dated),
        }
    }

    /// What overtook the message that closes an interval of `sent` frames belongs to the next one.
    fn carry_over(&mut self, noted: &SequenceSet, sent: u32) {
        let Some(interval) = &mut self.interval else {
            return;
        };
        for ahead in 1..=MOST_AHEAD {
            let sequence = interval.from.wrapping_add(ahead);
            // Of an interval of nearly a turn the same number may be its own.
            if noted.contains(sequence) && sent + u32::from(ahead) < 256 {
                interval.noted.insert(sequence);
                interval.received += 1;
                self.newest = Some(sequence);
            }
        }
    }

    /// Closes the account of the `sent` frames behind number `from`.
    fn close(&mut self, (from, sent): (u8, u32), noted: &SequenceSet, received: u32) {
        let Some(sent) = u8::try_from(sent).ok() else {
            self.missing = SequenceSet::default();
            self.lost += u64::from(sent.saturating_sub(received));
            return;
        };
        let ahead = |sequence: u8| sequence.wrapping_sub(from);
        let late = noted
            .shared_with(&self.missing)
            .filter(|sequence| ahead(*sequence) == 0 || ahead(*sequence) > sent);
        for sequence in late.collect::<Vec<u8>>() {
            self.missing.remove(sequence);
            self.lost = self.lost.saturating_sub(1);
        }
        for step in 1..=sent {
            let sequence = from.wrapping_add(step);
            // What is half a circle behind comes no more.
            self.missing.remove(sequence.wrapping_add(LARGEST_ADVANCE));
            if noted.contains(sequence) {
                self.missing.remove(sequence);
            } else {
                self.missing.insert(sequence);
                self.lost += 1;
            }
        }
    }

    /// Nobody knows what was sent before this message.
    fn begin_anew(&mut self, sequence: u8, dated: Dated) {
        self.newest = Some(sequence);
        self.missing = SequenceSet::default();
        self.stray = None;
        self.interval = Some(Interval::new(sequence, dated));
        self.told = self.told.min(self.lost);
    }

    /// The message with the stamps comes no more: what the numbers say has to do.
    fn give_up_stamps(&mut self) {
        if let Some(interval) = self.interval.take() {
            self.lost += u64::from(interval.gaps);
            self.missing = SequenceSet::default();
        }
    }
}

/// Time between two stamps of one message by the sender's clock; `None` if they cannot be compared.
fn elapsed_s(from: &Dated, to: &Dated) -> Option<f64> {
    if from.message_id != to.message_id {
        return None;
    }
    let elapsed = match (from.stamp, to.stamp) {
        // A difference of half the register or more is one backwards.
        (WireStamp::Micros32(from), WireStamp::Micros32(to)) => {
            Span::from_micros(i64::from(to.wrapping_sub(from).cast_signed()))
        }
        (WireStamp::Millis32(from), WireStamp::Millis32(to)) => {
            Span::from_millis(i64::from(to.wrapping_sub(from).cast_signed()))
        }
        (WireStamp::Micros64(from), WireStamp::Micros64(to)) => {
            // More than a century either way is as good as a century.
            let micros = to.wrapping_sub(from).cast_signed();
            Span::from_micros(micros.clamp(-LONGEST_MICROS, LONGEST_MICROS))
        }
        _ => return None,
    };
    Some(elapsed.as_secs_f64())
}

/// A century in microseconds, which as nanoseconds still fit into 64 bits.
const LONGEST_MICROS: i64 = 100 * 31_557_600 * 1_000_000;

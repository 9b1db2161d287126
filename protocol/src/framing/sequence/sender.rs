//! Received and missing frames of one sender.
//!
//! Between two stamped messages the frames are only recorded. The second message shows how many were sent between them,
//! and the losses of that interval are counted. Until then the gaps in the numbers are the estimate.

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::missing::{MissingFrames, SequenceSet};
use super::send_rate::SendRate;
use crate::message::WireStamp;

/// Largest advance of a number that means frames sent since; a larger one is an old frame. Half the circle.
const MAX_ADVANCE: u8 = 128;
/// Largest disagreement of the sender's clock and ours over one interval, s: longer than any link delays a frame.
const MAX_DELAY_S: f64 = 60.0;
/// Largest fall of a stamp by reordering, s: a datagram was overtaken by others that a stall had delayed with it. A
/// larger fall is a clock restart.
const MAX_REORDER_S: f64 = 15.0;
/// Consecutive earlier stamps, of frames that were not missing, that mean a clock restart.
const MAX_STRAYS: u32 = 8;
/// Most frames that overtake a message, the range of [`SequenceSet::ahead_of`].
const MAX_AHEAD: u8 = 64;
/// Frames without another stamp of the same message after which stamps are no longer used: it is not sent any more.
const MAX_RECORDED: u32 = 96;

#[derive(Clone, Copy, Debug)]
pub(super) struct StampedArrival {
    pub(super) message_id: u32,
    pub(super) stamp: WireStamp,
    pub(super) arrival: Timestamp<HostClock>,
}

/// The stamped message that begins an interval, and the frames received since.
#[derive(Clone, Copy, Debug)]
struct StampInterval {
    from: u8,
    start: StampedArrival,
    recorded: SequenceSet,
    received: u32,
    gaps: u32,
    /// Recorded frames that were missing before.
    late_frames: u32,
}

impl StampInterval {
    fn new(from: u8, start: StampedArrival) -> Self {
        Self { from, start, recorded: SequenceSet::default(), received: 0, gaps: 0, late_frames: 0 }
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct SenderSequence {
    /// The newest number; `None` before the first frame and after a loss of the link.
    newest: Option<u8>,
    frames: u64,
    /// Of closed intervals.
    lost: u64,
    reported_lost: u64,
    missing: MissingFrames,
    /// The frame expected right after a late stamped frame in its datagram: its number, and how many frames it is
    /// behind.
    late_companion: Option<(u8, u64)>,
    stray_count: u32,
    /// The last unexplained old number: a second one right after it means that the sender restarted.
    last_stray: Option<u8>,
    interval: Option<StampInterval>,
    pace: SendRate,
}

impl SenderSequence {
    pub(super) const fn frames(&self) -> u64 {
        self.frames
    }

    pub(super) fn lost(&self) -> u64 {
        let (gaps, late) = self.interval.map_or((0, 0), |interval| (interval.gaps, interval.late_frames));
        (self.lost + u64::from(gaps)).saturating_sub(u64::from(late))
    }

    /// Increase in missing frames since the last call.
    pub(super) fn take_new_losses(&mut self) -> u32 {
        let lost = self.lost();
        let new_losses = lost.saturating_sub(self.reported_lost);
        self.reported_lost = lost;
        u32::try_from(new_losses).unwrap_or(u32::MAX)
    }

    pub(super) fn handle_link_loss(&mut self) {
        if self.interval.is_none() {
            self.newest = None;
        }
    }

    pub(super) fn record(&mut self, sequence: u8) {
        self.frames += 1;
        if let Some((number, behind)) = self.late_companion.take()
            && number == sequence
            && self.recover_late(number, behind)
        {
            return;
        }
        self.record_number(sequence);
        if self.interval.is_some_and(|interval| interval.received >= MAX_RECORDED) {
            self.abandon_stamps();
        }
    }

    pub(super) fn record_stamped(&mut self, sequence: u8, dated: StampedArrival) {
        let Some(interval) = self.interval else {
            self.record(sequence);
            if self.newest == Some(sequence) {
                self.interval = Some(StampInterval::new(sequence, dated));
            }
            return;
        };
        let elapsed_s = elapsed_s(&interval.start, &dated);
        let Some(elapsed_s) = elapsed_s else {
            // Another message: its stamp may be that of another clock.
            self.record(sequence);
            return;
        };
        let silence_s = (dated.arrival - interval.start.arrival).as_secs_f64();
        if elapsed_s < -MAX_REORDER_S || (elapsed_s - silence_s).abs() > MAX_DELAY_S {
            self.frames += 1;
            self.restart(sequence, dated);
            return;
        }
        let behind = interval.from.wrapping_sub(sequence);
        match self.pace.estimate_behind(-elapsed_s, behind) {
            Some(behind) if elapsed_s <= 0.0 => self.record_overtaken(sequence, dated, behind),
            _ => {
                self.record(sequence);
                if elapsed_s > 0.0 {
                    self.end_interval(sequence, dated, elapsed_s);
                }
            }
        }
    }

    /// Records a stamped frame that was sent `behind` frames before the reference frame.
    fn record_overtaken(&mut self, sequence: u8, dated: StampedArrival, behind: u64) {
        self.frames += 1;
        if self.recover_late(sequence, behind) {
            return;
        }
        self.stray_count += 1;
        if self.stray_count > MAX_STRAYS {
            self.restart(sequence, dated);
        }
    }

    fn recover_late(&mut self, sequence: u8, behind: u64) -> bool {
        let was_missing = self.missing.recover_late(behind);
        if was_missing {
            self.lost = self.lost.saturating_sub(1);
            self.late_companion = behind.checked_sub(1).map(|behind| (sequence.wrapping_add(1), behind));
        }
        was_missing
    }

    fn record_number(&mut self, sequence: u8) {
        let Some(newest) = self.newest else {
            self.newest = Some(sequence);
            return;
        };
        let advance = sequence.wrapping_sub(newest);
        let is_newer = (1..=MAX_ADVANCE).contains(&advance);
        if let Some(interval) = &mut self.interval {
            interval.recorded.insert(sequence);
            interval.received += 1;
            let behind = interval.from.wrapping_sub(sequence);
            if !(1..=MAX_AHEAD).contains(&advance) && self.missing.contains(behind.into()) {
                interval.late_frames += 1;
            } else if is_newer {
                interval.gaps += u32::from(advance - 1);
                self.newest = Some(sequence);
            }
        } else if is_newer {
            for _ in 1..advance {
                self.missing.push_missing();
            }
            self.missing.push_received();
            self.lost += u64::from(advance - 1);
            self.newest = Some(sequence);
            self.last_stray = None;
        } else {
            self.record_old(newest, sequence);
        }
    }

    fn record_old(&mut self, newest: u8, sequence: u8) {
        if self.missing.recover_late(u64::from(newest.wrapping_sub(sequence))) {
            self.lost = self.lost.saturating_sub(1);
        } else if self.last_stray.replace(sequence) == Some(sequence.wrapping_sub(1)) {
            self.newest = Some(sequence);
            self.missing = MissingFrames::default();
        }
    }

    /// Records a stamped message `elapsed_s` of the sender's time after that of the interval.
    fn end_interval(&mut self, sequence: u8, dated: StampedArrival, elapsed_s: f64) {
        let Some(interval) = self.interval.take() else {
            return;
        };
        let advance = sequence.wrapping_sub(interval.from);
        match self.pace.estimate_sent(elapsed_s, advance, interval.received) {
            Some(sent) => {
                self.count_losses(interval.from, sent, &interval.recorded, interval.received);
                self.pace.update(sent, elapsed_s);
                self.stray_count = 0;
                self.interval = Some(StampInterval::new(sequence, dated));
                self.newest = Some(sequence);
                self.carry_to_next_interval(&interval.recorded, sent);
            }
            None => self.restart(sequence, dated),
        }
    }

    /// Assigns the frames that overtook the closing message of an interval of `sent` frames to the next interval.
    fn carry_to_next_interval(&mut self, noted: &SequenceSet, sent: u32) {
        let Some(interval) = &mut self.interval else {
            return;
        };
        for ahead in noted.ahead_of(interval.from) {
            let sequence = interval.from.wrapping_add(ahead);
            // Of an interval of nearly a turn the same number may be its own.
            if sent + u32::from(ahead) < 256 {
                interval.recorded.insert(sequence);
                interval.received += 1;
                self.newest = Some(sequence);
            }
        }
    }

    /// Counts the losses among the `sent` frames after number `from`.
    fn count_losses(&mut self, from: u8, sent: u32, noted: &SequenceSet, received: u32) {
        let Some(sent) = u8::try_from(sent).ok() else {
            self.count_long_losses(from, sent, noted, received);
            return;
        };
        for sequence in noted.iter() {
            let ahead = sequence.wrapping_sub(from);
            let behind = from.wrapping_sub(sequence);
            if ahead > sent && behind < MAX_ADVANCE && self.missing.recover_late(behind.into()) {
                self.lost = self.lost.saturating_sub(1);
            }
        }
        for step in 1..=sent {
            if noted.contains(from.wrapping_add(step)) {
                self.missing.push_received();
            } else {
                self.missing.push_missing();
                self.lost += 1;
            }
        }
    }

    /// Counts the losses among more frames than there are numbers: the received ones are assigned to the nearer end.
    fn count_long_losses(&mut self, from: u8, sent: u32, noted: &SequenceSet, received: u32) {
        let to = from.wrapping_add(sent as u8);
        for step in 1..=sent {
            let sequence = from.wrapping_add(step as u8);
            let (ahead, behind) = (sequence.wrapping_sub(from), to.wrapping_sub(sequence));
            let is_here = if ahead <= behind { u32::from(ahead) == step } else { u32::from(behind) == sent - step };
            if is_here && noted.contains(sequence) {
                self.missing.push_received();
            } else {
                self.missing.push_missing();
            }
        }
        self.lost += u64::from(sent.saturating_sub(received));
    }

    /// Starts a new sequence at this message; nothing is known before it.
    fn restart(&mut self, sequence: u8, dated: StampedArrival) {
        self.newest = Some(sequence);
        self.missing = MissingFrames::default();
        self.last_stray = None;
        self.stray_count = 0;
        self.interval = Some(StampInterval::new(sequence, dated));
        self.reported_lost = self.reported_lost.min(self.lost);
    }

    /// The stamped message is not sent any more: the losses by the numbers are final.
    fn abandon_stamps(&mut self) {
        if let Some(interval) = self.interval.take() {
            self.lost += u64::from(interval.gaps);
            self.missing = MissingFrames::default();
        }
    }
}

/// Time between two stamps of one message by the sender's clock; `None` if they cannot be compared.
fn elapsed_s(from: &StampedArrival, to: &StampedArrival) -> Option<f64> {
    if from.message_id != to.message_id {
        return None;
    }
    let elapsed = match (from.stamp, to.stamp) {
        // A difference of half the register or more is one backwards.
        (WireStamp::Micros32(from), WireStamp::Micros32(to)) => {
            TimeDelta::from_micros(i64::from(to.wrapping_sub(from).cast_signed()))
        }
        (WireStamp::Millis32(from), WireStamp::Millis32(to)) => {
            TimeDelta::from_millis(i64::from(to.wrapping_sub(from).cast_signed()))
        }
        (WireStamp::Micros64(from), WireStamp::Micros64(to)) => {
            // More than a century either way is as good as a century.
            let micros = to.wrapping_sub(from).cast_signed();
            TimeDelta::from_micros(micros.clamp(-MAX_MICROS, MAX_MICROS))
        }
        _ => return None,
    };
    Some(elapsed.as_secs_f64())
}

/// A century in microseconds, which as nanoseconds still fit into 64 bits.
const MAX_MICROS: i64 = 100 * 31_557_600 * 1_000_000;

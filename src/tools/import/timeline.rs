//! Corrects the times of a telemetry log: damaged times, and changes of the computer's date, are detected by looking ahead.
//!
//! # Model
//! ```text
//! off        = further than LEAP from the latest time that counts
//! run        = records that are off, held back until it is known what they are
//!   damage   the times come back to the latest one by a leap, or make no sense among themselves: each counts as the latest time
//!   date     two of the run agree, and a sender's stamps did not advance as much as the times: they go on by the stamps
//!   silence  two of the run agree, and a sender's stamps advanced as much, or no stamps decide
//! ```
//! A decrease is never a silence: without a sender's clock, time continues where it was.

use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};

use posebridge_recording::tlog::NEWEST_MICROS;
use posebridge_telemetry::Address;

/// Larger differences between consecutive times are steps; smaller decreases are caused by a writer's order.
const STEP_THRESHOLD_MICROS: u64 = 60_000_000;
/// Number of records for classifying a step: some seconds of the slowest robot, and 70 KiB of the longest frames.
const LOOKAHEAD: usize = 256;
/// Senders whose clocks are used; further ones are ignored.
const MAX_CLOCKS: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ClockReading {
    /// Sender and message id: a sender may use different clocks for its messages.
    pub(super) clock: (Address, u32),
    /// Microseconds since an arbitrary zero.
    pub(super) micros: i64,
    /// Wrap period in microseconds; `None` if it does not wrap.
    pub(super) wrap_period_micros: Option<i64>,
    /// Whether it is the host's own clock, which is exact: readings of other clocks are older than the record's time.
    pub(super) is_host_clock: bool,
}

impl ClockReading {
    /// Microseconds since this reading; `None` if the clock decreased, because it was restarted. A decrease by nearly the whole range
    /// (except a minute) is a wrap.
    fn advanced_since(&self, sender_micros: i64) -> Option<i64> {
        let advanced = self.micros - sender_micros;
        if advanced >= 0 {
            return Some(advanced);
        }
        let wrapped = advanced + self.wrap_period_micros?;
        (0..=STEP_THRESHOLD_MICROS as i64).contains(&wrapped).then_some(wrapped)
    }
}

/// First and last reading of a clock, each with the corrected time in microseconds.
#[derive(Clone, Copy, Debug)]
struct SenderClock {
    /// Since its last restart.
    first: (u64, i64),
    last: (u64, i64),
}

impl SenderClock {
    /// Whether it advances at all: some senders leave the timestamp zero.
    const fn is_running(&self) -> bool {
        let passed = self.last.0.abs_diff(self.first.0) as i64;
        let advanced = self.last.1 - self.first.1;
        advanced > 0 && advanced >= passed / 2
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TimedRecord<'f> {
    /// Time in the file, microseconds since 1970.
    pub(super) micros: u64,
    /// Of the sender, if the frame has a timestamp.
    pub(super) clock_reading: Option<ClockReading>,
    /// Borrowed, because most frames are passed on at once.
    pub(super) frame: Cow<'f, [u8]>,
}

impl TimedRecord<'_> {
    /// For a record that has to wait.
    fn into_owned(self) -> TimedRecord<'static> {
        TimedRecord {
            micros: self.micros,
            clock_reading: self.clock_reading,
            frame: Cow::Owned(self.frame.into_owned()),
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct TimelineDefects {
    pub(super) damaged: u64,
    pub(super) steps_back: u64,
    pub(super) steps_ahead: u64,
    /// Long gaps that no sender's clock confirms.
    pub(super) silences: u64,
}

impl TimelineDefects {
    /// As text; zero counts are omitted.
    pub(super) fn notes(&self) -> Vec<String> {
        let all = [
            (self.damaged, "times that are damaged, not used"),
            (self.steps_back, "steps back of the computer's date, taken out"),
            (self.steps_ahead, "steps ahead of the computer's date that no other clock shares, taken out"),
            (
                self.silences,
                "silences of more than a minute that no other clock confirms: a date that was set would look the same",
            ),
        ];
        let occurring = all.into_iter().filter(|(count, _)| *count > 0);
        occurring.map(|(count, what)| format!("{count} {what}")).collect()
    }
}

/// Receives records with the corrected times, microseconds since 1970; they never decrease.
pub(super) type FrameSink<'t> = dyn FnMut(u64, &[u8]) + 't;

pub(super) struct Timeline {
    latest_micros: u64,
    shift_micros: i64,
    run: VecDeque<TimedRecord<'static>>,
    clocks: BTreeMap<(Address, u32), SenderClock>,
    defects: TimelineDefects,
}

impl Timeline {
    /// Starts at a time that is known to be plausible.
    pub(super) const fn new(first_micros: u64) -> Self {
        Self {
            latest_micros: first_micros,
            shift_micros: 0,
            run: VecDeque::new(),
            clocks: BTreeMap::new(),
            defects: TimelineDefects { damaged: 0, steps_back: 0, steps_ahead: 0, silences: 0 },
        }
    }

    /// Adds a record, and passes on the records whose time is known.
    pub(super) fn push(&mut self, record: TimedRecord<'_>, take: &mut FrameSink<'_>) {
        if self.run.is_empty() && !self.is_outlier(&record) {
            return self.emit(&record, take);
        }
        let has_returned = !self.is_outlier(&record)
            && self.run.back().is_some_and(|before| !are_consistent(before.micros, record.micros));
        if has_returned {
            self.drop_times(self.run.len(), take);
            return self.emit(&record, take);
        }
        self.run.push_back(record.into_owned());
        if self.run.len() >= LOOKAHEAD {
            self.resolve_run(take);
        }
    }

    /// Passes on the waiting records, and returns the defects.
    pub(super) fn finish(mut self, take: &mut FrameSink<'_>) -> TimelineDefects {
        while !self.run.is_empty() {
            self.resolve_run(take);
        }
        self.defects
    }

    fn shifted(&self, micros: u64) -> u64 {
        micros.saturating_add_signed(self.shift_micros)
    }

    fn is_outlier(&self, record: &TimedRecord<'_>) -> bool {
        let micros = self.shifted(record.micros);
        !is_possible(record.micros) || micros.abs_diff(self.latest_micros) > STEP_THRESHOLD_MICROS
    }

    fn emit(&mut self, record: &TimedRecord<'_>, take: &mut FrameSink<'_>) {
        self.latest_micros = self.latest_micros.max(self.shifted(record.micros));
        if let Some(reading) = record.clock_reading {
            self.observe_clock(reading);
        }
        take(self.latest_micros, &record.frame);
    }

    fn observe_clock(&mut self, reading: ClockReading) {
        let pair = (self.latest_micros, reading.micros);
        if let Some(clock) = self.clocks.get_mut(&reading.clock) {
            if reading.micros < clock.last.1 {
                clock.first = pair;
            }
            clock.last = pair;
        } else if self.clocks.len() < MAX_CLOCKS {
            self.clocks.insert(reading.clock, SenderClock { first: pair, last: pair });
        }
    }

    /// Passes on the first `count` waiting records with the latest valid time, because their own are invalid.
    fn drop_times(&mut self, count: usize, take: &mut FrameSink<'_>) {
        for record in self.run.drain(..count) {
            self.defects.damaged += 1;
            take(self.latest_micros, &record.frame);
        }
    }

    /// Classifies the run of waiting records; afterwards at least one record less waits.
    fn resolve_run(&mut self, take: &mut FrameSink<'_>) {
        let Some(base) = self.base() else {
            return self.drop_times(self.run.len(), take);
        };
        self.drop_times(base, take);
        self.step();
        // The records behind the step are examined again: there may be another one.
        for record in std::mem::take(&mut self.run) {
            self.push(record, take);
        }
    }

    /// Index of the record at which time continues: the first one that is consistent with the next. The first record, if all are far
    /// apart, as in a log of rare messages.
    fn base(&self) -> Option<usize> {
        let times = || self.run.iter().map(|record| record.micros);
        let agreeing = times().zip(times().skip(1)).position(|(one, other)| are_consistent(one, other));
        let is_ahead = |micros: u64| is_possible(micros) && self.shifted(micros) > self.latest_micros;
        let is_rising = times().is_sorted() && times().all(is_ahead);
        agreeing.or(is_rising.then_some(0))
    }

    /// Classifies the step to the first record of the run, which is consistent with others.
    fn step(&mut self) {
        let Some(base) = self.run.front() else {
            return;
        };
        let base_micros = self.shifted(base.micros);
        let is_ahead = base_micros > self.latest_micros;
        let wrong_by = self.clock_error();
        let step = wrong_by.filter(|wrong| wrong.unsigned_abs() > STEP_THRESHOLD_MICROS);
        if let Some(step) = step {
            self.shift(-step);
            if step > 0 {
                self.defects.steps_ahead += 1;
            } else {
                self.defects.steps_back += 1;
            }
        } else if !is_ahead {
            self.shift((self.latest_micros - base_micros) as i64);
            self.defects.steps_back += 1;
        } else if wrong_by.is_none() {
            self.defects.silences += 1;
        }
        // Whatever the clocks say: the next record counts from here.
        self.latest_micros = self.latest_micros.max(self.run.front().map_or(0, |first| self.shifted(first.micros)));
    }

    /// Advance of the run's times minus that of a sender's clock; `None` without a usable clock. A clock that decreased was restarted.
    fn clock_error(&self) -> Option<i64> {
        let base = self.run.front()?;
        let of_run = self.run.iter().zip(self.run.iter().skip(1));
        let following =
            of_run.take_while(|(before, after)| are_consistent(before.micros, after.micros)).map(|(_, after)| after);
        let mut of_another = None;
        for record in std::iter::once(base).chain(following) {
            let Some((is_hosts, wrong)) = self.clock_disagreement(record) else {
                continue;
            };
            if is_hosts {
                return Some(wrong);
            }
            of_another = of_another.or(Some(wrong));
        }
        of_another
    }

    /// The same by one record's clock, and whether that is the host's.
    fn clock_disagreement(&self, record: &TimedRecord<'_>) -> Option<(bool, i64)> {
        let reading = record.clock_reading?;
        let clock = self.clocks.get(&reading.clock)?;
        let (then_micros, sender_micros) = clock.is_running().then_some(clock.last)?;
        let passed = self.shifted(record.micros) as i64 - then_micros as i64;
        Some((reading.is_host_clock, passed - reading.advanced_since(sender_micros)?))
    }

    /// Multiples of the link number's range: the two lowest bits of a time stay unchanged.
    const fn shift(&mut self, by_micros: i64) {
        self.shift_micros = self.shift_micros.saturating_add(by_micros & !0b11);
    }
}

/// Whether two records with these times may be consecutive.
pub(super) const fn are_consistent(one_micros: u64, other_micros: u64) -> bool {
    is_possible(one_micros) && is_possible(other_micros) && one_micros.abs_diff(other_micros) <= STEP_THRESHOLD_MICROS
}

pub(super) const fn is_possible(micros: u64) -> bool {
    micros < NEWEST_MICROS
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000;
    const DATE_S: u64 = 1_700_000_000;
    /// About that of 32 bits of microseconds.
    const WRAPS_S: u64 = 4_295;

    /// Records at these seconds, with the readings of the robot's clock, s.
    fn timeline_of(records: &[(u64, Option<u64>)]) -> (Vec<u64>, TimelineDefects) {
        let mut timeline = Timeline::new(records[0].0 * SECOND);
        let mut times = Vec::new();
        let zero = records[0].0;
        let mut record_time = |micros: u64, _frame: &[u8]| times.push(micros / SECOND - zero);
        for (at_s, sender_s) in records {
            let reading = sender_s.map(|sender_s| ClockReading {
                clock: (Address::new(1, 1), 30),
                micros: (sender_s * SECOND) as i64,
                wrap_period_micros: Some(WRAPS_S as i64 * SECOND as i64),
                is_host_clock: false,
            });
            let record =
                TimedRecord { micros: at_s.saturating_mul(SECOND), clock_reading: reading, frame: Cow::default() };
            timeline.push(record, &mut record_time);
        }
        let found = timeline.finish(&mut record_time);
        (times, found)
    }

    fn without_clock(times_s: &[u64]) -> (Vec<u64>, TimelineDefects) {
        let records: Vec<_> = times_s.iter().map(|time_s| (*time_s, None)).collect();
        timeline_of(&records)
    }

    #[test]
    fn times_that_come_back_are_damage_however_many_they_are() {
        let damaged = |damaged| TimelineDefects { damaged, ..TimelineDefects::default() };
        assert_eq!(without_clock(&[10, 11, 99_999, 12]), (vec![0, 1, 1, 2], damaged(1)));
        assert_eq!(without_clock(&[10, 11, 99_999, 99_999, 12, 13]), (vec![0, 1, 1, 1, 2, 3], damaged(2)));
        let beyond = 1 << 63;
        let mut times = vec![10, 11];
        times.extend([beyond; 10]);
        times.extend([12, 13]);
        let (stamps, found) = without_clock(&times);
        assert_eq!((stamps[11], stamps[12], stamps[13]), (1, 2, 3));
        assert_eq!(found, damaged(10));
        assert_eq!(without_clock(&[500, 0, 501, 502]), (vec![0, 0, 1, 2], damaged(1)));
    }

    #[test]
    fn a_silence_stays_and_is_told_where_no_clock_confirms_it() {
        for (readings_s, silences) in [
            ([None; 4], 1),
            ([3, 4, 4_993, 4_994].map(Some), 0),
            // A clock that stands still, and one of a robot that began anew in the silence, say nothing of it.
            ([0; 4].map(Some), 1),
            ([900, 901, 2, 3].map(Some), 1),
        ] {
            let records: Vec<_> = [10, 11, 5_000, 5_001].into_iter().zip(readings_s).collect();
            let (stamps, found) = timeline_of(&records);
            assert_eq!(stamps, [0, 1, 4_990, 4_991], "{readings_s:?}");
            assert_eq!(found, TimelineDefects { silences, ..TimelineDefects::default() }, "{readings_s:?}");
        }
    }

    #[test]
    fn a_date_that_is_set_ahead_is_found_by_the_robots_clock() {
        for step_s in [600, 6 * 3_600, 30 * 86_400, 3 * 365 * 86_400] {
            let records = (0..40_u64).map(|second| {
                let step = if second < 10 { 0 } else { step_s };
                // Some messages have no stamp.
                let clock_s = (second % 3 != 1).then_some(second + 77);
                (DATE_S + step + second, clock_s)
            });
            let (stamps, found) = timeline_of(&records.collect::<Vec<_>>());
            assert_eq!(stamps, (0..40).collect::<Vec<u64>>(), "{step_s}");
            assert_eq!((found.steps_ahead, found.damaged), (1, 0), "{step_s}");
        }
    }

    #[test]
    fn a_date_that_is_set_back_goes_on_where_it_was_or_by_the_robots_clock() {
        let (stamps, found) = without_clock(&[5_000, 5_001, 1_401, 1_402]);
        assert_eq!((stamps, found.steps_back), (vec![0, 1, 1, 2], 1));
        let records = [(5_000, 3), (5_001, 4), (1_401, 8), (1_402, 9)];
        let (stamps, found) = timeline_of(&records.map(|(at, clock_s)| (at, Some(clock_s))));
        assert_eq!((stamps, found.steps_back), (vec![0, 1, 5, 6], 1));
        let disorder = without_clock(&[10, 12, 11, 13]);
        assert_eq!(disorder, (vec![0, 2, 2, 3], TimelineDefects::default()));
    }

    #[test]
    fn a_clock_that_wraps_at_the_step_tells_all_the_same() {
        let records = [(5_000, 4_293), (5_001, 4_294), (8_602, 0), (8_603, 1)];
        let (stamps, found) = timeline_of(&records.map(|(at, clock_s)| (at, Some(clock_s))));
        assert_eq!((stamps, found.steps_ahead), (vec![0, 1, 2, 3], 1));
    }
}

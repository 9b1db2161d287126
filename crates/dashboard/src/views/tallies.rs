//! Counts of observations by source: all, gated and late. They are exact, however much the lines are thinned.

use std::collections::BTreeMap;

use posebridge_telemetry::{Event, FusionOutcome, FusionRecord, HostClock, RobotId, SensorId, TimeDelta, Timestamp};

use super::retained_series::RetentionPolicy;
use super::retained_series::{MAX_ROBOTS, PointPriority, RetainedSeriesMap};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::limits::SECOND;
use crate::model::{Frame, TallyPoint, seconds_of};

/// An observation with this lag behind the filter's time counts as late: three readings of a brick at 20 Hz. The
/// page's marks use the same limit (`web/model/marks.js`).
const MIN_LATE_LAG: TimeDelta = TimeDelta::from_millis(150);
/// Most sources that are counted; a robot has about four.
const MAX_SOURCES: usize = 4 * MAX_ROBOTS;
/// The share of a recording's points for the counts of one source: one a second for more than half an hour, then
/// fewer.
const POINT_SHARE: usize = 10;

/// Robot, sensor and kind.
type SourceKey = (RobotId, (SensorId, &'static str));

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default)]
struct SourceCounts {
    seen: u64,
    gated: u64,
    late: u64,
}

pub(super) struct Tallies {
    counts: BTreeMap<SourceKey, SourceCounts>,
    /// Each second of a recording; a live session needs only the counts.
    seconds: RetainedSeriesMap<(SensorId, &'static str), TallyPoint>,
    next_second: Timestamp<HostClock>,
    last: Timestamp<HostClock>,
    ignored: u64,
}

impl Tallies {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        let keep = match setting.retention {
            RetentionPolicy::SlidingWindow { duration: span, .. } => {
                RetentionPolicy::SlidingWindow { duration: span, max_points: 0 }
            }
            RetentionPolicy::WholeSession { max_points: most } => {
                RetentionPolicy::WholeSession { max_points: most / POINT_SHARE }
            }
        };
        Self {
            counts: BTreeMap::new(),
            seconds: RetainedSeriesMap::new(keep, MAX_SOURCES),
            next_second: Timestamp::ZERO,
            last: Timestamp::ZERO,
            ignored: 0,
        }
    }

    fn count(&mut self, source: SourceKey, record: &FusionRecord) {
        if !self.counts.contains_key(&source) && self.counts.len() >= MAX_SOURCES {
            self.ignored += 1;
            return;
        }
        let tally = self.counts.entry(source).or_default();
        tally.seen += 1;
        tally.gated += u64::from(record.outcome == FusionOutcome::Gated);
        tally.late += u64::from(record.lag >= MIN_LATE_LAG);
    }

    fn record_second(&mut self) {
        for (source, tally) in &self.counts {
            let (_, (sensor, kind)) = *source;
            let point = point_of(self.last, sensor, kind, *tally);
            self.seconds.push(self.last, *source, point, PointPriority::Normal);
        }
        // A message has the current counts.
        drop(self.seconds.take_pending());
    }

    fn add_counts(&self, frame: &mut Frame) {
        for ((robot, (sensor, kind)), tally) in &self.counts {
            let point = point_of(self.last, *sensor, kind, *tally);
            frame.robot(&robot_name(*robot)).tallies.push(point);
        }
    }
}

impl View for Tallies {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        let ViewInput::Event(Event::ObservationFused { robot, record }) = input else {
            return;
        };
        if now >= self.next_second {
            self.record_second();
            self.next_second = now + SECOND;
        }
        self.last = self.last.max(now);
        self.count((*robot, (record.sensor, record.kind)), record);
    }

    fn add_updates(&mut self, frame: &mut Frame, content: FrameContent) {
        if content == FrameContent::DeltaAndSummary {
            self.add_counts(frame);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.seconds.retained() {
            history.robot(&robot_name(robot)).tallies.extend(points);
        }
        self.add_counts(history);
    }

    fn dropped(&self) -> u64 {
        self.ignored
    }
}

fn point_of(at: Timestamp<HostClock>, sensor: SensorId, kind: &'static str, tally: SourceCounts) -> TallyPoint {
    TallyPoint {
        t_s: seconds_of(at),
        sensor: sensor.name().to_owned(),
        kind: kind.to_owned(),
        seen: tally.seen,
        gated: tally.gated,
        late: tally.late,
    }
}

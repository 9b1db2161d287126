//! The outcome of observations: camera fixes for the map, innovations and NIS of each source, and counts.

use std::collections::VecDeque;

use posebridge_report::RecentInnovations;
use posebridge_telemetry::{
    Event, Fix, FusionOutcome, FusionRecord, Heading, HostClock, ObservationKind, RobotId, SensorId, TimeDelta,
    Timestamp,
};

use super::retained_series::{BoundedMap, MAX_ROBOTS, OlderPolicy, PointPriority, RetainedSeriesMap, SeriesView};
use super::view::{FrameContent, View, ViewConfig, ViewInput, robot_name};
use crate::limits::SECOND;
use crate::model::{FixPoint, Frame, FusionPoint, Number, TallyPoint, seconds_of};

/// Fixes that wait for their fusion record; it follows at once, but a late fix may revise others first.
const MAX_PENDING_FIXES: usize = 16;

/// Fixes without a record, oldest first.
pub(super) type PendingFixes = VecDeque<(RobotId, SensorId, Fix)>;

/// Camera fixes with their outcome, for the map. The position of a fix is in the observation, its outcome in the record that follows.
pub(super) fn fixes(config: &ViewConfig) -> SeriesView<PendingFixes, (), FixPoint> {
    SeriesView {
        state: VecDeque::new(),
        points: RetainedSeriesMap::new(config.retention, MAX_ROBOTS),
        observe: |pending, now, event| {
            if let Event::ObservationAligned { robot, observation, .. } = event
                && let ObservationKind::Fix(fix) = observation.measurement
            {
                if pending.len() >= MAX_PENDING_FIXES {
                    pending.pop_front();
                }
                pending.push_back((*robot, observation.sensor, fix));
            }
            let Event::ObservationFused { robot, record } = event else {
                return None;
            };
            let index = pending.iter().position(|open| (open.0, open.1) == (*robot, record.sensor))?;
            if record.kind != "fix" {
                return None;
            }
            let (_, _, fix) = pending.remove(index)?;
            let point = FixPoint {
                t_s: seconds_of(now),
                x_m: fix.position.x.0.into(),
                y_m: fix.position.y.0.into(),
                heading_rad: fix.heading.map_or(f64::NAN, Heading::rad).into(),
                sensor: record.sensor.name().into(),
                verdict: record.outcome.reason().into(),
                lag_s: record.lag.as_secs_f64().into(),
            };
            Some(((*robot, ()), point, priority_of(record.outcome)))
        },
        write: |frame, points| frame.fixes = points,
    }
}

/// Accepted and unused observations are normal; all others are of interest.
pub(super) fn priority_of(verdict: FusionOutcome) -> PointPriority {
    if matches!(verdict, FusionOutcome::Accepted | FusionOutcome::Unused) {
        PointPriority::Normal
    } else {
        PointPriority::Keep
    }
}

/// Divisor of the history for one source: a robot has about four, and all together should remain a small message.
const FUSION_SHARE: usize = 3;
/// Of one source, before the last minute of a live session.
const OLDER_FUSION_POINTS: usize = 200;
/// Sources have separate series, so that a fast one does not displace a slow one; each with a NIS and without.
const MAX_SERIES: usize = 2 * 4 * MAX_ROBOTS;

/// Sensor, kind, and whether it has a NIS.
type FusionKey = (SensorId, &'static str, bool);

/// The outcome of each observation: innovations and NIS of each source.
///
/// Records with a NIS and those without are thinned separately: of the wheels one in four has one, and thinning both
/// together by halves would leave none of those.
pub(super) fn fusion(config: &ViewConfig) -> SeriesView<(), FusionKey, FusionPoint> {
    let policy = config.retention.map_points(|points| points / FUSION_SHARE);
    SeriesView {
        state: (),
        points: RetainedSeriesMap::new(policy, MAX_SERIES).with_older(OlderPolicy {
            max_points: OLDER_FUSION_POINTS,
            weight: |point| point.nis.get().unwrap_or(f64::NAN),
        }),
        observe: |(), now, event| {
            let Event::ObservationFused { robot, record } = event else {
                return None;
            };
            let source = (record.sensor, record.kind, record.degrees_of_freedom > 0);
            Some(((*robot, source), fusion_point(now, record), priority_of(record.outcome)))
        },
        write: |frame, points| {
            frame.fusion.extend(points);
            frame.fusion.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        },
    }
}

fn fusion_point(now: Timestamp<HostClock>, record: &FusionRecord) -> FusionPoint {
    let used = usize::from(record.degrees_of_freedom).min(record.innovation.len());
    let innovation = record.innovation.iter().take(used);
    let variances = (0..used).map(|index| record.innovation_covariance[index][index]);
    let nis = if used == 0 { f64::NAN } else { record.nis };
    FusionPoint {
        t_s: seconds_of(now),
        sensor: record.sensor.name().into(),
        kind: record.kind.into(),
        verdict: record.outcome.reason().into(),
        lag_s: record.lag.as_secs_f64().into(),
        nis: nis.into(),
        dof: record.degrees_of_freedom,
        innovation: innovation.map(|value| Number::from(*value)).collect(),
        sigma: variances.map(|value| Number::from(value.sqrt())).collect(),
    }
}

/// An observation with this lag behind the filter's time counts as late: three readings of a brick at 20 Hz. The
/// page's marks use the same limit (`web/model/marks.js`).
const MIN_LATE_LAG: TimeDelta = TimeDelta::from_millis(150);
/// A robot has about four.
const MAX_SOURCES: usize = 4 * MAX_ROBOTS;
/// The share of a recording's points for the counts of one source: one a second for more than half an hour, then
/// fewer.
const TALLY_SHARE: usize = 10;

type SourceKey = (RobotId, (SensorId, &'static str));

#[derive(Clone, Debug, Default)]
struct SourceCounts {
    seen: u64,
    gated: u64,
    late: u64,
    recent: RecentInnovations,
}

/// Counts of observations by source: all, gated and late, and the verdict on the latest. They are exact, however much the lines are thinned.
pub(super) struct Tallies {
    counts: BoundedMap<SourceKey, SourceCounts>,
    /// Once a second for a recording; a live session needs only the counts.
    seconds: RetainedSeriesMap<(SensorId, &'static str), TallyPoint>,
    next_second: Timestamp<HostClock>,
    last: Timestamp<HostClock>,
}

impl Tallies {
    pub(super) fn new(setting: &ViewConfig) -> Self {
        Self {
            counts: BoundedMap::new(MAX_SOURCES),
            seconds: RetainedSeriesMap::new(setting.retention.for_seconds(0, TALLY_SHARE), MAX_SOURCES),
            next_second: Timestamp::ZERO,
            last: Timestamp::ZERO,
        }
    }

    fn count(&mut self, source: SourceKey, record: &FusionRecord) {
        if let Some(tally) = self.counts.get_or_insert(source, SourceCounts::default) {
            tally.seen += 1;
            tally.gated += u64::from(record.outcome == FusionOutcome::Gated);
            tally.late += u64::from(record.lag >= MIN_LATE_LAG);
            tally.recent.push(record);
        }
    }

    fn record_second(&mut self) {
        for (source, tally) in &self.counts.entries {
            let (_, (sensor, kind)) = *source;
            let point = tally_point(self.last, sensor, kind, tally);
            self.seconds.push(self.last, *source, point, PointPriority::Normal);
        }
        // A message has the current counts.
        drop(self.seconds.take_pending());
    }

    fn add_counts(&self, frame: &mut Frame) {
        for ((robot, (sensor, kind)), tally) in &self.counts.entries {
            let point = tally_point(self.last, *sensor, kind, tally);
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
        self.counts.ignored
    }
}

fn tally_point(at: Timestamp<HostClock>, sensor: SensorId, kind: &'static str, tally: &SourceCounts) -> TallyPoint {
    let verdict = tally.recent.verdict();
    TallyPoint {
        t_s: seconds_of(at),
        sensor: sensor.name().into(),
        kind: kind.into(),
        seen: tally.seen,
        gated: tally.gated,
        late: tally.late,
        nis: verdict.mean_nis_per_dof.unwrap_or(f64::NAN).into(),
        consistency: verdict.finding.as_text().into(),
    }
}

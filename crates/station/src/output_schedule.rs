//! The outputs of one link and their intervals.
//!
//! Estimates are sent when they are updated, ranges when they are observed, fusion records when they are made, one
//! stream per sensor. Each kind has an interval on each link: configured, or requested by a peer.

use std::collections::BTreeMap;

use posebridge_protocol::message::Message;
use posebridge_telemetry::{FusionRecord, HostClock, Priority, SensorId, TimeDelta, Timestamp};

use crate::config::{AnnouncedAs, LinkConfig, OutputInstant, OutputKind, OutputStream};
use crate::estimate_messages;

pub(crate) fn priority(kind: OutputKind) -> Priority {
    Priority::Estimate { stream: kind.message_id() }
}

/// The priority of a message of which there are several: those of different numbers do not replace each other. Message ids
/// have 24 bits. Sensors have their own number.
pub(crate) fn priority_of_stream(kind: OutputKind, number: u8) -> Priority {
    Priority::Estimate { stream: kind.message_id() | u32::from(number) << 24 }
}

/// When a stream was last sent, and when it is due.
#[derive(Clone, Copy, Debug)]
struct StreamSchedule {
    last: Timestamp<HostClock>,
    /// Time between the last two messages.
    gap: Option<TimeDelta>,
    due: Timestamp<HostClock>,
}

impl StreamSchedule {
    /// When a stream that was due and is sent now is due again.
    ///
    /// Data are available only now and then, and never at the exact instant. Counted from the due time, and not from
    /// the sending, such delays do not add up: the mean interval is right. One missed message may be made up for; after
    /// a longer silence the schedule starts again, or a burst would follow.
    fn due_after(due: Timestamp<HostClock>, interval: TimeDelta, now: Timestamp<HostClock>) -> Timestamp<HostClock> {
        let next = due + interval;
        if now - next < interval { next } else { now + interval }
    }
}

/// Keeps the intervals of one link's outputs.
#[derive(Clone, Debug)]
pub(crate) struct OutputSchedule {
    pub(crate) announced_as: AnnouncedAs,
    /// The intervals unless a peer requests others.
    configured: Vec<OutputStream>,
    streams: Vec<OutputStream>,
    /// By kind, and by sensor where there is one.
    schedules: BTreeMap<(OutputKind, Option<SensorId>), StreamSchedule>,
    /// Used and rejected observations per sensor, for PB_FUSION_HEALTH.
    counts: BTreeMap<SensorId, estimate_messages::FusionCounts>,
}

impl OutputSchedule {
    pub(crate) fn new(link: &LinkConfig) -> Self {
        Self {
            // A link without MAVLink shows no vehicle.
            announced_as: if link.brick.is_none() { link.announced_as } else { AnnouncedAs::Station },
            configured: link.outputs.clone(),
            streams: link.outputs.clone(),
            schedules: BTreeMap::new(),
            counts: BTreeMap::new(),
        }
    }

    /// Sets the interval that a peer requests: another one, none, or (zero) the configured one.
    pub(crate) fn set_interval(&mut self, message_id: u32, interval: Option<TimeDelta>) {
        let Some(kind) = OutputKind::of_message(message_id) else {
            return;
        };
        let configured = self.configured.iter().find(|stream| stream.kind == kind);
        let configured = configured.copied();
        self.streams.retain(|stream| stream.kind != kind);
        self.schedules.retain(|(sent, _), _| *sent != kind);
        let requested = |interval| OutputStream {
            kind,
            interval,
            instant: configured.map_or(OutputInstant::Observed, |stream| stream.instant),
        };
        self.streams.extend(match interval {
            None => None,
            Some(TimeDelta::ZERO) => configured,
            Some(interval) => Some(requested(interval)),
        });
    }

    /// The interval of an output for MESSAGE_INTERVAL, in microseconds: -1 if it is not sent. Without a configured
    /// interval the time between the last two messages; 1 before there were two.
    pub(crate) fn interval_micros(&self, kind: OutputKind) -> i32 {
        let Some(stream) = self.streams.iter().find(|stream| stream.kind == kind) else {
            return -1;
        };
        let mut sent = self.schedules.iter().filter(|((sent, _), _)| *sent == kind);
        let measured = sent.find_map(|(_, sent)| sent.gap).unwrap_or(TimeDelta::ZERO);
        let interval = match stream.interval {
            TimeDelta::ZERO => measured,
            interval => interval,
        };
        i32::try_from(interval.as_nanos() / 1_000).unwrap_or(i32::MAX).max(1)
    }

    /// The outputs with estimates that are due; an item that is taken counts as sent.
    pub(crate) fn due(&mut self, now: Timestamp<HostClock>) -> impl Iterator<Item = OutputStream> {
        let indices = 0..self.streams.len();
        indices.filter_map(move |index| {
            let stream = *self.streams.get(index)?;
            let is_due = stream.kind.is_estimate_output() && self.is_due(&stream, None, now);
            is_due.then_some(stream)
        })
    }

    /// Whether the range of a sensor is due; then it counts as sent.
    pub(crate) fn range_due(&mut self, now: Timestamp<HostClock>) -> bool {
        let mut streams = self.streams.iter();
        let stream = streams.find(|stream| stream.kind == OutputKind::DistanceSensor);
        let stream = stream.copied();
        stream.is_some_and(|stream| self.is_due(&stream, None, now))
    }

    /// The messages of this link for an observation that was compared with a prediction; `host` is when it was made.
    pub(crate) fn messages_for_record(
        &mut self,
        record: &FusionRecord,
        host: &impl Fn() -> Timestamp<HostClock>,
        now: Timestamp<HostClock>,
    ) -> Vec<(OutputKind, Message)> {
        let counts = self.counts.entry(record.sensor).or_default();
        counts.add(record.outcome);
        let counts = *counts;
        if record.degrees_of_freedom == 0 {
            return Vec::new();
        }
        let indices = 0..self.streams.len();
        let of_records = indices.filter_map(|index| {
            let stream = *self.streams.get(index)?;
            if stream.kind.is_estimate_output() {
                return None;
            }
            let message = estimate_messages::record_message(stream.kind, record, host(), counts)?;
            let is_due = self.is_due(&stream, Some(record.sensor), now);
            is_due.then_some((stream.kind, message))
        });
        of_records.collect()
    }

    /// Every output is due with its next data.
    pub(crate) fn restart(&mut self) {
        self.schedules.clear();
    }

    pub(crate) const fn counts(&self) -> &BTreeMap<SensorId, estimate_messages::FusionCounts> {
        &self.counts
    }

    /// Counts on from what another station has counted.
    pub(crate) fn set_counts(&mut self, counts: &BTreeMap<SensorId, estimate_messages::FusionCounts>) {
        self.counts.clone_from(counts);
    }

    pub(crate) fn counts_of(&self, sensor: SensorId) -> estimate_messages::FusionCounts {
        self.counts.get(&sensor).copied().unwrap_or_default()
    }

    fn is_due(&mut self, stream: &OutputStream, sensor: Option<SensorId>, now: Timestamp<HostClock>) -> bool {
        let key = (stream.kind, sensor);
        let (gap, due) = match self.schedules.get(&key) {
            Some(sent) if now < sent.due => return false,
            Some(sent) => (Some(now - sent.last), StreamSchedule::due_after(sent.due, stream.interval, now)),
            None => (None, now + stream.interval),
        };
        let last = now;
        self.schedules.insert(key, StreamSchedule { last, gap, due });
        true
    }
}

impl OutputKind {
    /// Whether it contains an estimate, and not an observation.
    const fn is_estimate_output(self) -> bool {
        match self {
            Self::PlanarPose
            | Self::Odometry
            | Self::LocalPosition
            | Self::Attitude
            | Self::EstimatorStatus
            | Self::GlobalPosition
            | Self::HeadUpDisplay
            | Self::AttitudeQuaternion => true,
            Self::FusionHealth | Self::DistanceSensor | Self::NamedValue | Self::FloatArray => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::{LINK, at, link};
    use posebridge_protocol::dialect::ids;

    fn odometry(interval_ms: i64) -> OutputStream {
        let interval = TimeDelta::from_millis(interval_ms);
        OutputStream { kind: OutputKind::Odometry, interval, instant: OutputInstant::Observed }
    }

    fn schedule_of(outputs: &[OutputStream]) -> OutputSchedule {
        OutputSchedule::new(&link(LINK, outputs.to_vec()))
    }

    /// Estimates come at the instants of telemetry, which are no multiples of a requested interval, and with the delays of a link.
    #[test]
    fn an_interval_is_kept_in_the_mean_at_any_instants_of_estimates() {
        /// Milliseconds by which each of ten in a row is late.
        const LATE: [i64; 10] = [0, 9, 3, 18, 1, 7, 0, 12, 5, 2];
        for period in [20, 50] {
            for interval_ms in [50, 100, 250, 333, 1_000] {
                let mut schedule = schedule_of(&[odometry(interval_ms)]);
                let estimates = (0..60_000 / period).map(|n| n * period + LATE[n as usize % 10]);
                let sent = estimates.filter(|now| schedule.due(at(*now)).count() == 1);
                let (sent, expected) = (sent.count() as i64, 60_000 / interval_ms);
                assert!(
                    (sent - expected).abs() <= 1,
                    "{sent} of {expected} in a minute, asked for each {interval_ms} ms, estimates each {period} ms"
                );
            }
        }
    }

    #[test]
    fn one_missed_message_is_made_up_for_and_two_are_not() {
        for (late, then_due) in [(299, 300), (300, 400)] {
            let mut schedule = schedule_of(&[odometry(100)]);
            assert_eq!(schedule.due(at(0)).count(), 1);
            assert_eq!(schedule.due(at(late)).count(), 1);
            let next = (late + 1..1_000).find(|now| schedule.due(at(*now)).count() == 1);
            assert_eq!(next, Some(then_due), "late at {late} ms");
        }
    }

    #[test]
    fn a_requested_interval_of_zero_restores_the_configured_one() {
        let pose = OutputStream { kind: OutputKind::PlanarPose, ..odometry(40) };
        let mut schedule = schedule_of(&[pose, odometry(100)]);
        schedule.set_interval(ids::ODOMETRY, Some(TimeDelta::from_millis(500)));
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), 500_000);
        schedule.set_interval(ids::ODOMETRY, Some(TimeDelta::ZERO));
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), 100_000);
        schedule.set_interval(ids::ODOMETRY, None);
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), -1);
        assert_eq!(schedule.interval_micros(OutputKind::PlanarPose), 40_000);
    }

    #[test]
    fn the_reported_interval_is_the_actual_one() {
        let stream = odometry(0);
        let mut schedule = schedule_of(&[stream]);
        assert_eq!(schedule.interval_micros(OutputKind::Attitude), -1);
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), 1);
        assert!(schedule.due(at(0)).eq([stream]));
        assert!(schedule.due(at(40)).eq([stream]));
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), 40_000);
        schedule.set_interval(ids::ODOMETRY, Some(TimeDelta::from_millis(250)));
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), 250_000);
        assert_eq!(schedule.due(at(41)).count(), 1);
        assert_eq!(schedule.due(at(290)).count(), 0);
        schedule.set_interval(ids::ODOMETRY, None);
        assert_eq!(schedule.interval_micros(OutputKind::Odometry), -1);
    }
}

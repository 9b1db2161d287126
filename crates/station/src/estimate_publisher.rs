//! The outputs of one robot on each link: estimates, observed ranges and fusion records, as they come.

use std::collections::BTreeMap;

use posebridge_protocol::message::Message;
use posebridge_telemetry::{
    BrickClock, Estimate, FusionRecord, GeodeticOrigin, HostClock, LinkId, Meters, Priority, SensorId, TimeDelta,
    Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::clock_alignment::ClockAlignment;
use crate::config::{AnnouncedAs, LinkConfig, OutputInstant, OutputKind, OutputStream};
use crate::estimate_messages::{self, FusionCounts, PublishContext, host_stamp};
use crate::estimator::Estimator;
use crate::host_times::ShiftHostTimes;
use crate::output_schedule::{OutputSchedule, priority, priority_of_stream};

#[derive(Debug)]
pub(crate) struct PublishedMessage {
    pub(crate) link: LinkId,
    pub(crate) kind: OutputKind,
    pub(crate) message: Message,
    pub(crate) priority: Priority,
}

#[derive(Clone, Copy)]
pub(crate) struct EstimateSource<'a> {
    pub(crate) now: Timestamp<HostClock>,
    pub(crate) clocks: &'a ClockAlignment,
    pub(crate) estimator: &'a Estimator,
    /// Of the robot's owner in a fleet of stations, 0 without one.
    pub(crate) epoch: u64,
    pub(crate) origin: Option<GeodeticOrigin>,
}

/// The outputs of one robot.
#[derive(Debug)]
pub(crate) struct EstimatePublisher {
    links: BTreeMap<LinkId, OutputSchedule>,
    /// The last observed range, with its instant on the host's clock.
    last_range: Option<(Meters, Timestamp<HostClock>)>,
    /// The last fusion record of each sensor that was compared with a prediction.
    last_records: BTreeMap<SensorId, FusionRecord>,
    /// An estimate that was sent to the robot and not yet to the other links.
    pub(crate) pending: Option<Estimate>,
}

/// What is published of a robot whichever links it is published on.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SavedPublisher {
    last_range: Option<(Meters, Timestamp<HostClock>)>,
    /// The same on every link.
    counts: BTreeMap<SensorId, FusionCounts>,
}

impl ShiftHostTimes for SavedPublisher {
    fn shift_host_times(&mut self, by: TimeDelta) {
        let Self { last_range, counts: _ } = self;
        last_range.shift_host_times(by);
    }
}

impl EstimatePublisher {
    /// Intervals belong to links, and the last records are there again with the next observations.
    pub(crate) fn save(&self) -> SavedPublisher {
        let Self { links, last_range, last_records: _, pending: _ } = self;
        let counts = links.values().next().map(|schedule| schedule.counts().clone());
        SavedPublisher { last_range: *last_range, counts: counts.unwrap_or_default() }
    }

    pub(crate) fn restore(&mut self, saved: &SavedPublisher) {
        self.last_range = saved.last_range;
        self.last_records.clear();
        self.pending = None;
        for schedule in self.links.values_mut() {
            schedule.set_counts(&saved.counts);
        }
    }

    pub(crate) fn new(links: &[LinkConfig]) -> Self {
        let schedules = links.iter().map(|link| (link.id, OutputSchedule::new(link)));
        Self { links: schedules.collect(), last_range: None, last_records: BTreeMap::new(), pending: None }
    }

    /// Every output is due with its next data: the robot has another owner.
    pub(crate) fn restart(&mut self) {
        for schedule in self.links.values_mut() {
            schedule.restart();
        }
    }

    /// The messages of an estimate that are due on a link, which is up.
    pub(crate) fn publish(
        &mut self,
        link: LinkId,
        estimate: &Estimate,
        source: EstimateSource<'_>,
    ) -> Vec<PublishedMessage> {
        let Some(schedule) = self.links.get_mut(&link) else {
            return Vec::new();
        };
        let announced_as = schedule.announced_as;
        let due = schedule.due(source.now);
        let messages = due.filter_map(|stream| {
            let message = estimate_message(&stream, estimate, announced_as, source)?;
            Some(PublishedMessage { link, kind: stream.kind, message, priority: priority(stream.kind) })
        });
        messages.collect()
    }

    /// The messages of a record, on every link with such an output.
    pub(crate) fn publish_record(
        &mut self,
        now: Timestamp<HostClock>,
        record: &FusionRecord,
        clocks: &ClockAlignment,
    ) -> Vec<PublishedMessage> {
        if record.degrees_of_freedom > 0 {
            self.last_records.insert(record.sensor, record.clone());
        }
        let host = || clocks.to_host(record.stamp).unwrap_or(now);
        let mut published = Vec::new();
        for (link, schedule) in &mut self.links {
            for (kind, message) in schedule.messages_for_record(record, &host, now) {
                let priority = priority_of_stream(kind, record.sensor.0);
                published.push(PublishedMessage { link: *link, kind, message, priority });
            }
        }
        published
    }

    /// The messages of an observed range, on the links that are up and have such an output.
    pub(crate) fn publish_range(
        &mut self,
        now: Timestamp<HostClock>,
        range: Meters,
        host: Timestamp<HostClock>,
        is_up: impl Fn(LinkId) -> bool,
    ) -> Vec<PublishedMessage> {
        self.last_range = Some((range, host));
        let kind = OutputKind::DistanceSensor;
        let links = self.links.iter_mut();
        let due = links.filter_map(|(link, schedule)| (is_up(*link) && schedule.range_due(now)).then_some(*link));
        let message =
            |link| PublishedMessage { link, kind, message: range_message(range, host), priority: priority(kind) };
        due.map(message).collect()
    }

    /// Sets the interval that a peer requests; `None` stops the message, zero restores the configured one.
    pub(crate) fn set_interval(&mut self, link: LinkId, message_id: u32, interval: Option<TimeDelta>) {
        if let Some(schedule) = self.links.get_mut(&link) {
            schedule.set_interval(message_id, interval);
        }
    }

    /// The interval of an output on a link, in the form of MESSAGE_INTERVAL; `None` if there is no such link.
    pub(crate) fn interval_micros(&self, link: LinkId, kind: OutputKind) -> Option<i32> {
        Some(self.links.get(&link)?.interval_micros(kind))
    }

    /// The present messages of an output; none before there is any data.
    pub(crate) fn current(&self, link: LinkId, kind: OutputKind, source: EstimateSource<'_>) -> Vec<Message> {
        let schedule = self.links.get(&link);
        match kind {
            OutputKind::DistanceSensor => {
                self.last_range.map(|(range, host)| range_message(range, host)).into_iter().collect()
            }
            OutputKind::FusionHealth | OutputKind::NamedValue | OutputKind::FloatArray => {
                let messages = self.last_records.values().filter_map(|record| {
                    let counts = schedule?.counts_of(record.sensor);
                    let host = source.clocks.to_host(record.stamp).unwrap_or(source.now);
                    estimate_messages::record_message(kind, record, host, counts)
                });
                messages.collect()
            }
            OutputKind::PlanarPose
            | OutputKind::Odometry
            | OutputKind::LocalPosition
            | OutputKind::Attitude
            | OutputKind::GlobalPosition
            | OutputKind::HeadUpDisplay
            | OutputKind::AttitudeQuaternion
            | OutputKind::EstimatorStatus => {
                let stream = OutputStream { kind, interval: TimeDelta::ZERO, instant: OutputInstant::Observed };
                let announced_as = schedule.map_or(AnnouncedAs::Station, |schedule| schedule.announced_as);
                let estimate = source.estimator.latest_estimate();
                let message = estimate.and_then(|last| estimate_message(&stream, &last, announced_as, source));
                message.into_iter().collect()
            }
        }
    }
}

/// The message of one output for an estimate: unchanged, or predicted for the instant of its arrival.
fn estimate_message(
    stream: &OutputStream,
    observed: &Estimate,
    announced_as: AnnouncedAs,
    source: EstimateSource<'_>,
) -> Option<Message> {
    let EstimateSource { now, clocks, estimator, epoch, origin } = source;
    let arrival = now + estimate_messages::travel_time(clocks.aligner.round_trip());
    let ahead: Option<Timestamp<BrickClock>> = match stream.instant {
        OutputInstant::Observed => None,
        OutputInstant::Arrival => clocks.at_host_time(arrival, TimeDelta::ZERO).map(|(time, _)| time),
    };
    let predicted = ahead.filter(|time| *time > observed.stamp).and_then(|time| estimator.estimate_at(time));
    let is_predicted = predicted.is_some();
    let host = if is_predicted { arrival } else { clocks.to_host(observed.stamp).unwrap_or(now) };
    let context = PublishContext { is_predicted, host, fix_ratio: estimator.fix_ratio, epoch, origin, announced_as };
    estimate_messages::estimate_message(stream.kind, predicted.as_ref().unwrap_or(observed), &context)
}

fn range_message(range: Meters, host: Timestamp<HostClock>) -> Message {
    Message::DistanceSensor { stamp: host_stamp(host), range, sigma: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::{at, config, link};
    use posebridge_estimator::find_filter;
    use posebridge_protocol::dialect::ids;

    /// The outputs of two links that send nothing by themselves.
    fn two_links() -> EstimatePublisher {
        EstimatePublisher::new(&[LinkId(0), LinkId(1)].map(|id| link(id, vec![])))
    }

    #[test]
    fn a_range_leaves_on_links_that_are_up_and_is_kept_for_later_requests() {
        let config = config();
        let mut publisher = two_links();
        for link in [LinkId(0), LinkId(1)] {
            publisher.set_interval(link, ids::DISTANCE_SENSOR, Some(TimeDelta::from_millis(100)));
        }
        let estimator = Estimator::new(find_filter(&config.robot.filter).unwrap(), &config.robot.filter_config);
        let clocks = ClockAlignment::default();
        let now = at(500);
        let source = EstimateSource { now, clocks: &clocks, estimator: &estimator, epoch: 0, origin: None };
        assert_eq!(publisher.current(LinkId(0), OutputKind::DistanceSensor, source), []);
        let sent = publisher.publish_range(now, Meters(0.7), now, |link| link == LinkId(1));
        assert_eq!(sent.iter().map(|message| message.link).collect::<Vec<_>>(), [LinkId(1)]);
        let current = publisher.current(LinkId(0), OutputKind::DistanceSensor, source);
        assert_eq!(current, [sent[0].message.clone()]);
        // The link that was down has not used its interval up.
        let sent = publisher.publish_range(at(550), Meters(0.6), now, |_| true);
        assert_eq!(sent.iter().map(|message| message.link).collect::<Vec<_>>(), [LinkId(0)]);
    }

    #[test]
    fn a_requested_interval_holds_on_its_own_link() {
        let mut publisher = two_links();
        publisher.set_interval(LinkId(1), ids::ODOMETRY, Some(TimeDelta::from_millis(250)));
        let intervals = [0, 1, 9].map(|link| publisher.interval_micros(LinkId(link), OutputKind::Odometry));
        assert_eq!(intervals, [Some(-1), Some(250_000), None]);
    }
}

//! Time series of a session, collected from the engine's events in bounded memory. Times are seconds since the first input, by the
//! host's clock. Tests and tallies use all data; plotted series are thinned in sessions of hours ([`ThinnedSeries`]).

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Result;
use posebridge_report::PoseTrack;
use posebridge_report::chart::session::{CalibrationSample, ClockSample, ErrorSample, InnovationSample, LinkSample};
use posebridge_station::{RecordedStations, Robot};
use posebridge_telemetry::{
    Estimate, Event, FusionRecord, HostClock, LinkId, ReceiveError, SensorId, SignatureError, TimeDelta, Timestamp,
};

use super::replay::watch::EventWatcher;
use crate::config::learnable_keys;
use crate::station::event_collector::{EventCollector, ThinnedSeries};
use crate::station::per_robot::PerRobot;

/// Samples per curve; an hour at 50 Hz has fewer.
const MAX_SAMPLES: usize = 200_000;
const LEARNED_PERIOD: TimeDelta = TimeDelta::from_millis(200);

#[derive(Debug)]
pub struct SourceHistory {
    pub sensor: SensorId,
    pub kind: &'static str,
    pub samples: ThinnedSeries<InnovationSample>,
}

#[derive(Debug)]
pub struct CalibrationHistory {
    pub key: &'static str,
    pub samples: ThinnedSeries<CalibrationSample>,
}

#[derive(Debug)]
pub struct SessionHistory {
    /// Data for the tables of a replay, by the same code.
    pub collector: EventCollector,
    /// In the order of their first observations.
    pub sources: Vec<SourceHistory>,
    pub links: BTreeMap<LinkId, ThinnedSeries<LinkSample>>,
    pub clock: ThinnedSeries<ClockSample>,
    pub timeline: EventTimeline,
    origin: Timestamp<HostClock>,
    last: Timestamp<HostClock>,
    estimates: ThinnedSeries<(f64, Estimate)>,
    learned: Vec<CalibrationHistory>,
    last_calibration_poll: Option<Timestamp<HostClock>>,
}

impl SessionHistory {
    /// Times count from `origin`, the first input.
    pub fn new(origin: Timestamp<HostClock>) -> Self {
        let learned = learnable_keys()
            .map(|entry| CalibrationHistory { key: entry.key, samples: ThinnedSeries::with_capacity(MAX_SAMPLES) });
        Self {
            collector: EventCollector::default(),
            sources: Vec::new(),
            links: BTreeMap::new(),
            clock: ThinnedSeries::with_capacity(MAX_SAMPLES),
            timeline: EventTimeline::default(),
            origin,
            last: origin,
            estimates: ThinnedSeries::with_capacity(MAX_SAMPLES),
            learned: learned.collect(),
            last_calibration_poll: None,
        }
    }

    /// With a valid position.
    pub fn estimates(&self) -> Vec<Estimate> {
        let estimates = self.estimates.items().iter();
        estimates.map(|(_, estimate)| *estimate).collect()
    }

    pub fn errors(&self, truth: &PoseTrack) -> Vec<ErrorSample> {
        let estimates = self.estimates.items().iter();
        estimates.filter_map(|(t_s, estimate)| ErrorSample::from_estimate(*t_s, estimate, truth)).collect()
    }

    /// Constants whose sigma has decreased.
    pub fn learned(&self) -> impl Iterator<Item = &CalibrationHistory> {
        self.learned.iter().filter(|series| {
            let samples = series.samples.items();
            let ends = samples.first().zip(samples.last());
            ends.is_some_and(|(first, last)| {
                first.sigma > 0.0 && (last.sigma < first.sigma || last.value != first.value)
            })
        })
    }

    pub fn length(&self) -> TimeDelta {
        self.last - self.origin
    }

    fn on_fusion(&mut self, t_s: f64, record: &FusionRecord) {
        let known = self.sources.iter().position(|source| source.sensor == record.sensor);
        let index = known.unwrap_or_else(|| {
            self.sources.push(SourceHistory {
                sensor: record.sensor,
                kind: record.kind,
                samples: ThinnedSeries::with_capacity(MAX_SAMPLES),
            });
            self.sources.len() - 1
        });
        let sample = InnovationSample::from_record(t_s, record);
        if let Some((source, sample)) = self.sources.get_mut(index).zip(sample) {
            source.samples.push(sample);
        }
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    fn on_clock_event(&mut self, t_s: f64, event: &Event) {
        match event {
            Event::Health { link, health, .. } => {
                let samples = self.links.entry(*link);
                let samples = samples.or_insert_with(|| ThinnedSeries::with_capacity(MAX_SAMPLES));
                samples.push(LinkSample { t_s, health: *health });
            }
            Event::BrickClockAligned { offset, skew_ppm, uncertainty, round_trip, .. } => {
                self.clock.push(ClockSample {
                    t_s,
                    offset_s: offset.as_secs_f64(),
                    skew_ppm: *skew_ppm,
                    uncertainty_s: uncertainty.as_secs_f64(),
                    round_trip_s: round_trip.map(TimeDelta::as_secs_f64),
                });
            }
            Event::EstimateUpdated { estimate, .. } => {
                self.estimates.push((t_s, *estimate));
            }
            Event::ObservationFused { record, .. } => self.on_fusion(t_s, record),
            _ => {}
        }
    }
}

impl EventWatcher for SessionHistory {
    fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        let t_s = (now - self.origin).as_secs_f64();
        self.collector.on_event(event);
        self.on_clock_event(t_s, event);
        self.timeline.on_event(t_s, event);
        Ok(())
    }

    fn after_input(&mut self, now: Timestamp<HostClock>, stations: &RecordedStations) {
        self.record_calibration(now, stations.robots().next());
    }
}

impl EventWatcher for PerRobot<SessionHistory> {
    fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.try_push(event, |history, event| history.observe(now, event))
    }

    fn after_input(&mut self, now: Timestamp<HostClock>, stations: &RecordedStations) {
        for entry in self.entries_mut() {
            // Both are in the order of the first frame of each robot, but not every robot has an observation.
            let robot = stations.robots().find(|robot| entry.robot.is_none_or(|id| id == robot.id()));
            entry.value.record_calibration(now, robot);
        }
    }
}

impl SessionHistory {
    fn record_calibration(&mut self, now: Timestamp<HostClock>, robot: Option<&Robot>) {
        self.last = self.last.max(now);
        let is_due = self.last_calibration_poll.is_none_or(|last_poll| now - last_poll >= LEARNED_PERIOD);
        let Some(robot) = robot.filter(|robot| is_due && robot.latest_time().is_some()) else {
            return;
        };
        self.last_calibration_poll = Some(now);
        let Some(calibration) = robot.calibration() else {
            return;
        };
        let t_s = (now - self.origin).as_secs_f64();
        for (entry, series) in learnable_keys().zip(&mut self.learned) {
            let known = (entry.read)(&calibration);
            series.samples.push(CalibrationSample { t_s, value: known.value, sigma: known.sigma });
        }
    }
}

/// Bound of the listed events; the rest is counted.
const MAX_ENTRIES: usize = 400;

#[derive(Clone, Debug, PartialEq)]
pub struct TimelineEntry {
    /// Since the first input.
    pub t_s: f64,
    pub text: String,
}

/// Noteworthy events as text: frequent ones are left out, damage is listed once for each link and kind.
#[derive(Debug, Default)]
pub struct EventTimeline {
    pub entries: Vec<TimelineEntry>,
    pub omitted: u64,
    /// Events that are listed only once.
    pushed_once: BTreeSet<String>,
    is_dead_reckoning: Option<bool>,
}

impl EventTimeline {
    pub fn on_event(&mut self, t_s: f64, event: &Event) {
        if let Some((severity, text)) = event.describe() {
            let is_text = matches!(event, Event::Text { .. });
            self.push(t_s, if is_text { format!("{text} (severity {severity})") } else { text });
        } else if let Event::EstimateUpdated { estimate, .. } = event {
            self.on_estimate(t_s, estimate);
        } else if let Event::BrickClockAligned { uncertainty, .. } = event {
            self.push_once(t_s, &alignment_text("the brick's clock", *uncertainty), "brick clock");
        } else if let Event::CameraClockAligned { camera, uncertainty, .. } = event {
            let subject = format!("the clock of camera {camera}");
            self.push_once(t_s, &alignment_text(&subject, *uncertainty), &subject);
        } else if let Event::ReceiveError { link, defect } = event {
            let what = format!("first on link {link}: {}", kind_of(defect));
            self.push_once(t_s, &what, &what);
        }
    }

    fn on_estimate(&mut self, t_s: f64, estimate: &Estimate) {
        let before = self.is_dead_reckoning.replace(estimate.is_dead_reckoning);
        // Before the first fix everything is dead reckoning: nothing has happened.
        if before.is_some_and(|before| before != estimate.is_dead_reckoning) {
            let what = if estimate.is_dead_reckoning {
                "dead reckoning: no fix for longer than the limit"
            } else {
                "fixes: no dead reckoning any more"
            };
            self.push(t_s, what.to_owned());
        }
    }

    fn push_once(&mut self, t_s: f64, what: &str, key: &str) {
        if self.pushed_once.insert(key.to_owned()) {
            self.push(t_s, what.to_owned());
        }
    }

    fn push(&mut self, t_s: f64, what: String) {
        if self.entries.len() < MAX_ENTRIES {
            self.entries.push(TimelineEntry { t_s, text: what });
        } else {
            self.omitted += 1;
        }
    }
}

fn alignment_text(subject: &str, uncertainty: TimeDelta) -> String {
    format!("{subject} aligned, ± {:.2} ms", uncertainty.as_millis_f64())
}

const fn kind_of(defect: &ReceiveError) -> &'static str {
    match defect {
        ReceiveError::Checksum { .. } => "a frame with a wrong checksum",
        ReceiveError::UnframedBytes { .. } => "bytes outside every frame",
        ReceiveError::ImpossibleHeader { .. } => "a header that its message cannot have",
        ReceiveError::Timeout { .. } => "a frame whose bytes stopped coming",
        ReceiveError::Payload { .. } => "a payload that makes no sense",
        ReceiveError::SequenceGap { .. } => "frames missing",
        ReceiveError::SignatureRejected { reason, .. } => match reason {
            SignatureError::Unsigned => "a frame refused: not signed",
            SignatureError::Invalid => "a frame refused: wrong signature",
            SignatureError::Replayed => "a frame refused: its signature was used before",
            SignatureError::Stale => "a frame refused: its signature is too old",
        },
        ReceiveError::AddressConflict { .. } => "a frame under the station's own address",
        ReceiveError::ClockNotAligned { .. } => "a stamp that cannot be aligned",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Address;

    fn text(text: &str) -> Event {
        Event::Text { source: Address::new(1, 1), severity: 4, text: text.to_owned() }
    }

    #[test]
    fn a_robot_that_talks_without_end_is_counted() {
        let mut timeline = EventTimeline::default();
        for _ in 0..1_000 {
            timeline.on_event(0.0, &text("x"));
        }
        assert_eq!((timeline.entries.len(), timeline.omitted), (MAX_ENTRIES, 600));
    }
}

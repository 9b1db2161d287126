//! What the page of a session needs of a run, over its time: gathered from the engine's events, in bounded memory.
//!
//! Times are seconds since the first input, by the host's clock. Tests and tallies see everything; what is only drawn is thinned in
//! sessions of hours ([`ThinnedSeries`]).

use std::collections::BTreeMap;

use anyhow::Result;
use posebridge_report::chart::session::{CalibrationSample, ClockSample, ErrorSample, InnovationSample, LinkSample};
use posebridge_report::metrics::InnovationTest;
use posebridge_report::{PoseTrack, SourceTally};
use posebridge_station::{Robot, Station};
use posebridge_telemetry::{Estimate, Event, FusionRecord, HostClock, LinkId, SensorId, TimeDelta, Timestamp};

use super::timeline::EventTimeline;
use crate::config::CALIBRATION_KEYS;
use crate::station::event_collector::{EventCollector, ThinnedSeries};
use crate::station::per_robot::PerRobot;
use crate::tools::replay::watch::EventWatcher;

/// Most samples of a curve that are kept; an hour at 50 Hz has fewer.
const MAX_SAMPLES: usize = 200_000;
/// What was learned is asked for this often.
const LEARNED_PERIOD: TimeDelta = TimeDelta::from_millis(200);

/// The history of one sensor.
#[derive(Debug)]
pub struct SourceHistory {
    /// The sensor.
    pub sensor: SensorId,
    /// The kind of its first observation.
    pub kind: &'static str,
    /// Over all of its innovations.
    pub test: InnovationTest,
    /// For the picture.
    pub samples: ThinnedSeries<InnovationSample>,
}

/// The estimates of one systematic error.
#[derive(Debug)]
pub struct CalibrationHistory {
    /// Its key.
    pub key: &'static str,
    /// For the picture.
    pub samples: ThinnedSeries<CalibrationSample>,
}

/// Gathers.
#[derive(Debug)]
pub struct SessionHistory {
    /// What the tables of a replay need, by the same code.
    pub collector: EventCollector,
    /// By sensor, in the order in which they were first heard.
    pub sources: Vec<SourceHistory>,
    /// By link.
    pub links: BTreeMap<LinkId, ThinnedSeries<LinkSample>>,
    /// Alignments of the brick's clock.
    pub clock: ThinnedSeries<ClockSample>,
    /// What happened, in words.
    pub timeline: EventTimeline,
    origin: Timestamp<HostClock>,
    last: Timestamp<HostClock>,
    estimates: ThinnedSeries<(f64, Estimate)>,
    learned: Vec<CalibrationHistory>,
    last_calibration_poll: Option<Timestamp<HostClock>>,
}

impl SessionHistory {
    /// One that counts time from the first input.
    pub fn new(origin: Timestamp<HostClock>) -> Self {
        let learned = CALIBRATION_KEYS
            .iter()
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

    /// The estimates whose position was valid.
    pub fn estimates(&self) -> Vec<Estimate> {
        let estimates = self.estimates.items().iter();
        estimates.map(|(_, estimate)| *estimate).collect()
    }

    /// How far each estimate was from the truth.
    pub fn errors(&self, truth: &PoseTrack) -> Vec<ErrorSample> {
        let estimates = self.estimates.items().iter();
        estimates.filter_map(|(t_s, estimate)| ErrorSample::from_estimate(*t_s, estimate, truth)).collect()
    }

    /// What was not known from the beginning, and was learned: its sigma has fallen.
    pub fn learned(&self) -> impl Iterator<Item = &CalibrationHistory> {
        self.learned.iter().filter(|series| {
            let samples = series.samples.items();
            let ends = samples.first().zip(samples.last());
            ends.is_some_and(|(first, last)| {
                first.sigma > 0.0 && (last.sigma < first.sigma || last.value != first.value)
            })
        })
    }

    /// The tally of a sensor.
    pub fn tally(&self, sensor: SensorId) -> Option<&SourceTally> {
        let mut tallies = self.collector.sources.iter();
        tallies.find(|tally| tally.sensor == sensor)
    }

    /// From the first input to the last.
    pub fn length(&self) -> TimeDelta {
        self.last - self.origin
    }

    fn on_fusion(&mut self, t_s: f64, record: &FusionRecord) {
        let known = self.sources.iter().position(|source| source.sensor == record.sensor);
        let index = known.unwrap_or_else(|| {
            self.sources.push(SourceHistory {
                sensor: record.sensor,
                kind: record.kind,
                test: InnovationTest::default(),
                samples: ThinnedSeries::with_capacity(MAX_SAMPLES),
            });
            self.sources.len() - 1
        });
        if let Some(source) = self.sources.get_mut(index) {
            source.test.add(record);
            if let Some(sample) = InnovationSample::from_record(t_s, record) {
                source.samples.push(sample);
            }
        }
    }

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
                if estimate.validity.position {
                    self.estimates.push((t_s, *estimate));
                }
            }
            Event::ObservationFused { record, .. } => self.on_fusion(t_s, record),
            Event::ObservationAligned { .. }
            | Event::Temperature { .. }
            | Event::RobotDetected { .. }
            | Event::RobotNamed { .. }
            | Event::RobotLost { .. }
            | Event::BrickRestarted { .. }
            | Event::CameraClockAligned { .. }
            | Event::Link { .. }
            | Event::ReceiveError { .. }
            | Event::Text { .. } => {}
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

    fn after_input(&mut self, now: Timestamp<HostClock>, station: &Station) {
        self.record_calibration(now, station.robots().first());
    }
}

/// One history for each robot.
impl EventWatcher for PerRobot<SessionHistory> {
    fn observe(&mut self, now: Timestamp<HostClock>, event: &Event) -> Result<()> {
        self.try_push(event, |history, event| history.observe(now, event))
    }

    fn after_input(&mut self, now: Timestamp<HostClock>, station: &Station) {
        let robots = station.robots();
        for entry in self.entries_mut() {
            // Both are in the order in which robots were heard, but not every robot has been observed.
            let robot = robots.iter().find(|robot| entry.robot.is_none_or(|id| id == robot.id()));
            entry.value.record_calibration(now, robot);
        }
    }
}

impl SessionHistory {
    /// Keeps now and then what a robot's filter has learned.
    fn record_calibration(&mut self, now: Timestamp<HostClock>, robot: Option<&Robot>) {
        self.last = self.last.max(now);
        let is_due = self.last_calibration_poll.is_none_or(|asked| now - asked >= LEARNED_PERIOD);
        let Some(robot) = robot.filter(|robot| is_due && robot.latest_time().is_some()) else {
            return;
        };
        self.last_calibration_poll = Some(now);
        let Some(calibration) = robot.calibration() else {
            return;
        };
        let t_s = (now - self.origin).as_secs_f64();
        for (entry, series) in CALIBRATION_KEYS.iter().zip(&mut self.learned) {
            let known = (entry.read)(&calibration);
            series.samples.push(CalibrationSample { t_s, value: known.value, sigma: known.sigma });
        }
    }
}

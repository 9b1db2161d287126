//! What the page of a session needs of a run, over its time: gathered from the engine's events, in bounded memory.
//!
//! Times are seconds since the first input, by the host's clock. Tests and tallies see everything; what is only drawn is thinned in
//! sessions of hours ([`Thinned`]).

use std::collections::BTreeMap;

use anyhow::Result;
use posebridge_analysis::figures::session::{ClockSample, ErrorSample, InnovationSample, LearnedSample, LinkSample};
use posebridge_analysis::metrics::InnovationTest;
use posebridge_analysis::{SourceTally, Track};
use posebridge_pipeline::Pipeline;
use posebridge_telemetry::{Estimate, Event, FusionRecord, HostClock, LinkId, SensorId, Span, Stamp};

use super::happenings::Happenings;
use crate::collect::{Collector, Thinned};
use crate::commands::replay::watch::Watch;
use crate::config::CALIBRATION_KEYS;

/// So many samples of a curve are kept; an hour at 50 Hz has fewer.
const KEPT: usize = 200_000;
/// What was learned is asked for this often.
const LEARNED_PERIOD: Span = Span::from_millis(200);

/// One sensor's part of the story.
#[derive(Debug)]
pub struct SourceStory {
    /// The sensor.
    pub sensor: SensorId,
    /// The kind of its first observation.
    pub kind: &'static str,
    /// Over all of its innovations.
    pub test: InnovationTest,
    /// For the picture.
    pub samples: Thinned<InnovationSample>,
}

/// What was believed of one systematic error.
#[derive(Debug)]
pub struct LearnedStory {
    /// Its key.
    pub key: &'static str,
    /// For the picture.
    pub samples: Thinned<LearnedSample>,
}

/// Gathers.
#[derive(Debug)]
pub struct Chronicle {
    /// What the tables of a replay need, by the same code.
    pub collector: Collector,
    /// By sensor, in the order in which they were first heard.
    pub sources: Vec<SourceStory>,
    /// By link.
    pub links: BTreeMap<LinkId, Thinned<LinkSample>>,
    /// Alignments of the brick's clock.
    pub clock: Thinned<ClockSample>,
    /// What happened, in words.
    pub happenings: Happenings,
    origin: Stamp<HostClock>,
    last: Stamp<HostClock>,
    estimates: Thinned<(f64, Estimate)>,
    learned: Vec<LearnedStory>,
    asked: Option<Stamp<HostClock>>,
}

impl Chronicle {
    /// One that counts time from the first input.
    #[must_use]
    pub fn new(origin: Stamp<HostClock>) -> Self {
        let learned =
            CALIBRATION_KEYS.iter().map(|entry| LearnedStory { key: entry.key, samples: Thinned::keeping(KEPT) });
        Self {
            collector: Collector::default(),
            sources: Vec::new(),
            links: BTreeMap::new(),
            clock: Thinned::keeping(KEPT),
            happenings: Happenings::default(),
            origin,
            last: origin,
            estimates: Thinned::keeping(KEPT),
            learned: learned.collect(),
            asked: None,
        }
    }

    /// The estimates whose position was valid.
    #[must_use]
    pub fn estimates(&self) -> Vec<Estimate> {
        let estimates = self.estimates.items().iter();
        estimates.map(|(_, estimate)| *estimate).collect()
    }

    /// How far each estimate was from the truth.
    #[must_use]
    pub fn errors(&self, truth: &Track) -> Vec<ErrorSample> {
        let estimates = self.estimates.items().iter();
        estimates.filter_map(|(t_s, estimate)| ErrorSample::of(*t_s, estimate, truth)).collect()
    }

    /// What was not known from the beginning, and was learned: its sigma has fallen.
    pub fn learned(&self) -> impl Iterator<Item = &LearnedStory> {
        self.learned.iter().filter(|story| {
            let samples = story.samples.items();
            let ends = samples.first().zip(samples.last());
            ends.is_some_and(|(first, last)| {
                first.sigma > 0.0 && (last.sigma < first.sigma || last.value != first.value)
            })
        })
    }

    /// The tally of a sensor.
    #[must_use]
    pub fn tally(&self, sensor: SensorId) -> Option<&SourceTally> {
        let mut tallies = self.collector.sources.iter();
        tallies.find(|tally| tally.sensor == sensor)
    }

    /// From the first input to the last.
    #[must_use]
    pub fn length(&self) -> Span {
        self.last - self.origin
    }

    fn take_record(&mut self, t_s: f64, record: &FusionRecord) {
        let known = self.sources.iter().position(|source| source.sensor == record.sensor);
        let index = known.unwrap_or_else(|| {
            self.sources.push(SourceStory {
                sensor: record.sensor,
                kind: record.kind,
                test: InnovationTest::default(),
                samples: Thinned::keeping(KEPT),
            });
            self.sources.len() - 1
        });
        if let Some(source) = self.sources.get_mut(index) {
            source.test.add(record);
            if let Some(sample) = InnovationSample::of(t_s, record) {
                source.samples.push(sample);
            }
        }
    }

    fn take_time(&mut self, t_s: f64, event: &Event) {
        match event {
            Event::Health { link, health, .. } => {
                let samples = self.links.entry(*link);
                let samples = samples.or_insert_with(|| Thinned::keeping(KEPT));
                samples.push(LinkSample { t_s, health: *health });
            }
            Event::BrickClockAligned { offset, skew_ppm, uncertainty, round_trip, .. } => {
                self.clock.push(ClockSample {
                    t_s,
                    offset_s: offset.as_secs_f64(),
                    skew_ppm: *skew_ppm,
                    uncertainty_s: uncertainty.as_secs_f64(),
                    round_trip_s: round_trip.map(Span::as_secs_f64),
                })
            }
            Event::Estimated { estimate, .. } => {
                if estimate.validity.position {
                    self.estimates.push((t_s, *estimate));
                }
            }
            Event::Fused { record, .. } => self.take_record(t_s, record),
            Event::Observed { .. }
            | Event::Temperature { .. }
            | Event::RobotSeen { .. }
            | Event::RobotLost { .. }
            | Event::BrickRestarted { .. }
            | Event::CameraClockAligned { .. }
            | Event::Link { .. }
            | Event::Defect { .. }
            | Event::Text { .. } => {}
        }
    }
}

impl Watch for Chronicle {
    fn event(&mut self, now: Stamp<HostClock>, event: &Event) -> Result<()> {
        let t_s = (now - self.origin).as_secs_f64();
        self.collector.take(event);
        self.take_time(t_s, event);
        self.happenings.take(t_s, event);
        Ok(())
    }

    fn handled(&mut self, now: Stamp<HostClock>, pipeline: &Pipeline) {
        self.last = self.last.max(now);
        let is_due = self.asked.is_none_or(|asked| now - asked >= LEARNED_PERIOD);
        if !is_due || pipeline.latest().is_none() {
            return;
        }
        self.asked = Some(now);
        let Some(calibration) = pipeline.calibration() else {
            return;
        };
        let t_s = (now - self.origin).as_secs_f64();
        for (entry, story) in CALIBRATION_KEYS.iter().zip(&mut self.learned) {
            let known = (entry.read)(&calibration);
            story.samples.push(LearnedSample { t_s, value: known.value, sigma: known.sigma });
        }
    }
}

//! What the dashboard knows: everything that it was told, as the views see it.
//!
//! A value without clock and socket; the server's one task owns it and asks it fifty times a second what is new.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{Event, HostClock, LinkHealth, LinkId, SensorId, Stamp, Verdict};

use crate::counts::Counts;
use crate::feed::{Batch, TruthSample};
use crate::latency::Latency;
use crate::limits::{HISTORY, HISTORY_POINTS, SECOND};
use crate::model::{Frame, Hello, ParameterRow, RecordingNow, RecordingRow, SourceRow, State, seconds_of};
use crate::state::Latest;
use crate::thread::Facts;
use crate::token::Token;
use crate::views::{Keep, Pace, Setting, Told, VIEWS, View};

/// So many kinds of records are counted apart; a robot has about a dozen.
const MOST_TALLIES: usize = 512;

/// How often which sensor's observations had which fate.
pub(crate) type Tallies = BTreeMap<(SensorId, &'static str, &'static str), u64>;

/// Everything that is known.
pub(crate) struct Hub {
    facts: Facts,
    needs_token: bool,
    views: Vec<Box<dyn View>>,
    latest: Latest,
    sources: BTreeSet<SourceRow>,
    /// The file that is being recorded into.
    pub(crate) recording: Option<String>,
    pub(crate) tallies: Tallies,
    pub(crate) links: BTreeMap<LinkId, LinkHealth>,
    pub(crate) latency: Latency,
    next_second: Stamp<HostClock>,
}

impl Hub {
    /// With a token, readers need it.
    pub(crate) fn new(facts: Facts, token: Option<&Token>) -> Self {
        let setting =
            Setting { links: facts.links.clone(), keep: Keep::Latest { span: HISTORY, most: HISTORY_POINTS } };
        Self {
            views: VIEWS.iter().map(|entry| (entry.build)(&setting)).collect(),
            facts,
            needs_token: token.is_some(),
            latest: Latest::default(),
            sources: BTreeSet::new(),
            recording: None,
            tallies: BTreeMap::new(),
            links: BTreeMap::new(),
            latency: Latency::default(),
            next_second: Stamp::ZERO,
        }
    }

    /// Takes what an input has led to.
    pub(crate) fn take(&mut self, batch: &Batch) {
        for event in batch.events.iter().filter(|event| event.is_for_viewers()) {
            self.count(event, batch);
            self.tell(batch.now, Told::Event(event));
        }
        if let Some(standing) = &batch.standing {
            self.recording.clone_from(&standing.recording);
            if let (Some(facts), Some(now)) = (&mut self.facts.simulator, &standing.simulator) {
                facts.steering.clone_from(&now.steering);
                facts.link_profile.clone_from(&now.link_profile);
            }
            self.tell(batch.now, Told::Standing(standing));
        }
    }

    /// Takes where the simulated robot was.
    pub(crate) fn take_truth(&mut self, sample: &TruthSample) {
        self.tell(sample.now, Told::Truth(sample));
    }

    /// The message with what is new; `None` if nothing is. `recording` looks at the file that is being recorded into.
    pub(crate) fn news(
        &mut self,
        now: Stamp<HostClock>,
        recording: impl FnOnce(&str) -> RecordingNow,
    ) -> Option<Frame> {
        let pace = if now >= self.next_second { Pace::Second } else { Pace::News };
        let mut frame = Frame { now_s: seconds_of(now), ..Frame::default() };
        for view in &mut self.views {
            view.add_news(&mut frame, pace);
        }
        if pace == Pace::Second {
            self.next_second = now + SECOND;
            frame.recording = Some(self.recording.as_deref().map(recording));
        }
        self.latest.take(&frame);
        (!frame.is_empty()).then_some(frame)
    }

    /// The first message for a new reader.
    pub(crate) fn hello(&self, recordings: Vec<RecordingRow>) -> Hello {
        let mut history = Frame { now_s: self.latest.now_s(), ..Frame::default() };
        for view in &self.views {
            view.add_history(&mut history);
        }
        Hello {
            version: self.facts.version.clone(),
            now_s: self.latest.now_s(),
            needs_token: self.needs_token,
            simulator: self.facts.simulator.clone(),
            sources: self.sources(),
            parameters: self.parameters(),
            robots: self.robots(),
            recordings,
            history,
        }
    }

    /// The latest of everything.
    pub(crate) fn state(&self, counts: &Counts) -> State {
        self.latest.state(self.latency.row(), counts, self.latency.count)
    }

    /// Sensors that were heard.
    pub(crate) fn sources(&self) -> Vec<SourceRow> {
        let off = self.latest.switched_off();
        let rows = self.sources.iter().map(|row| SourceRow { is_used: !off.contains(&row.id), ..row.clone() });
        rows.collect()
    }

    /// Robots that were heard.
    pub(crate) fn robots(&self) -> Vec<String> {
        self.latest.robots()
    }

    /// Every tunable as it stands.
    pub(crate) fn parameters(&self) -> Vec<ParameterRow> {
        let standing = self.latest.parameters();
        let rows = self.facts.parameters.iter().map(|row| {
            let now = standing.iter().find(|value| value.name == row.name);
            ParameterRow { value: now.map_or(row.value, |now| now.value), ..row.clone() }
        });
        rows.collect()
    }

    /// Points and robots that found no room.
    pub(crate) fn dropped(&self) -> u64 {
        self.views.iter().map(|view| view.dropped()).sum()
    }

    fn tell(&mut self, now: Stamp<HostClock>, told: Told<'_>) {
        for view in &mut self.views {
            view.take(now, told);
        }
    }

    fn count(&mut self, event: &Event, batch: &Batch) {
        match event {
            Event::Fused { record, .. } => {
                self.tally(record.sensor, record.kind, record.verdict);
            }
            Event::Estimated { .. } => self.latency.take(batch.took),
            Event::Health { link, health, .. } => {
                self.links.insert(*link, *health);
            }
            Event::RobotSeen { .. }
            | Event::RobotLost { .. }
            | Event::BrickRestarted { .. }
            | Event::Observed { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Link { .. }
            | Event::Defect { .. }
            | Event::Text { .. } => {}
        }
    }

    fn tally(&mut self, sensor: SensorId, kind: &'static str, verdict: Verdict) {
        let key = (sensor, kind, verdict.reason());
        if self.tallies.len() >= MOST_TALLIES && !self.tallies.contains_key(&key) {
            return;
        }
        *self.tallies.entry(key).or_insert(0) += 1;
        if self.sources.len() < MOST_TALLIES {
            self.sources.insert(SourceRow {
                id: sensor.0,
                name: sensor.name().to_owned(),
                kind: kind.to_owned(),
                is_used: true,
            });
        }
    }
}

#[cfg(test)]
mod tests;

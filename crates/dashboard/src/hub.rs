//! The hub: the state of all views.
//!
//! A value without clock and socket; the hub task owns it and polls it for updates fifty times a second.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_telemetry::{Event, FusionOutcome, HostClock, LinkHealth, LinkId, RobotId, SensorId, Timestamp};

use crate::api::StationInfo;
use crate::counters::{ServerCounter, ServerCounters};
use crate::feed::{EventBatch, SimulatedTruth};
use crate::latency::LatencyHistogram;
use crate::limits::{HISTORY_DURATION, MAX_HISTORY_POINTS, SECOND};
use crate::model::{
    Counters, Frame, Hello, LatencyRow, ParameterRow, ParameterValue, RecordingNow, RecordingRow, RobotRow, RobotState,
    SourceRow, State, TruthPoint, seconds_of,
};
use crate::token::AccessToken;
use crate::views::{FrameContent, MAX_ROBOTS, RetentionPolicy, VIEWS, View, ViewConfig, ViewInput};

/// Most kinds of records that are counted; a robot has about a dozen.
const MAX_OUTCOME_COUNTS: usize = 512;

pub(crate) type OutcomeCounts = BTreeMap<(SensorId, &'static str, &'static str), u64>;

pub(crate) struct Hub {
    info: StationInfo,
    needs_token: bool,
    views: Vec<Box<dyn View>>,
    latest: LatestState,
    sources: BTreeSet<SourceRow>,
    pub(crate) recording: Option<String>,
    pub(crate) outcome_counts: OutcomeCounts,
    pub(crate) estimate_counts: BTreeMap<RobotId, u64>,
    pub(crate) links: BTreeMap<LinkId, LinkHealth>,
    pub(crate) latency: LatencyHistogram,
    next_second: Timestamp<HostClock>,
}

impl Hub {
    /// Readers need the token, if there is one.
    pub(crate) fn new(info: StationInfo, token: Option<&AccessToken>) -> Self {
        let setting = ViewConfig {
            links: info.links.clone(),
            retention: RetentionPolicy::SlidingWindow { duration: HISTORY_DURATION, max_points: MAX_HISTORY_POINTS },
        };
        Self {
            views: VIEWS.iter().map(|entry| (entry.build)(&setting)).collect(),
            info,
            needs_token: token.is_some(),
            latest: LatestState::default(),
            sources: BTreeSet::new(),
            recording: None,
            outcome_counts: BTreeMap::new(),
            estimate_counts: BTreeMap::new(),
            links: BTreeMap::new(),
            latency: LatencyHistogram::default(),
            next_second: Timestamp::ZERO,
        }
    }

    pub(crate) fn push_batch(&mut self, batch: &EventBatch) {
        for event in batch.events.iter().filter(|event| event.is_for_viewers()) {
            self.count_event(event, batch);
            self.dispatch(batch.now, ViewInput::Event(event));
        }
        if let Some(status) = &batch.status {
            self.recording.clone_from(&status.recording);
            if let (Some(facts), Some(now)) = (&mut self.info.simulator, &status.simulator) {
                facts.steering.clone_from(&now.steering);
                facts.link_profile.clone_from(&now.link_profile);
            }
            self.dispatch(batch.now, ViewInput::Status(status));
        }
    }

    pub(crate) fn push_truth(&mut self, sample: &SimulatedTruth) {
        self.dispatch(sample.now, ViewInput::Truth(sample));
    }

    /// The message with the updates; `None` if there are none. `recording` gets the size of the current recording.
    pub(crate) fn next_frame(
        &mut self,
        now: Timestamp<HostClock>,
        recording: impl FnOnce(&str) -> RecordingNow,
    ) -> Option<Frame> {
        let content = if now >= self.next_second { FrameContent::DeltaAndSummary } else { FrameContent::Delta };
        let mut frame = Frame { now_s: seconds_of(now), ..Frame::default() };
        for view in &mut self.views {
            view.add_updates(&mut frame, content);
        }
        if content == FrameContent::DeltaAndSummary {
            self.next_second = now + SECOND;
            frame.recording = Some(self.recording.as_deref().map(recording));
        }
        self.latest.apply(&frame);
        (!frame.is_empty()).then_some(frame)
    }

    pub(crate) fn hello(&self, recordings: Vec<RecordingRow>) -> Hello {
        let mut history = Frame { now_s: self.latest.now_s(), ..Frame::default() };
        for view in &self.views {
            view.add_history(&mut history);
        }
        Hello {
            version: self.info.version.clone(),
            now_s: self.latest.now_s(),
            needs_token: self.needs_token,
            simulator: self.info.simulator.clone(),
            sources: self.sources(),
            parameters: self.parameters(),
            robots: self.robots(),
            recordings,
            history,
        }
    }

    pub(crate) fn state(&self, counts: &ServerCounters) -> State {
        self.latest.state(self.latency.row(), counts, self.latency.count)
    }

    pub(crate) fn sources(&self) -> Vec<SourceRow> {
        let off = self.latest.switched_off();
        let rows = self.sources.iter().map(|row| SourceRow { is_used: !off.contains(&row.id), ..row.clone() });
        rows.collect()
    }

    pub(crate) fn robots(&self) -> Vec<RobotRow> {
        self.latest.robots()
    }

    pub(crate) fn parameters(&self) -> Vec<ParameterRow> {
        let values = self.latest.parameters();
        let rows = self.info.parameters.iter().map(|row| {
            let now = values.iter().find(|value| value.name == row.name);
            ParameterRow { value: now.map_or(row.value, |now| now.value), ..row.clone() }
        });
        rows.collect()
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.views.iter().map(|view| view.dropped()).sum()
    }

    fn dispatch(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        for view in &mut self.views {
            view.observe(now, input);
        }
    }

    fn count_event(&mut self, event: &Event, batch: &EventBatch) {
        match event {
            Event::ObservationFused { record, .. } => {
                self.count_outcome(record.sensor, record.kind, record.outcome);
            }
            Event::EstimateUpdated { robot, .. } => {
                self.latency.record(batch.latency);
                if self.estimate_counts.len() < MAX_ROBOTS || self.estimate_counts.contains_key(robot) {
                    *self.estimate_counts.entry(*robot).or_insert(0) += 1;
                }
            }
            Event::Health { link, health, .. } => {
                self.links.insert(*link, *health);
            }
            Event::RobotDetected { .. }
            | Event::RobotNamed { .. }
            | Event::RobotLost { .. }
            | Event::BrickRestarted { .. }
            | Event::ObservationAligned { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Link { .. }
            | Event::ReceiveError { .. }
            | Event::Text { .. } => {}
        }
    }

    fn count_outcome(&mut self, sensor: SensorId, kind: &'static str, verdict: FusionOutcome) {
        let key = (sensor, kind, verdict.reason());
        if self.outcome_counts.len() >= MAX_OUTCOME_COUNTS && !self.outcome_counts.contains_key(&key) {
            return;
        }
        *self.outcome_counts.entry(key).or_insert(0) += 1;
        if self.sources.len() < MAX_OUTCOME_COUNTS {
            self.sources.insert(SourceRow {
                id: sensor.0,
                name: sensor.name().to_owned(),
                kind: kind.to_owned(),
                is_used: true,
            });
        }
    }
}

/// The latest value of each kind, collected from the messages, so that they always agree with them.
#[derive(Clone, Debug, Default)]
struct LatestState {
    state: State,
    parameters: Vec<ParameterValue>,
    switched_off: Vec<u8>,
}

impl LatestState {
    fn apply(&mut self, frame: &Frame) {
        let state = &mut self.state;
        state.now_s = frame.now_s;
        for robot in &frame.robots {
            let known = robot_state(state, &robot.id);
            if let Some(name) = &robot.name {
                known.name = Some(name.clone());
            }
            if let Some(estimate) = robot.estimates.last() {
                known.estimate = Some(estimate.clone());
                known.lost_t_s = None;
            }
            if robot.lost_t_s.is_some() {
                known.lost_t_s = robot.lost_t_s;
            }
            if let Some(errors) = &robot.errors {
                known.errors = Some(errors.clone());
            }
        }
        for truth in &frame.truth {
            apply_truth(state, truth);
        }
        if let Some(errors) = &frame.errors {
            state.errors = Some(errors.clone());
        }
        if let Some(links) = &frame.links {
            state.links.clone_from(links);
        }
        if let Some(clock) = &frame.clock {
            state.clock = Some(clock.clone());
        }
        if let Some(recording) = &frame.recording {
            state.recording.clone_from(recording);
        }
        if let Some(parameters) = &frame.parameters {
            self.parameters.clone_from(parameters);
        }
        if let Some(off) = &frame.switched_off {
            self.switched_off.clone_from(off);
        }
    }

    const fn now_s(&self) -> f64 {
        self.state.now_s
    }

    fn parameters(&self) -> &[ParameterValue] {
        &self.parameters
    }

    fn switched_off(&self) -> &[u8] {
        &self.switched_off
    }

    fn robots(&self) -> Vec<RobotRow> {
        let robots = self.state.robots.iter();
        robots.map(|robot| RobotRow { id: robot.id.clone(), name: robot.name.clone() }).collect()
    }

    fn state(&self, latency: LatencyRow, counts: &ServerCounters, estimates: u64) -> State {
        State {
            latency,
            counters: Counters {
                estimates,
                events_dropped: counts.value(ServerCounter::EventsDropped),
                clients: counts.value(ServerCounter::Clients),
                frames_missed: counts.value(ServerCounter::FramesMissed),
                refused: counts.refused(),
                commands: counts.value(ServerCounter::Commands),
            },
            ..self.state.clone()
        }
    }
}

/// Created if missing.
fn robot_state<'a>(state: &'a mut State, id: &str) -> &'a mut RobotState {
    let known = state.robots.iter().position(|robot| robot.id == id);
    let index = known.unwrap_or_else(|| {
        state.robots.push(RobotState { id: id.to_owned(), ..RobotState::default() });
        state.robots.len() - 1
    });
    &mut state.robots[index]
}

/// A sample without a robot belongs to the first one.
fn apply_truth(state: &mut State, truth: &TruthPoint) {
    let robot = match &truth.robot {
        Some(id) => state.robots.iter_mut().find(|robot| robot.id == *id),
        None => state.robots.first_mut(),
    };
    if let Some(robot) = robot {
        robot.truth = Some(truth.clone());
    }
    if state.truth.as_ref().is_none_or(|known| known.robot == truth.robot) {
        state.truth = Some(truth.clone());
    }
}

#[cfg(test)]
mod tests;

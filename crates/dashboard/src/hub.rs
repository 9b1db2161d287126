//! The hub: the state of all views.
//!
//! A value without clock and socket; the hub task owns it and polls it for updates fifty times a second.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_telemetry::{
    Event, FusionOutcome, HostClock, LinkHealth, LinkId, RobotId, SensorId, TimeDelta, Timestamp,
};

use crate::api::{DeadReckoningBuilder, StationInfo};
use crate::counters::{ServerCounter, ServerCounters};
use crate::feed::{EventBatch, SimulatedTruth, StationStatus};
use crate::limits::{HISTORY_DURATION, MAX_HISTORY_POINTS, MAX_REPLAY_POINTS, SECOND};
use crate::model::{
    Counters, Frame, Hello, LatencyRow, ParameterRow, ParameterValue, RecordingNow, RecordingRow, RobotRow, RobotState,
    SourceRow, State, TruthPoint, seconds_of,
};
use crate::token::{AccessRole, TokenTable};
use crate::views::{FrameContent, MAX_ROBOTS, RetentionPolicy, ViewConfig, ViewInput, ViewSet};

/// Most kinds of records that are counted; a robot has about a dozen.
const MAX_OUTCOME_COUNTS: usize = 512;

/// Number of estimates for percentiles: twenty seconds of a usual brick.
const MAX_LATENCY_SAMPLES: usize = 2_048;
/// Upper bounds of the buckets in `/metrics`, in microseconds, in steps of about three; a quiet station needs some
/// ten.
pub(crate) const BUCKETS_MICROS: [i64; 11] =
    [10, 30, 100, 300, 1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000];

pub(crate) type OutcomeCounts = BTreeMap<(SensorId, &'static str, &'static str), u64>;

pub(crate) struct Hub {
    info: StationInfo,
    needs_token: bool,
    /// The name of the fleet, if there is one.
    fleet: Option<String>,
    views: ViewSet,
    latest: LatestState,
    sources: BTreeSet<SourceRow>,
    pub(crate) recording: Option<String>,
    pub(crate) outcome_counts: OutcomeCounts,
    pub(crate) estimate_counts: BTreeMap<RobotId, u64>,
    pub(crate) loop_stalls: u64,
    pub(crate) links: BTreeMap<LinkId, LinkHealth>,
    pub(crate) latency: LatencyHistogram,
    next_second: Timestamp<HostClock>,
}

impl Hub {
    /// Readers need one of the tokens, if there are any.
    pub(crate) fn new(info: StationInfo, tokens: Option<&TokenTable>, fleet: Option<String>) -> Self {
        let retention = RetentionPolicy::SlidingWindow { duration: HISTORY_DURATION, max_points: MAX_HISTORY_POINTS };
        Self {
            views: ViewSet::new(&ViewConfig {
                links: info.links.clone(),
                retention,
                dead_reckoning: info.dead_reckoning.clone(),
            }),
            info,
            needs_token: tokens.is_some(),
            fleet,
            latest: LatestState::default(),
            sources: BTreeSet::new(),
            recording: None,
            outcome_counts: BTreeMap::new(),
            estimate_counts: BTreeMap::new(),
            loop_stalls: 0,
            links: BTreeMap::new(),
            latency: LatencyHistogram::default(),
            next_second: Timestamp::ZERO,
        }
    }

    pub(crate) fn push_batch(&mut self, batch: &EventBatch) {
        // Observations that nobody is shown move the odometry.
        let is_used = |event: &&Event| event.is_for_viewers() || matches!(event, Event::ObservationAligned { .. });
        for event in batch.events.iter().filter(is_used) {
            self.count_event(event, batch);
            self.views.observe(batch.now, ViewInput::Event(event));
        }
        if let Some(status) = &batch.status {
            self.recording.clone_from(&status.recording);
            self.loop_stalls = status.loop_stalls;
            if let (Some(facts), Some(now)) = (&mut self.info.simulator, &status.simulator) {
                facts.steering.clone_from(&now.steering);
                facts.link_profile.clone_from(&now.link_profile);
            }
            self.views.observe(batch.now, ViewInput::Status(status));
        }
    }

    pub(crate) fn push_truth(&mut self, sample: &SimulatedTruth) {
        self.views.observe(sample.now, ViewInput::Truth(sample));
    }

    /// The message with the updates; `None` if there are none. `recording` gets the size of the current recording.
    pub(crate) fn next_frame(
        &mut self,
        now: Timestamp<HostClock>,
        recording: impl FnOnce(&str) -> RecordingNow,
    ) -> Option<Frame> {
        let content = if now >= self.next_second { FrameContent::DeltaAndSummary } else { FrameContent::Delta };
        let mut frame = self.views.updates(seconds_of(now), content);
        if content == FrameContent::DeltaAndSummary {
            self.next_second = now + SECOND;
            frame.recording = Some(self.recording.as_deref().map(recording));
        }
        self.latest.apply(&frame);
        (!frame.is_empty()).then_some(frame)
    }

    pub(crate) fn hello(&self, recordings: Vec<RecordingRow>, role: AccessRole) -> Hello {
        let now_s = self.latest.state.now_s;
        Hello {
            version: self.info.version.clone(),
            now_s,
            needs_token: self.needs_token,
            can_command: role == AccessRole::Operator,
            simulator: self.info.simulator.clone(),
            fleet: self.fleet.clone(),
            arena: self.info.arena.clone(),
            sources: self.sources(),
            parameters: self.parameters(),
            robots: self.robots(),
            recordings,
            history: self.views.history(now_s),
        }
    }

    pub(crate) fn state(&self, counts: &ServerCounters) -> State {
        State {
            latency: self.latency.row(),
            counters: Counters {
                estimates: self.latency.count,
                events_dropped: counts.value(ServerCounter::EventsDropped),
                clients: counts.value(ServerCounter::Clients),
                frames_missed: counts.value(ServerCounter::FramesMissed),
                refused: counts.refused(),
                commands: counts.value(ServerCounter::Commands),
            },
            ..self.latest.state.clone()
        }
    }

    pub(crate) fn sources(&self) -> Vec<SourceRow> {
        let off = &self.latest.switched_off;
        let rows = self.sources.iter().map(|row| SourceRow { is_used: !off.contains(&row.id), ..row.clone() });
        rows.collect()
    }

    pub(crate) fn robots(&self) -> Vec<RobotRow> {
        let robots = self.latest.state.robots.iter();
        robots.map(|robot| RobotRow { id: robot.id.clone(), name: robot.name.clone() }).collect()
    }

    pub(crate) fn parameters(&self) -> Vec<ParameterRow> {
        let values = &self.latest.parameters;
        let rows = self.info.parameters.iter().map(|row| {
            let now = values.iter().find(|value| value.name == row.name);
            ParameterRow { value: now.map_or(row.value, |now| now.value), ..row.clone() }
        });
        rows.collect()
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.views.dropped()
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
            | Event::ObservationCompared { .. }
            | Event::EstimateCompared { .. }
            | Event::QuantityUpdated { .. }
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
            if !robot.estimates.is_empty() || robot.quantities.iter().any(|point| point.name.is_empty()) {
                known.lost_t_s = None;
            }
            for point in &robot.quantities {
                match known.quantities.iter_mut().find(|known| known.name == point.name) {
                    Some(known) => known.clone_from(point),
                    None => known.quantities.push(point.clone()),
                }
            }
            update(&mut known.name, robot.name.as_ref());
            update(&mut known.estimate, robot.estimates.last());
            update(&mut known.lost_t_s, robot.lost_t_s.as_ref());
            update(&mut known.errors, robot.errors.as_ref());
        }
        for truth in &frame.truth {
            apply_truth(state, truth);
        }
        update(&mut state.errors, frame.errors.as_ref());
        update(&mut state.clock, frame.clock.as_ref());
        if let Some(links) = &frame.links {
            state.links.clone_from(links);
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
}

fn update<T: Clone>(known: &mut Option<T>, news: Option<&T>) {
    if news.is_some() {
        *known = news.cloned();
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

/// The latency of estimates inside the station.
#[derive(Clone, Debug, Default)]
pub(crate) struct LatencyHistogram {
    last: VecDeque<TimeDelta>,
    buckets: [u64; BUCKETS_MICROS.len()],
    pub(crate) count: u64,
    pub(crate) sum: TimeDelta,
}

impl LatencyHistogram {
    pub(crate) fn record(&mut self, took: TimeDelta) {
        if self.last.len() >= MAX_LATENCY_SAMPLES {
            self.last.pop_front();
        }
        self.last.push_back(took);
        self.count += 1;
        self.sum += took;
        for (bucket, end) in self.buckets.iter_mut().zip(BUCKETS_MICROS) {
            *bucket += u64::from(took <= TimeDelta::from_micros(end));
        }
    }

    /// Upper bound in microseconds and cumulative count.
    pub(crate) fn buckets(&self) -> impl Iterator<Item = (i64, u64)> {
        BUCKETS_MICROS.into_iter().zip(self.buckets)
    }

    pub(crate) fn row(&self) -> LatencyRow {
        let mut sorted: Vec<TimeDelta> = self.last.iter().copied().collect();
        sorted.sort_unstable();
        let at = |percent: usize| {
            let rank = sorted.len().saturating_sub(1) * percent / 100;
            sorted.get(rank).map_or(f64::NAN, |delay| delay.as_millis_f64())
        };
        LatencyRow { estimates: sorted.len() as u64, p50_ms: at(50).into(), p99_ms: at(99).into() }
    }
}

/// The views of a whole session.
pub struct SessionViews {
    views: ViewSet,
    last: Timestamp<HostClock>,
}

impl SessionViews {
    pub fn new(links: Vec<String>, dead_reckoning: Option<DeadReckoningBuilder>) -> Self {
        let retention = RetentionPolicy::WholeSession { max_points: MAX_REPLAY_POINTS };
        Self { views: ViewSet::new(&ViewConfig { links, retention, dead_reckoning }), last: Timestamp::ZERO }
    }

    pub fn push_event(&mut self, now: Timestamp<HostClock>, event: &Event) {
        self.last = self.last.max(now);
        self.views.observe(now, ViewInput::Event(event));
    }

    pub fn push_status(&mut self, status: &StationStatus) {
        self.views.observe(self.last, ViewInput::Status(status));
    }

    pub fn push_truth(&mut self, sample: &SimulatedTruth) {
        self.views.observe(sample.now, ViewInput::Truth(sample));
    }

    pub fn history(&self) -> Frame {
        self.views.history(seconds_of(self.last))
    }
}

#[cfg(test)]
mod tests;

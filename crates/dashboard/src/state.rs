//! The latest values, collected from the messages, so that they always agree with them.

use crate::counters::{ServerCounter, ServerCounters};
use crate::model::{Counters, Frame, LatencyRow, ParameterValue, RobotState, State};

/// The latest value of each kind.
#[derive(Clone, Debug, Default)]
pub(crate) struct LatestState {
    state: State,
    parameters: Vec<ParameterValue>,
    switched_off: Vec<u8>,
}

impl LatestState {
    /// Applies a message.
    pub(crate) fn apply(&mut self, frame: &Frame) {
        let state = &mut self.state;
        state.now_s = frame.now_s;
        for robot in &frame.robots {
            let known = state.robots.iter_mut().find(|known| known.id == robot.id);
            let estimate = robot.estimates.last().cloned();
            match known {
                Some(known) => known.estimate = estimate.or(known.estimate.take()),
                None => state.robots.push(RobotState { id: robot.id.clone(), estimate }),
            }
        }
        if let Some(truth) = frame.truth.last() {
            state.truth = Some(truth.clone());
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

    pub(crate) const fn now_s(&self) -> f64 {
        self.state.now_s
    }

    pub(crate) fn parameters(&self) -> &[ParameterValue] {
        &self.parameters
    }

    pub(crate) fn switched_off(&self) -> &[u8] {
        &self.switched_off
    }

    pub(crate) fn robots(&self) -> Vec<String> {
        let robots = self.state.robots.iter();
        robots.map(|robot| robot.id.clone()).collect()
    }

    /// The latest values, with the counters.
    pub(crate) fn state(&self, latency: LatencyRow, counts: &ServerCounters, estimates: u64) -> State {
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

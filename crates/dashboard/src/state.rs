//! The latest of everything, gathered from the messages, so that it never contradicts them.

use crate::counts::{Count, Counts};
use crate::model::{Counters, Frame, LatencyRow, ParameterValue, RobotState, State};

/// What the messages said last.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latest {
    state: State,
    parameters: Vec<ParameterValue>,
    switched_off: Vec<u8>,
}

impl Latest {
    /// Takes note of a message.
    pub(crate) fn take(&mut self, frame: &Frame) {
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

    /// All of it, with what was counted.
    pub(crate) fn state(&self, latency: LatencyRow, counts: &Counts, estimates: u64) -> State {
        State {
            latency,
            counters: Counters {
                estimates,
                events_dropped: counts.of(Count::EventsDropped),
                clients: counts.of(Count::Clients),
                frames_missed: counts.of(Count::FramesMissed),
                refused: counts.refused(),
                commands: counts.of(Count::Commands),
            },
            ..self.state.clone()
        }
    }
}

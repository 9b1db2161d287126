//! The latest values, collected from the messages, so that they always agree with them.

use crate::counters::{ServerCounter, ServerCounters};
use crate::model::{Counters, Frame, LatencyRow, ParameterValue, RobotRow, RobotState, State, TruthPoint};

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

    pub(crate) const fn now_s(&self) -> f64 {
        self.state.now_s
    }

    pub(crate) fn parameters(&self) -> &[ParameterValue] {
        &self.parameters
    }

    pub(crate) fn switched_off(&self) -> &[u8] {
        &self.switched_off
    }

    pub(crate) fn robots(&self) -> Vec<RobotRow> {
        let robots = self.state.robots.iter();
        robots.map(|robot| RobotRow { id: robot.id.clone(), name: robot.name.clone() }).collect()
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

/// The state of one robot, made if there is none yet.
fn robot_state<'a>(state: &'a mut State, id: &str) -> &'a mut RobotState {
    let known = state.robots.iter().position(|robot| robot.id == id);
    let index = known.unwrap_or_else(|| {
        state.robots.push(RobotState { id: id.to_owned(), ..RobotState::default() });
        state.robots.len() - 1
    });
    &mut state.robots[index]
}

/// A sample without a robot is of the first one.
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

//! Dead reckoning by the wheels alone, as a brick computes it: midpoint rule (paper 1, equation 13), nominal geometry,
//! no gyro and no fix. It is there to be compared with.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, FusionOutcome, FusionRecord, Heading, Meters, Observation, Pose, ResetCause,
    StartPose, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use crate::filter::{Filter, FilterCommand, FilterConfig};
use crate::models::differential_drive::{body_step, propagate_pose, step_noise};
use crate::motion::{InsertOutcome, MotionReading, MotionTrack, SavedTrack};
use crate::saved::{self, RestoreError, covariance, finite};
use crate::tracking::{PublishedState, TrackingStatus, with_speed_variances};
use crate::validation::{self, RESTART_HEADING_SIGMA_RAD, RESTART_POSITION_SIGMA_M};

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct DeadReckonedState {
    stamp: Option<Timestamp<BrickClock>>,
    #[serde(deserialize_with = "finite")]
    pose: Pose<Arena>,
    #[serde(deserialize_with = "covariance")]
    covariance: Matrix3<f64>,
    #[serde(deserialize_with = "finite")]
    forward_m_per_s: f64,
    #[serde(deserialize_with = "finite")]
    turn_rad_per_s: f64,
}

impl DeadReckonedState {
    fn at_start(start: Option<StartPose>) -> Self {
        let start = start.unwrap_or_else(unplaced);
        Self {
            stamp: None,
            pose: start.pose,
            covariance: diagonal_pose_covariance(start.position_sigma_m, start.heading_sigma_rad),
            forward_m_per_s: 0.0,
            turn_rad_per_s: 0.0,
        }
    }
}

pub struct OdometryFilter {
    config: FilterConfig,
    track: MotionTrack,
    /// Oldest first, never empty: one entry per motion observation within the history.
    states: VecDeque<DeadReckonedState>,
    /// The pose was given, by the configuration or by a person.
    has_pose: bool,
    status: TrackingStatus,
}

/// An odometry filter without its configuration.
#[derive(Serialize, Deserialize)]
struct SavedOdometry {
    track: SavedTrack,
    states: VecDeque<DeadReckonedState>,
    has_pose: bool,
    status: TrackingStatus,
}

impl OdometryFilter {
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            config: config.clone(),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            states: VecDeque::from([DeadReckonedState::at_start(config.start)]),
            has_pose: config.start.is_some(),
            status: TrackingStatus::default(),
        }
    }

    fn last(&self) -> DeadReckonedState {
        self.states.back().copied().unwrap_or_else(|| DeadReckonedState::at_start(None))
    }

    /// Propagates an estimate by the wheels' motion; where none is known the robot rests.
    fn propagate(&self, from: &DeadReckonedState, to: Timestamp<BrickClock>) -> DeadReckonedState {
        let mut next = *from;
        next.stamp = Some(to);
        let Some(start) = from.stamp else { return next };
        let dt_s = (to - start).as_secs_f64();
        if dt_s <= 0.0 {
            return next;
        }
        let travel = self.track.travel_between(start, to);
        let step = body_step(travel, &self.config.geometry);
        let noise = step_noise(travel, &self.config.geometry, &self.config.noise);
        let pose = Vector3::new(from.pose.x.0, from.pose.y.0, from.pose.heading.rad());
        let (pose, covariance) = propagate_pose(&pose, &from.covariance, step, &noise);
        next.pose = Pose::new(Meters(pose[0]), Meters(pose[1]), Heading::from_rad(pose[2]));
        next.covariance = covariance;
        next.forward_m_per_s = step.forward_m / dt_s;
        next.turn_rad_per_s = step.turn_rad / dt_s;
        next
    }

    fn place(&mut self, start: &StartPose, cause: ResetCause) {
        let last = self.last();
        self.states.clear();
        self.states.push_back(DeadReckonedState { stamp: last.stamp, ..DeadReckonedState::at_start(Some(*start)) });
        self.has_pose = cause != ResetCause::Discarded;
        self.status.record_jump(cause, last.pose, start.pose);
    }

    fn insert_motion(&mut self, stamp: Timestamp<BrickClock>, reading: &MotionReading) -> FusionOutcome {
        // What lies before a pose that was set cannot change it.
        let oldest = self.states.front().and_then(|state| state.stamp);
        if oldest.is_some_and(|oldest| stamp < oldest) {
            return FusionOutcome::TooOld;
        }
        let added = self.track.insert(stamp, reading);
        if let InsertOutcome::Inserted(_) | InsertOutcome::Rebased(_) = added {
            self.recompute_from(stamp);
        }
        validation::fusion_outcome(added)
    }

    /// Recomputes the estimates that follow a late reading; in place, because a step must not allocate.
    fn recompute_from(&mut self, stamp: Timestamp<BrickClock>) {
        // The oldest estimate is the start, and stays.
        let first_later = self.states.partition_point(|state| state.stamp <= Some(stamp)).max(1);
        let mut state = self.states[first_later - 1];
        let slot = DeadReckonedState { stamp: Some(stamp), ..state };
        self.states.insert(first_later, slot);
        for index in first_later..self.states.len() {
            let at = self.states[index].stamp.unwrap_or(stamp);
            state = self.propagate(&state, at);
            self.states[index] = state;
        }
        let horizon = self.last().stamp.unwrap_or(stamp) - TimeDelta::from_secs_f64(self.config.params.history_s);
        while self.states.get(1).is_some_and(|second| second.stamp <= Some(horizon)) {
            self.states.pop_front();
        }
        self.track.discard_before(horizon);
    }
}

/// At the arena's origin, from which a pose that is not known is counted.
fn unplaced() -> StartPose {
    StartPose { pose: Pose::default(), position_sigma_m: 0.0, heading_sigma_rad: 0.0 }
}

fn diagonal_pose_covariance(position_sigma_m: f64, heading_sigma_rad: f64) -> Matrix3<f64> {
    let position_m2 = position_sigma_m.powi(2);
    let heading_rad2 = heading_sigma_rad.powi(2);
    Matrix3::from_diagonal(&Vector3::new(position_m2, position_m2, heading_rad2))
}

impl Filter for OdometryFilter {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        validation::observe_if_valid(observation, self.latest_time(), self.config.params.history_s, |record| {
            if let Some(reading) = MotionReading::from_observation(&observation.measurement) {
                record.outcome = self.insert_motion(observation.stamp, &reading);
            }
        })
    }

    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        if !validation::is_valid_start(start) {
            return FusionOutcome::Malformed;
        }
        self.place(start, ResetCause::Given);
        FusionOutcome::PoseReset
    }

    fn apply_command(&mut self, adjustment: &FilterCommand) -> FusionOutcome {
        match adjustment {
            FilterCommand::SetParams(params) => {
                self.config.params = *params;
                self.track.set_max_wheel_rad_per_s(params.max_wheel_rad_per_s);
            }
            FilterCommand::ResetPose => {
                self.place(&unplaced(), ResetCause::Discarded);
            }
            // It learns nothing.
            FilterCommand::SetOnlineCalibration(_) | FilterCommand::ResetCalibration => return FusionOutcome::Unused,
        }
        FusionOutcome::Accepted
    }

    fn save(&self) -> Vec<u8> {
        let Self { config: _, track, states, has_pose, status } = self;
        let (track, states) = (track.save(), states.clone());
        saved::to_bytes(&SavedOdometry { track, states, has_pose: *has_pose, status: *status })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        let SavedOdometry { track, states, has_pose, status } = saved::from_bytes(saved)?;
        let is_sound = !states.is_empty() && saved::is_ordered(&states, |state| state.stamp, |one, next| one <= next);
        is_sound.then_some(()).ok_or(RestoreError::Implausible("its states are none, too many, or out of order"))?;
        let fresh = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        *self = Self { config: self.config.clone(), track: fresh.with_saved(track), states, has_pose, status };
        Ok(())
    }

    fn restart_clock(&mut self) {
        let mut last = self.last();
        last.covariance += diagonal_pose_covariance(RESTART_POSITION_SIGMA_M, RESTART_HEADING_SIGMA_RAD);
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.states =
            VecDeque::from([DeadReckonedState { stamp: None, forward_m_per_s: 0.0, turn_rad_per_s: 0.0, ..last }]);
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.last().stamp
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        let index = self.states.partition_point(|state| state.stamp <= Some(stamp));
        let from = self.states.get(index.checked_sub(1)?)?;
        from.stamp?;
        let state = self.propagate(from, stamp);
        let published = PublishedState {
            pose: state.pose,
            speeds: [state.forward_m_per_s, state.turn_rad_per_s],
            covariance: with_speed_variances(&state.covariance, [0.0; 2]),
            has_position: self.has_pose,
            has_heading: self.has_pose,
        };
        let status = TrackingStatus { last_motion: self.latest_time(), ..self.status };
        Some(status.estimate(stamp, &published, self.config.params.fix_timeout_s))
    }
}

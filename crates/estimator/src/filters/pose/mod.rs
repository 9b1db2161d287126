//! The flagship: an EKF with pose, speeds and gyro bias that applies every observation at its own time.
//!
//! The filter keeps its inputs for a few seconds, with states between them. A late observation is put where it belongs,
//! the state before it is restored and what came after is applied again: exactly what would have happened had it come in time.
//! The order of arrival does not matter, bit for bit, as long as nothing is older than the history.
//!
//! Source: docs/maths/pose.md.

mod absolute_update;
pub mod columns;
mod entry;
pub mod motion_update;
pub mod noise_scales;
mod predict;
pub mod propagation;
mod relocalize;
pub mod smoother;
pub mod state;

use std::borrow::Cow;

use posebridge_telemetry::{
    BrickClock, Calibration, Estimate, FusionOutcome, FusionRecord, Observation, ObservationKind, SensorId, StartPose,
    TimeDelta, Timestamp, UncertainValue,
};

use self::entry::{PoseEntry, UpdateKind};
use self::motion_update::UpdateContext;
use self::relocalize::StateCommand;
use self::state::{CAMERA_STATES, CORE_STATES, PoseState, RANGE_STATES};
use crate::filter::{Filter, FilterCommand, FilterConfig};
use crate::history::{FixedLagHistory, ReplayStep};
use crate::motion::{GyroTrack, InsertOutcome, MotionReading, MotionTrack};
use crate::numerics::chi_square::{ChiSquareGates, chi_square_gates};
use crate::observations::accelerometer::WheelAccelerations;
use crate::params::Params;
use crate::validation;

/// A gap in a sensor's readings keeps the history from being discarded for no longer than this.
const MAX_HOLE: TimeDelta = TimeDelta::from_millis(10_000);

/// Builds the pose filter with as many states as the configuration needs.
pub fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let calibration = &config.calibration;
    let is_estimated = |known: UncertainValue| known.sigma > 0.0 || known.value != 0.0;
    let camera = [calibration.fix_delay_s, calibration.tag_forward_m, calibration.tag_left_m];
    let ranges = [
        calibration.beacon_offset_m,
        calibration.beacon_scale,
        calibration.landmark_offset_m,
        calibration.landmark_scale,
    ];
    if ranges.into_iter().any(is_estimated) {
        Box::new(PoseFilter::<RANGE_STATES>::new(config))
    } else if camera.into_iter().any(is_estimated) {
        Box::new(PoseFilter::<CAMERA_STATES>::new(config))
    } else {
        Box::new(PoseFilter::<CORE_STATES>::new(config))
    }
}

/// The pose filter with N states, see [`state`].
pub struct PoseFilter<const N: usize> {
    config: FilterConfig,
    track: MotionTrack,
    gyro: GyroTrack,
    gates: ChiSquareGates,
    history: FixedLagHistory<PoseEntry, PoseState<N>>,
    /// Up to this instant, detected slip has been reported.
    slip_reported_at: Option<Timestamp<BrickClock>>,
}

impl<const N: usize> PoseFilter<N> {
    /// A filter without observations.
    pub fn new(config: &FilterConfig) -> Self {
        Self {
            config: config.clone(),
            track: MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s),
            gyro: GyroTrack::default(),
            gates: chi_square_gates(config.params.gate_probability),
            history: FixedLagHistory::new(PoseState::initial(config)),
            slip_reported_at: None,
        }
    }

    /// Marks the record of a used motion observation if slip was detected since the last marked one. A fix or a late
    /// observation may have revealed it: the first record after it reports it.
    fn report_slip(&mut self, record: &mut FusionRecord, observed: &ObservationKind) {
        let slipped_at = self.state().slipped_at;
        if record.outcome == FusionOutcome::Accepted
            && MotionReading::from_observation(observed).is_some()
            && slipped_at > self.slip_reported_at
        {
            record.outcome = FusionOutcome::Slip;
            self.slip_reported_at = slipped_at;
        }
    }

    pub fn state(&self) -> &PoseState<N> {
        self.history.last_state()
    }

    /// Inserts an entry at its own time and replays everything after `changed_after`.
    fn insert(&mut self, entry: PoseEntry, changed_after: Option<Timestamp<BrickClock>>, record: &mut FusionRecord) {
        let context = UpdateContext { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates };
        let mut replay = self.history.insert(entry, changed_after);
        while let Some(ReplayStep { entry, before, after, is_inserted }) = replay.next() {
            if is_inserted {
                apply_entry(before, after, entry, &context, record);
            } else {
                apply_entry(before, after, entry, &context, &mut scratch_record(entry));
            }
        }
        self.trim_history();
    }

    fn context(&self) -> UpdateContext<'_> {
        UpdateContext { config: &self.config, track: &self.track, gyro: &self.gyro, gates: &self.gates }
    }

    /// The instant before which nothing can change when only observations from `horizon` on are accepted. A late one
    /// changes the interpolation since the reading before it, so each sensor is settled up to its last reading before
    /// the horizon.
    fn settled_until(&self, horizon: Timestamp<BrickClock>) -> Timestamp<BrickClock> {
        [self.track.bisect_last_at_or_before(horizon), self.gyro.bisect_last_at_or_before(horizon)]
            .into_iter()
            .flatten()
            .fold(horizon, Timestamp::min)
            .max(horizon - MAX_HOLE)
    }

    fn trim_history(&mut self) {
        let Some(latest) = self.latest_time() else { return };
        let horizon = latest - TimeDelta::from_secs_f64(self.config.params.history_s);
        if self.history.has_outdated(horizon) {
            self.history.discard_before(self.settled_until(horizon));
        }
        let base = self.history.base();
        if let Some(oldest) = base.stamp {
            // The open gyro window may reach back behind the history.
            let needed = base.window.map_or(oldest, |window| window.start.min(oldest));
            // A late camera shows what was before that.
            self.track.discard_before(oldest - absolute_update::MAX_LOOKBACK);
            self.gyro.discard_before(needed);
        }
    }

    fn observe_valid(&mut self, observation: &Observation, record: &mut FusionRecord) {
        let Some(action) = update_kind(observation) else {
            record.outcome = FusionOutcome::Unused;
            return;
        };
        match action {
            UpdateKind::Absolute(..) | UpdateKind::Accelerations(_) | UpdateKind::Command(_) => {
                self.insert_unless_duplicate(observation, action, record);
            }
            UpdateKind::TurnRate(rate) => {
                let added = self.gyro.insert(observation.stamp, rate);
                self.insert_motion(observation, action, added, record);
            }
            UpdateKind::Motion => {
                if let Some(reading) = MotionReading::from_observation(&observation.measurement) {
                    let added = self.track.insert(observation.stamp, &reading);
                    self.insert_motion(observation, action, added, record);
                }
            }
        }
    }

    fn insert_unless_duplicate(&mut self, observation: &Observation, action: UpdateKind, record: &mut FusionRecord) {
        let entry = pose_entry(observation, action);
        // In the order of time: behind the first that is older there is no other of this instant.
        let entries = self.history.entries().iter().rev();
        let is_repeated =
            entries.take_while(|other| other.stamp >= observation.stamp).any(|other| other.is_duplicate_of(&entry));
        if is_repeated {
            record.outcome = FusionOutcome::Malformed;
            return;
        }
        self.insert(entry, Some(observation.stamp), record);
    }

    fn insert_motion(
        &mut self,
        observation: &Observation,
        action: UpdateKind,
        added: InsertOutcome,
        record: &mut FusionRecord,
    ) {
        record.outcome = validation::fusion_outcome(added);
        let changed_after = match added {
            InsertOutcome::Inserted(before) => before,
            InsertOutcome::Rebased(before) => Some(before),
            InsertOutcome::Superseded | InsertOutcome::Duplicate | InsertOutcome::TooOld => return,
        };
        self.insert(pose_entry(observation, action), changed_after, record);
    }

    /// Applies a command after all observations of its instant, or to the initial state before the first one.
    fn insert_command(&mut self, command: StateCommand) {
        let Some(stamp) = self.latest_time() else {
            self.history.base_mut().apply_command(command, &self.config);
            return;
        };
        let entry = PoseEntry { stamp, sensor: SensorId(0), update: UpdateKind::Command(command) };
        self.insert(entry, None, &mut scratch_record(&entry));
    }

    /// Tunables are read where they are used, except two from which something was computed.
    fn set_params(&mut self, params: &Params) {
        self.config.params = *params;
        self.gates = chi_square_gates(params.gate_probability);
        self.track.set_max_wheel_rad_per_s(params.max_wheel_rad_per_s);
    }
}

impl<const N: usize> Filter for PoseFilter<N> {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        validation::observe_if_valid(observation, self.latest_time(), self.config.params.history_s, |record| {
            record.outcome = FusionOutcome::Accepted;
            self.observe_valid(observation, record);
            self.report_slip(record, &observation.measurement);
        })
    }

    fn set_pose(&mut self, start: &StartPose) -> FusionOutcome {
        if !validation::is_valid_start(start) {
            return FusionOutcome::Malformed;
        }
        self.insert_command(StateCommand::SetPose(*start));
        FusionOutcome::PoseReset
    }

    fn apply_command(&mut self, adjustment: &FilterCommand) -> FusionOutcome {
        match adjustment {
            FilterCommand::SetParams(params) => self.set_params(params),
            FilterCommand::ResetPose => self.insert_command(StateCommand::ResetPose),
            FilterCommand::SetOnlineCalibration(learning) => {
                self.insert_command(StateCommand::SetOnlineCalibration(*learning));
            }
            FilterCommand::ResetCalibration => {
                self.insert_command(StateCommand::ResetCalibration);
            }
        }
        FusionOutcome::Accepted
    }

    fn restart_clock(&mut self) {
        let mut state = *self.state();
        state.restart_clock(&PoseState::initial(&self.config));
        // The stamps of before mean nothing.
        state.slipped_at = None;
        self.slip_reported_at = None;
        self.history.reset(state);
        self.track = MotionTrack::new(self.config.geometry, self.config.params.max_wheel_rad_per_s);
        self.gyro = GyroTrack::default();
    }

    fn calibration(&self) -> Option<Calibration> {
        Some(self.state().calibration(&self.config.calibration))
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        let last = self.history.entries().back();
        last.map(|entry| entry.stamp).or(self.history.base().stamp)
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        let context = self.context();
        let (stored, unapplied) = self.history.state_at_or_before(stamp);
        let mut state = Cow::Borrowed(stored);
        for entry in unapplied {
            let mut after = *state;
            apply_entry(&state, &mut after, entry, &context, &mut scratch_record(entry));
            state = Cow::Owned(after);
        }
        state.stamp.filter(|known_from| *known_from <= stamp)?;
        Some(predict::estimate(&state, stamp, &context))
    }
}

const fn pose_entry(observation: &Observation, action: UpdateKind) -> PoseEntry {
    PoseEntry { stamp: observation.stamp, sensor: observation.sensor, update: action }
}

/// The update by an observation; `None` for a kind that the filter does not use.
fn update_kind(observation: &Observation) -> Option<UpdateKind> {
    match observation.measurement {
        ObservationKind::Fix(_)
        | ObservationKind::Landmark { .. }
        | ObservationKind::BeaconRange { .. }
        | ObservationKind::WallRange(_)
        | ObservationKind::CompassHeading(_) => {
            Some(UpdateKind::Absolute(observation.measurement, observation.stamp_sigma))
        }
        ObservationKind::WheelAccelerations { left, right } => {
            Some(UpdateKind::Accelerations(WheelAccelerations { left_m_per_s2: left.0, right_m_per_s2: right.0 }))
        }
        ObservationKind::TurnRate(rate) => Some(UpdateKind::TurnRate(rate.0)),
        ObservationKind::WheelAngles { .. }
        | ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. } => Some(UpdateKind::Motion),
        ObservationKind::Temperature(_) => None,
    }
}

/// Applies an entry to the state before it; `after` begins as a copy of that.
fn apply_entry<const N: usize>(
    before: &PoseState<N>,
    after: &mut PoseState<N>,
    entry: &PoseEntry,
    context: &UpdateContext<'_>,
    record: &mut FusionRecord,
) {
    apply_update(after, entry, context, record);
    if entry.is_without_effect(record.outcome) {
        *after = before.after_rejection(after);
    }
}

fn apply_update<const N: usize>(
    state: &mut PoseState<N>,
    entry: &PoseEntry,
    context: &UpdateContext<'_>,
    record: &mut FusionRecord,
) {
    let stamp = entry.stamp;
    match entry.update {
        // These observe speeds only: the pose goes on with the next wheel reading.
        UpdateKind::TurnRate(_) | UpdateKind::Accelerations(_) => {
            state.stamp = state.stamp.or(Some(stamp));
            state.predict_speeds_and_bias(stamp, context.config);
        }
        UpdateKind::Motion | UpdateKind::Absolute(..) | UpdateKind::Command(_) => {
            state.advance(stamp, context.track, context.config);
        }
    }
    match entry.update {
        UpdateKind::TurnRate(rate) => motion_update::update_turn_rate(state, rate, context),
        UpdateKind::Accelerations(felt) => motion_update::update_accelerations(state, felt, stamp, context),
        UpdateKind::Motion => motion_update::update_motion(state, stamp, context, record),
        UpdateKind::Absolute(observation, sigma) => {
            absolute_update::update_absolute(state, &observation, sigma, context, record);
        }
        UpdateKind::Command(revision) => state.apply_command(revision, context.config),
    }
}

/// A record for an entry that is applied again, which was reported when it came. Its sensor selects the noise scale.
const fn scratch_record(entry: &PoseEntry) -> FusionRecord {
    validation::blank_record(entry.sensor, entry.stamp)
}

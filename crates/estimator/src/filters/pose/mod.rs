//! The main filter: an EKF with pose, speeds and gyro bias that applies every observation at its own time, by replaying
//! what came after.
//!
//! Source: docs/maths/pose.md.

mod absolute_update;
pub mod context;
mod entry;
pub mod layout;
pub mod motion_update;
pub mod noise_scales;
pub mod propagation;
pub mod ranging;
pub mod recent_ranges;
pub mod recovery;
mod relocalize;
pub mod sightings;
pub mod smoother;
pub mod state;

use std::borrow::Cow;

use nalgebra::{Matrix3, Vector3};
use posebridge_telemetry::{
    BrickClock, Calibration, DriveGeometry, Estimate, FusionOutcome, FusionRecord, MissingObservation, Observation,
    ObservationKind, SensorId, StartPose, TimeDelta, Timestamp,
};
use serde::{Deserialize, Serialize};

use self::absolute_update::MAX_DELAY;
use self::context::UpdateContext;
use self::entry::{PoseEntry, UpdateKind};
use self::layout::{CORE_STATES, FORWARD, HEADING, LARGE_STATES, LEFT, MEDIUM_STATES, SMALL_STATES, StateLayout};
use self::recent_ranges::{BeaconRange, RecentRanges, WINDOWS};
use self::relocalize::StateCommand;
use self::state::{PoseBlock, PoseState, arena_pose};
use crate::filter::{Filter, FilterCommand, FilterConfig};
use crate::history::{FixedLagHistory, SavedHistory};
use crate::models::lie::Se2;
use crate::models::planar_speeds::Acceleration;
use crate::motion::{GyroTrack, InsertOutcome, MotionReading, SavedTrack};
use crate::observations::StateTerm;
use crate::saved::{self, Numbers, RestoreError};
use crate::tracking::PublishedState;
use crate::update::preview_scalar;
use crate::validation;

/// A gap in a sensor's readings keeps the history from being discarded for no longer than this.
const MAX_HOLE: TimeDelta = TimeDelta::from_millis(10_000);

pub fn build(config: &FilterConfig) -> Box<dyn Filter> {
    let states = StateLayout::new(config, LARGE_STATES).states();
    if states <= CORE_STATES {
        Box::new(PoseFilter::<CORE_STATES>::new(config))
    } else if states <= SMALL_STATES {
        Box::new(PoseFilter::<SMALL_STATES>::new(config))
    } else if states <= MEDIUM_STATES {
        Box::new(PoseFilter::<MEDIUM_STATES>::new(config))
    } else {
        Box::new(PoseFilter::<LARGE_STATES>::new(config))
    }
}

pub struct PoseFilter<const N: usize> {
    context: UpdateContext,
    history: FixedLagHistory<PoseEntry, PoseState<N>>,
    /// Up to this instant, detected slip has been reported.
    slip_reported_at: Option<Timestamp<BrickClock>>,
}

/// A pose filter without its configuration.
#[derive(Serialize, Deserialize)]
struct SavedPoseFilter<const N: usize> {
    track: SavedTrack,
    gyro: GyroTrack,
    ranges: RecentRanges,
    history: SavedHistory<PoseEntry, PoseState<N>>,
    slip_reported_at: Option<Timestamp<BrickClock>>,
}

impl<const N: usize> SavedPoseFilter<N> {
    fn check(&self) -> Result<(), RestoreError> {
        let Self { track: _, gyro, ranges, history, slip_reported_at: _ } = self;
        gyro.are_finite().then_some(()).ok_or(RestoreError::Implausible("a rate of its gyro is not finite"))?;
        ranges
            .are_in_order()
            .then_some(())
            .ok_or(RestoreError::Implausible("its ranges are too many, or out of order"))?;
        (history.entries.iter().all(PoseEntry::is_valid))
            .then_some(())
            .ok_or(RestoreError::Implausible("an observation in it has numbers that cannot be"))?;
        let first = history.entries.front().map(|entry| entry.stamp);
        let begins_before = history.base.stamp.is_none_or(|base| first.is_none_or(|first| base <= first));
        begins_before.then_some(()).ok_or(RestoreError::Implausible("its observations are from before its beginning"))
    }
}

impl<const N: usize> PoseFilter<N> {
    pub fn new(config: &FilterConfig) -> Self {
        let context = UpdateContext::new(config, N);
        let history = FixedLagHistory::new(PoseState::initial(config, &context.layout));
        Self { context, history, slip_reported_at: None }
    }

    /// Marks the first record of a used motion observation after slip was detected, which a fix or a late one may
    /// have revealed.
    fn report_slip(&mut self, record: &mut FusionRecord, observed: &ObservationKind) {
        let slipped_at = self.state().slip.map(|slip| slip.until);
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
        let context = &self.context;
        self.history.insert(entry, changed_after, |before, after, entry, is_inserted| {
            if is_inserted {
                apply_entry(before, after, entry, context, record);
            } else {
                apply_entry(before, after, entry, context, &mut scratch_record(entry));
            }
        });
        self.trim_history();
    }

    /// The instant before which nothing can change when only observations from `horizon` on are accepted: a late one
    /// changes the interpolation since the reading before it.
    fn settled_until(&self, horizon: Timestamp<BrickClock>) -> Timestamp<BrickClock> {
        [self.context.track.last_at_or_before(horizon), self.context.gyro.last_at_or_before(horizon)]
            .into_iter()
            .flatten()
            .fold(horizon, Timestamp::min)
            .max(horizon - MAX_HOLE)
    }

    fn trim_history(&mut self) {
        let Some(latest) = self.latest_time() else { return };
        let horizon = latest - TimeDelta::from_secs_f64(self.context.config.params.history_s);
        if self.history.has_outdated(horizon) {
            self.history.discard_before(self.settled_until(horizon));
        }
        let base = self.history.base();
        if let Some(oldest) = base.stamp {
            // The open gyro window may reach back behind the history.
            let needed = base.window.map_or(oldest, |window| window.start.min(oldest));
            // A late camera shows what was before that.
            self.context.track.discard_before(oldest - absolute_update::MAX_LOOKBACK);
            self.context.gyro.discard_before(needed);
            self.context.ranges.discard_before(oldest - WINDOWS[1]);
        }
    }

    fn observe_valid(&mut self, observation: &Observation, record: &mut FusionRecord) {
        let stamp = observation.stamp;
        let Some(update) = update_kind(observation, &self.context.config.geometry) else {
            record.outcome = FusionOutcome::Unused;
            return;
        };
        let entry = PoseEntry { stamp, sensor: observation.sensor, update };
        let added = match update {
            UpdateKind::TurnRate(rate) => self.context.gyro.insert(stamp, rate),
            UpdateKind::Motion(reading) => self.context.track.insert(stamp, &reading),
            UpdateKind::Absolute(..) | UpdateKind::Accelerations(_) | UpdateKind::Command(_) => {
                // In the order of time: behind the first that is older there is no other of this instant.
                let mut recent = self.history.entries().iter().rev().take_while(|other| other.stamp >= stamp);
                let is_repeated = recent.any(|other| other.is_duplicate_of(&entry));
                if is_repeated { InsertOutcome::Duplicate } else { InsertOutcome::Inserted(Some(stamp)) }
            }
        };
        record.outcome = validation::fusion_outcome(added);
        if let (InsertOutcome::Inserted(_), ObservationKind::BeaconRange { id, range }) =
            (added, observation.measurement)
        {
            self.context.ranges.insert(BeaconRange { stamp, beacon: id, range_m: range.0 });
        }
        match added {
            InsertOutcome::Inserted(changed_after) => self.insert(entry, changed_after, record),
            InsertOutcome::Rebased(changed_after) => self.insert(entry, Some(changed_after), record),
            InsertOutcome::Superseded | InsertOutcome::Duplicate | InsertOutcome::TooOld => {}
        }
    }

    /// Applies a command after all observations of its instant, or to the initial state before the first one.
    fn insert_command(&mut self, command: StateCommand) {
        let Some(stamp) = self.latest_time() else {
            self.history.base_mut().apply_command(command, &self.context);
            return;
        };
        let entry = PoseEntry { stamp, sensor: SensorId(0), update: UpdateKind::Command(command) };
        self.insert(entry, None, &mut scratch_record(&entry));
    }
}

impl<const N: usize> Filter for PoseFilter<N> {
    fn observe(&mut self, observation: &Observation) -> FusionRecord {
        validation::observe_if_valid(observation, self.latest_time(), self.context.config.params.history_s, |record| {
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
            FilterCommand::SetParams(params) => self.context.set_params(params),
            FilterCommand::ResetPose => self.insert_command(StateCommand::ResetPose),
            FilterCommand::SetOnlineCalibration(learning) => {
                self.insert_command(StateCommand::SetOnlineCalibration(*learning));
            }
            FilterCommand::ResetCalibration => self.insert_command(StateCommand::ResetCalibration),
        }
        FusionOutcome::Accepted
    }

    fn save(&self) -> Vec<u8> {
        let Self { context, history, slip_reported_at } = self;
        let UpdateContext { config: _, layout: _, track, gyro, ranges, .. } = context;
        saved::to_bytes(&SavedPoseFilter {
            track: track.save(),
            gyro: gyro.clone(),
            ranges: ranges.clone(),
            history: history.save(|before, after, entry| replay_entry(before, after, entry, context)),
            slip_reported_at: *slip_reported_at,
        })
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), RestoreError> {
        let saved: SavedPoseFilter<N> = saved::from_bytes(saved)?;
        saved.check()?;
        let SavedPoseFilter { track, gyro, ranges, history, slip_reported_at } = saved;
        let mut context = UpdateContext::new(&self.context.config, N);
        context.track = context.track.with_saved(track);
        context.gyro = gyro;
        context.ranges = ranges;
        let history = FixedLagHistory::restored(history, |before, after, entry| {
            replay_entry(before, after, entry, &context);
        })?;
        let restored = Self { context, history, slip_reported_at };
        let latest = restored.latest_time().and_then(|latest| restored.estimate_at(latest));
        (latest.is_none_or(|latest| latest.is_finite()))
            .then_some(())
            .ok_or(RestoreError::Implausible("its estimate is not finite"))?;
        *self = restored;
        Ok(())
    }

    fn restart_clock(&mut self) {
        let mut state = *self.state();
        state.restart_clock(&PoseState::initial(&self.context.config, &self.context.layout));
        // The stamps of before mean nothing.
        state.slip = None;
        self.slip_reported_at = None;
        self.history.reset(state);
        self.context = UpdateContext::new(&self.context.config, N);
    }

    fn calibration(&self) -> Option<Calibration> {
        Some(self.state().calibration(&self.context.config.calibration, &self.context.layout))
    }

    fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        let last = self.history.entries().back();
        last.map(|entry| entry.stamp).or(self.history.base().stamp)
    }

    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        let context = &self.context;
        let (stored, unapplied) = self.history.state_at_or_before(stamp);
        let mut state = Cow::Borrowed(stored);
        for entry in unapplied {
            let mut after = *state;
            apply_entry(&state, &mut after, entry, context, &mut scratch_record(entry));
            state = Cow::Owned(after);
        }
        state.stamp.filter(|known_from| *known_from <= stamp)?;
        Some(estimate(&state, stamp, context))
    }
}

/// The update by an observation; `None` for a kind that the filter does not use.
fn update_kind(observation: &Observation, geometry: &DriveGeometry) -> Option<UpdateKind> {
    match observation.measurement {
        ObservationKind::Fix(_)
        | ObservationKind::Landmark { .. }
        | ObservationKind::BeaconRange { .. }
        | ObservationKind::WallRange(_)
        | ObservationKind::CompassHeading(_) => {
            Some(UpdateKind::Absolute(observation.measurement, observation.stamp_sigma))
        }
        ObservationKind::WheelAccelerations { left, right } => {
            Some(UpdateKind::Accelerations(Acceleration::from_wheels(left.0, right.0, geometry)))
        }
        ObservationKind::TurnRate(rate) => Some(UpdateKind::TurnRate(rate.0)),
        ObservationKind::WheelAngles { .. }
        | ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. } => {
            MotionReading::from_observation(&observation.measurement).map(UpdateKind::Motion)
        }
        ObservationKind::Temperature(_) => None,
    }
}

/// Applies an entry to the state before it; `after` begins as a copy of that.
fn apply_entry<const N: usize>(
    before: &PoseState<N>,
    after: &mut PoseState<N>,
    entry: &PoseEntry,
    context: &UpdateContext,
    record: &mut FusionRecord,
) {
    apply_update(after, entry, context, record);
    if entry.is_without_effect(record.outcome) {
        *after = before.after_rejection(after);
    }
}

/// Applies an entry again.
fn replay_entry<const N: usize>(
    before: &PoseState<N>,
    after: &mut PoseState<N>,
    entry: &PoseEntry,
    context: &UpdateContext,
) {
    apply_entry(before, after, entry, context, &mut scratch_record(entry));
}

fn apply_update<const N: usize>(
    state: &mut PoseState<N>,
    entry: &PoseEntry,
    context: &UpdateContext,
    record: &mut FusionRecord,
) {
    let stamp = entry.stamp;
    match entry.update {
        // These observe speeds only: the pose goes on with the next wheel reading.
        UpdateKind::TurnRate(_) | UpdateKind::Accelerations(_) => {
            state.stamp = state.stamp.or(Some(stamp));
            state.predict_speeds_and_bias(stamp, context);
        }
        UpdateKind::Motion(_) | UpdateKind::Absolute(..) | UpdateKind::Command(_) => {
            state.advance(stamp, context);
        }
    }
    match entry.update {
        UpdateKind::TurnRate(rate) => motion_update::update_turn_rate(state, rate, context),
        UpdateKind::Accelerations(felt) => motion_update::update_accelerations(state, felt, stamp, context),
        UpdateKind::Motion(_) => motion_update::update_motion(state, stamp, context, record),
        UpdateKind::Absolute(observation, sigma) => {
            absolute_update::update_absolute(state, &observation, sigma, context, record);
        }
        UpdateKind::Command(revision) => state.apply_command(revision, context),
    }
}

/// A record for an entry that is applied again, which was reported when it came. Its sensor selects the noise scale.
const fn scratch_record(entry: &PoseEntry) -> FusionRecord {
    FusionRecord::new(entry.sensor, "", entry.stamp, FusionOutcome::Accepted)
}

struct PublishedPose {
    pose: Se2,
    covariance: PoseBlock,
}

impl PublishedPose {
    fn from_state<const N: usize>(state: &PoseState<N>) -> Self {
        Self { pose: state.pose, covariance: state.pose_covariance() }
    }

    /// The pose at its timestamp, where the odometer reports late, or early as one that reports commands:
    ///
    /// ```text
    /// X' = X U^-1      xi' = Ad(U) xi + (v, 0, w) dtau_o      U the motion over -tau_o, v and w the speeds then
    /// ```
    fn without_odometry_delay<const N: usize>(self, state: &PoseState<N>, context: &UpdateContext) -> Self {
        let Some(row) = context.layout.row(StateTerm::OdometryDelay) else {
            return self;
        };
        let delay = TimeDelta::from_secs_f64(-state.mean[row]).clamp(-MAX_DELAY, MAX_DELAY);
        let moved = state.motion_over_delay(delay, context);
        let shown = state.stamp.unwrap_or(Timestamp::ZERO) - delay;
        let (forward_m_per_s, turn_rad_per_s) = state.speeds_near(shown, context);
        let twist = Vector3::new(forward_m_per_s, 0.0, turn_rad_per_s);
        let adjoint = Matrix3::from_fn(|i, j| moved.adjoint()[i][j]);
        let p = Matrix3::from_fn(|i, j| self.covariance[i][j]);
        let with_delay = Vector3::new(FORWARD, LEFT, HEADING).map(|of_pose| state.covariance[(of_pose, row)]);
        let cross = adjoint * with_delay * twist.transpose();
        let variance = twist * twist.transpose() * state.covariance[(row, row)];
        let moved_back = adjoint * p * adjoint.transpose() + cross + cross.transpose() + variance;
        Self {
            pose: self.pose.compose(moved.inverse()),
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| moved_back[(i, j)])),
        }
    }
}

/// The estimate for an instant, with the gyro readings of the open window. It is requested after every observation
/// and needs a third of the state: where nothing else changes, only that third is computed.
fn estimate<const N: usize>(from: &PoseState<N>, stamp: Timestamp<BrickClock>, context: &UpdateContext) -> Estimate {
    let is_there = from.stamp.is_some_and(|known| known == stamp);
    let has_delay = context.layout.row(StateTerm::OdometryDelay).is_some();
    if is_there
        && !has_delay
        && let Some(shown) = with_open_window(from, context)
    {
        return build_estimate(from, &shown, stamp, context);
    }
    let mut state = *from;
    state.advance(stamp, context);
    motion_update::update_gyro_window(&mut state, context);
    let shown = PublishedPose::from_state(&state).without_odometry_delay(&state, context);
    build_estimate(&state, &shown, stamp, context)
}

/// The pose with the gyro readings of the window so far; `None` after wheel slip, which changes more than the pose.
fn with_open_window<const N: usize>(state: &PoseState<N>, context: &UpdateContext) -> Option<PublishedPose> {
    let Some(scalar) = motion_update::preview_gyro_window(state, context) else {
        return Some(PublishedPose::from_state(state));
    };
    if motion_update::is_slip(state, &scalar, context) {
        return None;
    }
    let rows = [FORWARD, LEFT, HEADING];
    let (correction, covariance) = preview_scalar(&state.mean, &state.covariance, &scalar, rows)?;
    Some(PublishedPose { pose: state.pose.compose(Se2::exp(correction)), covariance })
}

fn build_estimate<const N: usize>(
    state: &PoseState<N>,
    shown: &PublishedPose,
    stamp: Timestamp<BrickClock>,
    context: &UpdateContext,
) -> Estimate {
    let published = PublishedState {
        pose: arena_pose(shown.pose),
        speeds: [state.forward.value, state.turn.value],
        covariance: state.covariance_in_arena(shown.pose.heading_rad, &shown.covariance),
        has_position: state.is_located,
        has_heading: state.is_heading_known_at(shown.covariance[2][2]),
    };
    let estimate = state.status.estimate(stamp, &published, context.config.params.fix_timeout_s);
    let is_known = estimate.validity.position && estimate.validity.heading;
    Estimate { missing: if is_known { None } else { Some(missing_observation(state, context)) }, ..estimate }
}

fn missing_observation<const N: usize>(state: &PoseState<N>, context: &UpdateContext) -> MissingObservation {
    let beacons = state.stamp.map_or(0, |now| context.ranges.beacons_between(now - WINDOWS[1], now));
    if state.is_located || beacons > 2 {
        MissingObservation::Motion
    } else if beacons > 0 {
        MissingObservation::ThirdBeacon
    } else if state.sightings.is_empty() {
        MissingObservation::Position
    } else {
        MissingObservation::SecondLandmark
    }
}

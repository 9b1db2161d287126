//! The forward pass: the pose filter over a whole run, with a copy of what changes in the rows behind its own.

use std::collections::BTreeMap;

use nalgebra::Matrix3;
use posebridge_telemetry::{FusionOutcome, Observation, ObservationKind, SensorId, StartPose};

use super::super::context::UpdateContext;
use super::super::entry::{PoseEntry, UpdateKind};
use super::super::layout::{CORE_STATES, LARGE_STATES, StateLayout};
use super::super::state::PoseState;
use super::super::{apply_update, scratch_record, update_kind};
use crate::filter::FilterConfig;
use crate::history::HistoryEntry;
use crate::models::lie::Se2;
use crate::motion::InsertOutcome;
use crate::numerics::covariance::symmetrise;
use crate::observations::StateTerm;
use crate::validation;

/// A reference that turns the pose by more is no linearisation of it, rad.
const MAX_SHIFT_RAD: f64 = 0.5;
/// Below this variance the observations alone decide how far the reference is off.
const MIN_OFFSET_VARIANCE: f64 = 1e-12;

/// The rows of an augmented state: the filter's, then a copy of those that change, then the offset of the reference.
#[derive(Clone, Debug)]
pub(super) struct AugmentedRows {
    pub(super) states: usize,
    /// The filter's rows that change between two observations, each with a copy.
    pub(super) copied: Vec<usize>,
}

impl AugmentedRows {
    pub(super) fn new(config: &FilterConfig) -> Self {
        let layout = StateLayout::new(config, LARGE_STATES);
        let shared = layout.priors().iter().filter(|prior| changes(prior.term)).map(|prior| prior.row);
        Self { states: layout.states(), copied: (0..CORE_STATES).chain(shared).collect() }
    }

    pub(super) fn copy(&self, index: usize) -> usize {
        self.states + index
    }

    fn offset(&self) -> usize {
        self.states + self.copied.len()
    }

    pub(super) fn count(&self) -> usize {
        self.offset() + 1
    }
}

/// Whether a state beyond the core changes while the robot drives.
const fn changes(term: StateTerm) -> bool {
    match term {
        StateTerm::FixBias(..)
        | StateTerm::FixDelay
        | StateTerm::Delay(_)
        | StateTerm::GyroBias
        | StateTerm::WindowTurn
        | StateTerm::HeadingRounding => true,
        StateTerm::OdometryDelay
        | StateTerm::TagForward
        | StateTerm::TagLeft
        | StateTerm::BeaconOffset(_)
        | StateTerm::BeaconScale(_)
        | StateTerm::LandmarkOffset
        | StateTerm::LandmarkScale
        | StateTerm::GyroScale
        | StateTerm::Backlash
        | StateTerm::Mounting(..)
        | StateTerm::LandmarkPlace(..) => false,
    }
}

/// The usable observations of a run in time order, with the complete motion and gyro tracks.
pub(super) struct RecordedRun {
    pub(super) rows: AugmentedRows,
    pub(super) entries: Vec<PoseEntry>,
    pub(super) context: UpdateContext,
}

impl RecordedRun {
    pub(super) fn new(config: &FilterConfig, observations: &[Observation]) -> Self {
        let mut context = UpdateContext::new(config, LARGE_STATES);
        let mut entries = Vec::with_capacity(observations.len());
        for observation in validation::valid_in_time_order(observations) {
            let Some(update) = update_kind(observation, &config.geometry) else {
                continue;
            };
            let added = match update {
                UpdateKind::TurnRate(rate) => context.gyro.insert(observation.stamp, rate),
                UpdateKind::Motion(reading) => context.track.insert(observation.stamp, &reading),
                UpdateKind::Accelerations(_) | UpdateKind::Absolute(..) | UpdateKind::Command(_) => {
                    InsertOutcome::Inserted(None)
                }
            };
            if matches!(added, InsertOutcome::Inserted(_) | InsertOutcome::Rebased(_)) {
                entries.push(PoseEntry { stamp: observation.stamp, sensor: observation.sensor, update });
            }
        }
        entries.sort_by(PoseEntry::order);
        // Duplicates are adjacent now.
        entries.dedup_by(|later, earlier| earlier.is_duplicate_of(later));
        Self { rows: AugmentedRows::new(config), entries, context }
    }

    /// Whether an entry makes a step of the backward pass. The first one does, so that the path begins where the run does.
    pub(super) fn is_step(&self, index: usize) -> bool {
        index == 0 || matches!(self.entries[index].update, UpdateKind::Motion(_) | UpdateKind::Absolute(..))
    }

    /// Takes the reset counters out of the fixes: their jumps are among the resets of the next pass.
    pub(super) fn forget_observer_jumps(&mut self) {
        for entry in &mut self.entries {
            if let UpdateKind::Absolute(ObservationKind::Fix(fix), _) = &mut entry.update {
                fix.reset_counter = 0;
            }
        }
    }

    /// The entries of fixes whose observer's frame jumped.
    pub(super) fn observer_jumps(&self) -> Vec<usize> {
        let mut counters: BTreeMap<SensorId, u8> = BTreeMap::new();
        let mut jumps = Vec::new();
        for (index, entry) in self.entries.iter().enumerate() {
            if let UpdateKind::Absolute(ObservationKind::Fix(fix), _) = entry.update
                && counters.insert(entry.sensor, fix.reset_counter).is_some_and(|before| before != fix.reset_counter)
            {
                jumps.push(index);
            }
        }
        jumps
    }
}

/// A smoothed state of the pass before, at which the next one linearises.
#[derive(Clone, Debug)]
pub(super) struct Reference {
    pub(super) pose: Se2,
    pub(super) mean: Vec<f64>,
}

/// What a pass takes as decided.
pub(super) struct PassPlan<const N: usize> {
    pub(super) initial: PoseState<N>,
    /// Of each entry; observations that are not used are left out.
    pub(super) is_used: Vec<bool>,
    /// Poses that are set before an entry.
    pub(super) resets: BTreeMap<usize, StartPose>,
    /// Of each step; empty to linearise at the filter's own states.
    pub(super) references: Vec<Reference>,
}

/// A state after an entry that is a step, with the copy of the state after the step before.
pub(super) struct ForwardStep<const N: usize> {
    pub(super) entry: usize,
    pub(super) state: Box<PoseState<N>>,
    /// `None` for what is no absolute observation.
    pub(super) outcome: Option<FusionOutcome>,
}

/// Where a forward pass stands.
#[derive(Clone)]
pub(super) struct ForwardPass<'a, const N: usize> {
    run: &'a RecordedRun,
    plan: &'a PassPlan<N>,
    state: Box<PoseState<N>>,
    next_entry: usize,
    steps: usize,
}

impl<'a, const N: usize> ForwardPass<'a, N> {
    pub(super) fn new(run: &'a RecordedRun, plan: &'a PassPlan<N>) -> Self {
        let mut pass = Self { run, plan, state: Box::new(plan.initial), next_entry: 0, steps: 0 };
        pass.copy_rows();
        pass
    }

    /// Number of steps so far.
    pub(super) const fn steps(&self) -> usize {
        self.steps
    }

    /// The first entry that has not been applied.
    pub(super) const fn next_entry(&self) -> usize {
        self.next_entry
    }

    /// Applies entries up to the next step; `None` at the end.
    pub(super) fn next_step(&mut self) -> Option<ForwardStep<N>> {
        while self.next_entry < self.run.entries.len() {
            let index = self.next_entry;
            self.next_entry += 1;
            let outcome = self.apply(index);
            if self.run.is_step(index) {
                let step = ForwardStep { entry: index, state: self.state.clone(), outcome };
                // At once: what the gyro's entries let grow until the next step lies between the copy and that.
                self.copy_rows();
                self.steps += 1;
                return Some(step);
            }
        }
        None
    }

    /// Makes the copy: the same errors, and no correction yet.
    fn copy_rows(&mut self) {
        let rows = &self.run.rows;
        let first = rows.copy(0);
        let (mean, covariance) = (&mut self.state.mean, &mut self.state.covariance);
        for (i, &row) in rows.copied.iter().enumerate() {
            mean[first + i] = 0.0;
            for column in 0..rows.states {
                let value = covariance[(row, column)];
                covariance[(first + i, column)] = value;
                covariance[(column, first + i)] = value;
            }
            for (j, &column) in rows.copied.iter().enumerate() {
                covariance[(first + i, first + j)] = covariance[(row, column)];
            }
        }
    }

    fn apply(&mut self, index: usize) -> Option<FusionOutcome> {
        let (entry, context) = (&self.run.entries[index], &self.run.context);
        let state = &mut *self.state;
        let reset = self.plan.resets.get(&index);
        if let Some(start) = reset {
            state.initialize_pose(start);
        }
        let is_absolute = matches!(entry.update, UpdateKind::Absolute(..));
        if is_absolute && !self.plan.is_used[index] {
            state.advance(entry.stamp, context);
            return Some(FusionOutcome::Gated);
        }
        let before = *state;
        let reference = self.steps.checked_sub(1).and_then(|step| self.plan.references.get(step));
        let is_shifted = reset.is_none()
            && self.run.is_step(index)
            && reference.is_some_and(|reference| shift(state, reference, &self.run.rows));
        let mut record = scratch_record(entry);
        apply_update(state, entry, context, &mut record);
        if is_shifted {
            remove_offset(state, &self.run.rows);
        }
        if entry.is_without_effect(record.outcome) {
            *state = before.after_rejection(state);
            // The path has a pose there all the same.
            state.advance(entry.stamp, context);
        }
        is_absolute.then_some(record.outcome)
    }
}

/// Describes the same belief about another reference, so that the next update is linearised there. With X and m the state's pose and
/// mean and X_r and m_r those of the reference, a row u that is known to be one carries the offset:
///
/// ```text
/// delta = (log(X_r^-1 X), m - m_r)        e_r = delta u + J e        J the inverse of the right Jacobian in the rows of the pose
/// P_r   = J P J' + delta delta'           Cov(e_r, u) = delta        var u = 1
/// ```
/// Returns whether it did.
fn shift<const N: usize>(state: &mut PoseState<N>, reference: &Reference, rows: &AugmentedRows) -> bool {
    let of_pose = reference.pose.between(state.pose).log();
    let Some(inverse) = Se2::right_jacobian(of_pose).try_inverse() else { return false };
    if of_pose[2].abs() > MAX_SHIFT_RAD || !of_pose.iter().sum::<f64>().is_finite() {
        return false;
    }
    transform_pose_rows(state, &inverse);
    let offset = rows.offset();
    state.clear_rows(&[offset]);
    let mut delta = [0.0; N];
    delta[..3].copy_from_slice(&of_pose);
    for row in 3..rows.states {
        delta[row] = state.mean[row] - reference.mean[row];
        state.mean[row] = reference.mean[row];
    }
    state.pose = reference.pose;
    for row in 0..rows.states {
        for column in 0..rows.states {
            state.covariance[(row, column)] += delta[row] * delta[column];
        }
        state.covariance[(row, offset)] = delta[row];
        state.covariance[(offset, row)] = delta[row];
    }
    state.mean[offset] = 0.0;
    state.covariance[(offset, offset)] = 1.0;
    true
}

fn transform_pose_rows<const N: usize>(state: &mut PoseState<N>, by: &Matrix3<f64>) {
    let moved = by * state.covariance.fixed_view::<3, N>(0, 0);
    state.covariance.fixed_view_mut::<3, N>(0, 0).copy_from(&moved);
    let moved = state.covariance.fixed_view::<N, 3>(0, 0) * by.transpose();
    state.covariance.fixed_view_mut::<N, 3>(0, 0).copy_from(&moved);
}

/// Conditions on u = 1, after which it is forgotten.
fn remove_offset<const N: usize>(state: &mut PoseState<N>, rows: &AugmentedRows) {
    let offset = rows.offset();
    let variance = state.covariance[(offset, offset)];
    if variance > MIN_OFFSET_VARIANCE {
        let with_offset = state.covariance.column(offset).into_owned();
        let missing = 1.0 - state.mean[offset];
        state.mean += with_offset * (missing / variance);
        state.covariance.ger(-1.0 / variance, &with_offset, &with_offset, 1.0);
        symmetrise(&mut state.covariance);
    }
    state.clear_rows(&[offset]);
    state.mean[offset] = 0.0;
    state.inject();
}

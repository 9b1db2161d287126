//! The forward pass: the pose filter over a whole run, with a copy of what changes in the rows behind its own.

use std::collections::BTreeMap;

use posebridge_telemetry::{FusionOutcome, Observation, ObservationKind, SensorId, StartPose};

use super::super::context::UpdateContext;
use super::super::entry::{PoseEntry, UpdateKind};
use super::super::layout::{CORE_STATES, LARGE_STATES, StateLayout};
use super::super::state::PoseState;
use super::super::{apply_update, scratch_record, update_kind};
use crate::filter::FilterConfig;
use crate::history::HistoryEntry;
use crate::motion::InsertOutcome;
use crate::observations::StateTerm;
use crate::validation;

/// The rows of an augmented state: the filter's, then a copy of those that change.
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

    pub(super) fn count(&self) -> usize {
        self.states + self.copied.len()
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

/// What a pass takes as decided.
pub(super) struct PassPlan<const N: usize> {
    pub(super) initial: PoseState<N>,
    /// Of each entry; observations that are not used are left out.
    pub(super) is_used: Vec<bool>,
    /// Poses that are set before an entry.
    pub(super) resets: BTreeMap<usize, StartPose>,
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
        if let Some(start) = self.plan.resets.get(&index) {
            state.initialize_pose(start);
        }
        let is_absolute = matches!(entry.update, UpdateKind::Absolute(..));
        if is_absolute && !self.plan.is_used[index] {
            state.advance(entry.stamp, context);
            return Some(FusionOutcome::Gated);
        }
        let before = *state;
        let mut record = scratch_record(entry);
        apply_update(state, entry, context, &mut record);
        if entry.is_without_effect(record.outcome) {
            *state = before.after_rejection(state);
            // The path has a pose there all the same.
            state.advance(entry.stamp, context);
        }
        is_absolute.then_some(record.outcome)
    }
}

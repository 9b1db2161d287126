//! Rauch-Tung-Striebel smoother: the pose filter run forwards over a complete recording and back again. Each state x is
//! augmented by a copy c of its value one observation ago, so that the filter itself gives their joint covariance:
//!
//! ```text
//! x_k^s = c_k + C (x_(k+1)^s - x_(k+1))          C = Cov(c_k, x_(k+1)) Cov(x_(k+1))^-1
//! P_k^s = Cov(c_k) + C (P_(k+1)^s - Cov(x_(k+1))) C'
//! ```
//! It needs no Jacobian of what lies between, and bears rows that are forgotten on the way (gyro windows), which make
//! the predicted covariance singular. The inverse is taken on what is uncertain at all.
//!
//! Source: Rauch, Tung, Striebel (1965); Roumeliotis and Burdick (2002) for the copied state; docs/maths/pose.md
//! section 11.

use nalgebra::{DMatrix, DVector};
use posebridge_telemetry::{BrickClock, Calibration, Observation, Timestamp};

use super::context::UpdateContext;
use super::entry::{PoseEntry, UpdateKind};
use super::layout::{MEDIUM_STATES, RADIUS, ROUNDING};
use super::state::PoseState;
use super::{apply_update, scratch_record, update_kind};
use crate::filter::FilterConfig;
use crate::history::HistoryEntry;
use crate::motion::InsertOutcome;
use crate::numerics::covariance::inverse_of_uncertain;
use crate::validation;

/// Rows of the state and of its copy.
const AUGMENTED_ROWS: usize = 2 * MEDIUM_STATES;

/// A smoothed state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedState {
    pub stamp: Timestamp<BrickClock>,
    /// The state with its smoothed covariance; its speeds are the filter's.
    pub state: PoseState<MEDIUM_STATES>,
}

/// The result of a forward and a backward pass.
#[derive(Clone, Debug, PartialEq)]
pub struct SmootherResult {
    /// The states after each motion reading and each absolute observation that was used, in the order of time.
    pub states: Vec<SmoothedState>,
    /// Sum of the NIS of the absolute observations that were used.
    pub nis: f64,
    pub used: usize,
    pub rejected: usize,
    /// The smoothed constants.
    pub calibration: Calibration,
}

/// The quantities of one observation that the backward pass needs.
struct ForwardStep {
    stamp: Timestamp<BrickClock>,
    after: PoseState<MEDIUM_STATES>,
    /// The state one observation ago, corrected by later observations.
    copy_correction: DVector<f64>,
    copy_covariance: DMatrix<f64>,
    /// Cov(copy, state).
    cross: DMatrix<f64>,
}

/// Smooths a run; an empty result means that nothing moved.
pub fn smooth(config: &FilterConfig, observations: &[Observation]) -> SmootherResult {
    let (entries, context) = prepare_entries(config, observations);
    let initial = PoseState::<MEDIUM_STATES>::initial(config, &context.layout);
    let mut smoothing =
        SmootherResult { states: Vec::new(), nis: 0.0, used: 0, rejected: 0, calibration: config.calibration };
    let rows = uncertain_rows(&entries, &initial);
    let passed = forward_pass(&entries, &context, &initial, &rows, &mut smoothing);
    backward_pass(&passed, &rows, &mut smoothing);
    if let Some(last) = smoothing.states.last() {
        smoothing.calibration = last.state.calibration(&config.calibration, &context.layout);
    }
    smoothing
}

/// The usable observations in time order, with the complete motion and gyro tracks.
fn prepare_entries(config: &FilterConfig, observations: &[Observation]) -> (Vec<PoseEntry>, UpdateContext) {
    let mut context = UpdateContext::new(config, MEDIUM_STATES);
    let mut entries = Vec::with_capacity(observations.len());
    for observation in validation::valid_in_time_order(observations) {
        let Some(action) = update_kind(observation, &config.geometry) else {
            continue;
        };
        let added = match action {
            UpdateKind::TurnRate(rate) => context.gyro.insert(observation.stamp, rate),
            UpdateKind::Motion(reading) => context.track.insert(observation.stamp, &reading),
            UpdateKind::Accelerations(_) | UpdateKind::Absolute(..) | UpdateKind::Command(_) => {
                InsertOutcome::Inserted(None)
            }
        };
        if matches!(added, InsertOutcome::Inserted(_) | InsertOutcome::Rebased(_)) {
            entries.push(PoseEntry { stamp: observation.stamp, sensor: observation.sensor, update: action });
        }
    }
    entries.sort_by(PoseEntry::order);
    // Duplicates are adjacent now.
    entries.dedup_by(|later, earlier| earlier.is_duplicate_of(later));
    (entries, context)
}

/// The rows that are ever uncertain, all of the pose's and the gyro's among them: the others need no smoothing.
fn uncertain_rows(entries: &[PoseEntry], initial: &PoseState<MEDIUM_STATES>) -> Vec<usize> {
    let always = RADIUS;
    let has_gyro = entries.iter().any(|entry| matches!(entry.update, UpdateKind::TurnRate(_)));
    (0..MEDIUM_STATES)
        .filter(|&row| {
            let is_of_gyro = row == ROUNDING;
            row < always || (is_of_gyro && has_gyro) || (!is_of_gyro && initial.covariance[(row, row)] > 0.0)
        })
        .collect()
}

fn forward_pass(
    entries: &[PoseEntry],
    context: &UpdateContext,
    initial: &PoseState<MEDIUM_STATES>,
    rows: &[usize],
    smoothing: &mut SmootherResult,
) -> Vec<ForwardStep> {
    let mut state = augmented_state(initial);
    copy_rows(&mut state);
    let mut passed = Vec::with_capacity(entries.len());
    for entry in entries {
        let observes_pose = matches!(entry.update, UpdateKind::Motion(_) | UpdateKind::Absolute(..));
        let before = state;
        let mut record = scratch_record(entry);
        apply_update(&mut state, entry, context, &mut record);
        if entry.is_without_effect(record.outcome) {
            smoothing.rejected += 1;
            state = before.after_rejection(&state);
            continue;
        }
        if matches!(entry.update, UpdateKind::Absolute(..)) {
            smoothing.used += 1;
            smoothing.nis += record.nis;
        }
        if observes_pose {
            passed.push(forward_step(&state, entry.stamp, rows));
            // At once: what the gyro's entries let grow until the next one lies between the copy and that.
            copy_rows(&mut state);
        }
    }
    passed
}

/// The state with additional rows for its copy.
fn augmented_state(state: &PoseState<MEDIUM_STATES>) -> PoseState<AUGMENTED_ROWS> {
    let mut wide = PoseState::<AUGMENTED_ROWS>::resized(state);
    wide.mean.fixed_rows_mut::<MEDIUM_STATES>(0).copy_from(&state.mean);
    wide.covariance.fixed_view_mut::<MEDIUM_STATES, MEDIUM_STATES>(0, 0).copy_from(&state.covariance);
    wide
}

/// Makes the copy: the same errors, and no correction yet.
fn copy_rows(state: &mut PoseState<AUGMENTED_ROWS>) {
    let covariance = state.covariance.fixed_view::<MEDIUM_STATES, MEDIUM_STATES>(0, 0).into_owned();
    state.mean.fixed_rows_mut::<MEDIUM_STATES>(MEDIUM_STATES).fill(0.0);
    for (row, column) in [(MEDIUM_STATES, 0), (0, MEDIUM_STATES), (MEDIUM_STATES, MEDIUM_STATES)] {
        state.covariance.fixed_view_mut::<MEDIUM_STATES, MEDIUM_STATES>(row, column).copy_from(&covariance);
    }
}

fn forward_step(state: &PoseState<AUGMENTED_ROWS>, stamp: Timestamp<BrickClock>, rows: &[usize]) -> ForwardStep {
    let n = rows.len();
    let block = |row_base: usize, column_base: usize| {
        DMatrix::from_fn(n, n, |i, j| state.covariance[(row_base + rows[i], column_base + rows[j])])
    };
    let mut after = PoseState::<MEDIUM_STATES>::resized(state);
    after.mean = state.mean.fixed_rows::<MEDIUM_STATES>(0).into_owned();
    after.covariance = state.covariance.fixed_view::<MEDIUM_STATES, MEDIUM_STATES>(0, 0).into_owned();
    ForwardStep {
        stamp,
        after,
        copy_correction: DVector::from_fn(n, |i, _| state.mean[MEDIUM_STATES + rows[i]]),
        copy_covariance: block(MEDIUM_STATES, MEDIUM_STATES),
        cross: block(MEDIUM_STATES, 0),
    }
}

fn backward_pass(passed: &[ForwardStep], rows: &[usize], smoothing: &mut SmootherResult) {
    let Some(last) = passed.last() else { return };
    let n = rows.len();
    let filtered = |passed: &ForwardStep| DMatrix::from_fn(n, n, |i, j| passed.after.covariance[(rows[i], rows[j])]);
    // Correction of the state after the observation at hand, and its smoothed covariance.
    let mut correction = DVector::zeros(n);
    let mut smoothed = filtered(last);
    for (index, at) in passed.iter().enumerate().rev() {
        smoothing
            .states
            .push(SmoothedState { stamp: at.stamp, state: smoothed_state(at, &correction, &smoothed, rows) });
        if index == 0 {
            break;
        }
        let of_state = filtered(at);
        let gain = &at.cross * inverse_of_uncertain(&of_state);
        correction = &at.copy_correction + &gain * correction;
        smoothed = &at.copy_covariance + &gain * (smoothed - of_state) * gain.transpose();
        smoothed = 0.5 * (&smoothed + smoothed.transpose());
    }
    smoothing.states.reverse();
}

fn smoothed_state(
    at: &ForwardStep,
    correction: &DVector<f64>,
    smoothed: &DMatrix<f64>,
    rows: &[usize],
) -> PoseState<MEDIUM_STATES> {
    let mut state = at.after;
    for (i, &row) in rows.iter().enumerate() {
        state.mean[row] += correction[i];
        for (j, &column) in rows.iter().enumerate() {
            state.covariance[(row, column)] = smoothed[(i, j)];
        }
    }
    state.inject();
    state
}

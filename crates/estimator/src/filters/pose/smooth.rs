//! The pose filter run forwards over a whole recording and back again: Rauch, Tung and Striebel's smoother.
//!
//! # Model
//! Beside each state x stands a copy c of what it was one observation ago, carried through the same steps and updates, so that
//! the filter itself gives their joint covariance after it:
//! ```text
//! x_k^s = c_k + C (x_(k+1)^s - x_(k+1))          C = Cov(c_k, x_(k+1)) Cov(x_(k+1))^-1
//! P_k^s = Cov(c_k) + C (P_(k+1)^s - Cov(x_(k+1))) C'
//! ```
//! That is the textbook's recursion with the filtered covariances of the joint state in the place of the predicted ones: it needs
//! no Jacobian of what lies between, and bears rows that are forgotten on the way (gyro windows), which make the predicted
//! covariance singular. The inverse is taken on what is uncertain at all.
//!
//! # Source
//! Rauch, Tung, Striebel (1965); Roumeliotis and Burdick (2002) for the copied state; docs/maths/pose.md section 11.

use nalgebra::{DMatrix, DVector, SymmetricEigen};
use posebridge_telemetry::{BrickClock, Calibration, Observation, Stamp, Verdict};

use super::fuse::{self, Context};
use super::history::{Action, Told};
use super::state::{FORWARD, HEADING, LEFT, PoseState, WITH_RANGES};
use super::{act, action_of, scratch_record};
use crate::filters::{FilterConfig, intake};
use crate::models::lie::Se2;
use crate::motion::{Added, GyroTrack, MotionReading, MotionTrack};

/// Rows of the state and of its copy.
const BOTH: usize = 2 * WITH_RANGES;
/// Below this share of the largest eigenvalue of the correlations a direction counts as certain.
const CERTAIN: f64 = 1e-11;

/// A state in hindsight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hindsight {
    /// The instant.
    pub stamp: Stamp<BrickClock>,
    /// The state with its smoothed covariance; its speeds are the filter's.
    pub state: PoseState<WITH_RANGES>,
}

/// A run forwards and back.
#[derive(Clone, Debug, PartialEq)]
pub struct Smoothing {
    /// The states after each motion reading and each sight that was used, in the order of time.
    pub states: Vec<Hindsight>,
    /// Sum of the NIS of the sights that were used.
    pub nis: f64,
    /// How many sights were used.
    pub used: usize,
    /// How many were not.
    pub left_out: usize,
    /// What was learned, in hindsight.
    pub calibration: Calibration,
}

/// What the way back needs of one observation.
struct Passed {
    stamp: Stamp<BrickClock>,
    after: PoseState<WITH_RANGES>,
    /// The state one observation ago, corrected by what came since.
    copy_correction: DVector<f64>,
    copy_covariance: DMatrix<f64>,
    /// Cov(copy, state).
    cross: DMatrix<f64>,
}

/// Smooths a run; an empty result means that nothing moved.
#[must_use]
pub fn smooth(config: &FilterConfig, observations: &[Observation]) -> Smoothing {
    let (told, track, gyro) = heard(config, observations);
    let context = Context { config, track: &track, gyro: &gyro, gates: &fuse::gates_of(config) };
    let initial = PoseState::<WITH_RANGES>::initial(config);
    let mut smoothing =
        Smoothing { states: Vec::new(), nis: 0.0, used: 0, left_out: 0, calibration: config.calibration };
    let rows = uncertain_rows(&told, &initial);
    let passed = forwards(&told, &context, &initial, &rows, &mut smoothing);
    backwards(&passed, &rows, &mut smoothing);
    if let Some(last) = smoothing.states.last() {
        smoothing.calibration = last.state.calibration(&config.calibration);
    }
    smoothing
}

/// What can be used, in the order of time, with the whole of what wheels and gyro said.
fn heard(config: &FilterConfig, observations: &[Observation]) -> (Vec<Told>, MotionTrack, GyroTrack) {
    let mut track = MotionTrack::new(config.geometry, config.params.max_wheel_rad_per_s);
    let mut gyro = GyroTrack::default();
    let mut told = Vec::with_capacity(observations.len());
    for observation in intake::sound_in_time(observations) {
        let Some(action) = action_of(observation) else {
            continue;
        };
        let added = match action {
            Action::TurnRate(rate) => gyro.add(observation.stamp, rate),
            Action::Motion => MotionReading::of(&observation.observed)
                .map_or(Added::TooOld, |reading| track.add(observation.stamp, &reading)),
            Action::Accelerations(_) | Action::Sight(..) | Action::SetPose(_) | Action::Revise(_) => Added::After(None),
        };
        if matches!(added, Added::After(_) | Added::Rebased(_)) {
            told.push(Told { stamp: observation.stamp, sensor: observation.sensor, action });
        }
    }
    told.sort_by(Told::order);
    // What says the same stands side by side now.
    told.dedup_by(|later, earlier| earlier.repeats(later));
    (told, track, gyro)
}

/// The rows that are ever uncertain: the others need no smoothing. All of the pose's and the gyro's are.
fn uncertain_rows(told: &[Told], initial: &PoseState<WITH_RANGES>) -> Vec<usize> {
    let always = super::state::RADIUS;
    let has_gyro = told.iter().any(|entry| matches!(entry.action, Action::TurnRate(_)));
    (0..WITH_RANGES)
        .filter(|&row| {
            let is_of_gyro = row == super::state::ROUNDING;
            row < always || (is_of_gyro && has_gyro) || (!is_of_gyro && initial.covariance[(row, row)] > 0.0)
        })
        .collect()
}

fn forwards(
    told: &[Told],
    context: &Context<'_>,
    initial: &PoseState<WITH_RANGES>,
    rows: &[usize],
    smoothing: &mut Smoothing,
) -> Vec<Passed> {
    let mut state = widened(initial);
    copy_rows(&mut state);
    let mut passed = Vec::with_capacity(told.len());
    for entry in told {
        let tells_of_pose = matches!(entry.action, Action::Motion | Action::Sight(..));
        let before = state;
        let mut record = scratch_record(entry);
        act(&mut state, entry, context, &mut record);
        if matches!(entry.action, Action::Sight(..)) {
            if !matches!(record.verdict, Verdict::Accepted | Verdict::ResetTo) {
                smoothing.left_out += 1;
                state = PoseState { refused: state.refused, scales: state.scales, spaces: state.spaces, ..before };
                continue;
            }
            smoothing.used += 1;
            smoothing.nis += record.nis;
        }
        if tells_of_pose {
            passed.push(kept(&state, entry.stamp, rows));
            // At once: what the gyro's entries let grow until the next one lies between the copy and that.
            copy_rows(&mut state);
        }
    }
    passed
}

/// The state with room for its copy.
fn widened(state: &PoseState<WITH_RANGES>) -> PoseState<BOTH> {
    let mut wide = PoseState::<BOTH>::resized(state);
    for row in 0..WITH_RANGES {
        wide.mean[row] = state.mean[row];
        for column in 0..WITH_RANGES {
            wide.covariance[(row, column)] = state.covariance[(row, column)];
        }
    }
    wide
}

/// Makes the copy: the same errors, and no correction yet.
fn copy_rows(state: &mut PoseState<BOTH>) {
    for row in 0..WITH_RANGES {
        state.mean[WITH_RANGES + row] = 0.0;
        for column in 0..WITH_RANGES {
            let value = state.covariance[(row, column)];
            state.covariance[(WITH_RANGES + row, column)] = value;
            state.covariance[(row, WITH_RANGES + column)] = value;
            state.covariance[(WITH_RANGES + row, WITH_RANGES + column)] = value;
        }
    }
}

fn kept(state: &PoseState<BOTH>, stamp: Stamp<BrickClock>, rows: &[usize]) -> Passed {
    let n = rows.len();
    let block = |row_base: usize, column_base: usize| {
        DMatrix::from_fn(n, n, |i, j| state.covariance[(row_base + rows[i], column_base + rows[j])])
    };
    let mut after = PoseState::<WITH_RANGES>::resized(state);
    for row in 0..WITH_RANGES {
        after.mean[row] = state.mean[row];
        for column in 0..WITH_RANGES {
            after.covariance[(row, column)] = state.covariance[(row, column)];
        }
    }
    Passed {
        stamp,
        after,
        copy_correction: DVector::from_fn(n, |i, _| state.mean[WITH_RANGES + rows[i]]),
        copy_covariance: block(WITH_RANGES, WITH_RANGES),
        cross: block(WITH_RANGES, 0),
    }
}

fn backwards(passed: &[Passed], rows: &[usize], smoothing: &mut Smoothing) {
    let Some(last) = passed.last() else { return };
    let n = rows.len();
    let filtered = |passed: &Passed| DMatrix::from_fn(n, n, |i, j| passed.after.covariance[(rows[i], rows[j])]);
    // Correction of the state after the observation at hand, and its smoothed covariance.
    let mut correction = DVector::zeros(n);
    let mut smoothed = filtered(last);
    for (index, at) in passed.iter().enumerate().rev() {
        smoothing.states.push(Hindsight { stamp: at.stamp, state: corrected(at, &correction, &smoothed, rows) });
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

fn corrected(
    at: &Passed,
    correction: &DVector<f64>,
    smoothed: &DMatrix<f64>,
    rows: &[usize],
) -> PoseState<WITH_RANGES> {
    let mut state = at.after;
    for (i, &row) in rows.iter().enumerate() {
        state.mean[row] += correction[i];
        for (j, &column) in rows.iter().enumerate() {
            state.covariance[(row, column)] = smoothed[(i, j)];
        }
    }
    let twist = [state.mean[FORWARD], state.mean[LEFT], state.mean[HEADING]];
    state.pose = state.pose.then(Se2::exp(twist));
    for row in [FORWARD, LEFT, HEADING] {
        state.mean[row] = 0.0;
    }
    state
}

/// The inverse of a covariance on what is uncertain, zero on the rest.
fn inverse_of_uncertain(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let n = covariance.nrows();
    let unit = DVector::from_fn(n, |i, _| {
        let variance = covariance[(i, i)];
        if variance > 0.0 { variance.sqrt().recip() } else { 0.0 }
    });
    let correlation = DMatrix::from_fn(n, n, |i, j| unit[i] * covariance[(i, j)] * unit[j]);
    let eigen = SymmetricEigen::new(correlation);
    let limit = CERTAIN * eigen.eigenvalues.amax();
    let mut inverse = DMatrix::zeros(n, n);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > limit {
            inverse += vector * vector.transpose() / *value;
        }
    }
    DMatrix::from_fn(n, n, |i, j| unit[i] * inverse[(i, j)] * unit[j])
}

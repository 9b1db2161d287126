//! The most likely path given all motion readings, gyro windows and fixes, for reports and to compare filters with.
//!
//! ```text
//! minimise  |start|^2 + sum |motion|^2 + sum |gyro window|^2 + sum |fix|^2 + sum |prior|^2      residuals over their sigmas
//! ```
//! in rounds: descend with the fixes in use; then test each fix against all the others; again, until that changes
//! nothing. There is no slip test, and windows of the gyro are taken as independent of each other.
//!
//! Source: docs/maths/pose.md.

use posebridge_telemetry::Observation;

use super::factors::{Whitener, bias_prior, pose_from_fix, whitener};
use super::forward_pass::{InitialGuess, Optimum, PassContext, filter_initial_guess, minimize};
use super::posterior::GatedObservation;
use super::problem::{CONSTANTS, FIX_DELAY, ProblemValues, RunData, SmoothingProblem, UnwrappedPose, constants_of};
use super::trajectory::{OfflineError, SmoothedTrajectory};
use crate::filter::FilterConfig;
use crate::numerics::chi_square::chi_square_gates;
use crate::validation;

/// Most rounds before the search fails; two or three are usual.
const MAX_ROUNDS: u32 = 20;

/// Finds the most likely path and calibration, from observations in any order. A constant whose sigma is zero is not
/// estimated. Errors: nothing observed, no convergence, or a configuration that is not finite.
pub fn batch(config: &FilterConfig, observations: &[Observation]) -> Result<SmoothedTrajectory, OfflineError> {
    let run = RunData::new(config, observations);
    if run.motion_readings() == 0 {
        return Err(OfflineError::NothingObserved { motion_readings: 0, fixes: 0 });
    }
    if !is_valid_config(config) {
        return Err(OfflineError::NotFinite);
    }
    let gates = chi_square_gates(config.params.gate_probability);
    let mut iterations = 0;
    let mut state = OuterIteration::initial(config, run.fixes());
    let mut cost = f64::NAN;
    for round in 0..MAX_ROUNDS {
        let problem = run.problem(state.delay_s);
        if config.start.is_none() && problem.fixes.is_empty() {
            return Err(OfflineError::NothingObserved { motion_readings: run.motion_readings(), fixes: 0 });
        }
        let whiteners = whiteners(&problem, &state.constants)?;
        let descended = state.minimize(&problem, &whiteners, gates)?;
        iterations += descended.steps;
        cost = descended.linearised.cost;
        let gated = GatedObservation::evaluate(&problem, &descended, &state.is_used, gates);
        let values = descended.values;
        if state.update(values.clone(), &gated.passes_gate, round) && round > 0 {
            let used = state.is_used.iter().filter(|used| **used).count();
            return Ok(SmoothedTrajectory {
                poses: gated.poses(&problem, &values),
                calibration: gated.calibration(&problem, &values),
                cost,
                iterations,
                fixes_used: used,
                fixes_rejected: run.fixes() - used,
                gyro_windows: problem.windows.len(),
            });
        }
    }
    Err(OfflineError::Diverged { cost })
}

/// Whether geometry, start and priors are finite and physically possible.
pub(super) fn is_valid_config(config: &FilterConfig) -> bool {
    let geometry = &config.geometry;
    let lengths = [geometry.left_wheel_radius.0, geometry.right_wheel_radius.0, geometry.track_width.0];
    let known = constants_of(&config.calibration);
    lengths.iter().all(|length| length.is_finite() && *length > 0.0)
        && config.start.is_none_or(|start| validation::is_valid_start(&start))
        && known.iter().all(|known| known.value.is_finite() && known.sigma.is_finite() && known.sigma >= 0.0)
}

// What one round of the batch solution leaves to the next, and where the first one begins.
//
// Source: docs/maths/pose.md section B3.

/// From this round on fixes are only left out and not taken back, so that the search ends.
const LAST_READMISSION_ROUND: u32 = 8;
/// The delay of fixes is settled when a round changes it by less, s: at 1 m/s a micrometre.
const SETTLED_DELAY_S: f64 = 1e-6;
/// A heading with a larger sigma is tried in several directions, rad.
const VAGUE_HEADING_SIGMA_RAD: f64 = 0.4;
/// Number of these directions.
const HEADING_STARTS: u32 = 8;
/// For a first guess from all fixes in use.
const UNGATED: InitialGuess = InitialGuess { gates: [f64::INFINITY; 3], heading_sigma_rad: f64::INFINITY };

pub(super) struct OuterIteration {
    /// The noise of the motion is computed with these.
    pub(super) constants: [f64; CONSTANTS],
    /// The delay of fixes by which the poses are chosen.
    pub(super) delay_s: f64,
    pub(super) is_used: Vec<bool>,
    previous: Option<PreviousOptimum>,
}

enum PreviousOptimum {
    /// The next problem has the same unknowns.
    Same(ProblemValues),
    /// The poses are at other instants; holds the first of them.
    Moved(UnwrappedPose),
}

impl OuterIteration {
    pub(super) fn initial(config: &FilterConfig, fixes: usize) -> Self {
        let constants = constants_of(&config.calibration).map(|known| known.value);
        Self { constants, delay_s: constants[FIX_DELAY], is_used: vec![true; fixes], previous: None }
    }

    /// Descends to the least cost with the fixes in use; the first round chooses these as well.
    pub(super) fn minimize(
        &mut self,
        problem: &SmoothingProblem<'_>,
        whiteners: &[Whitener],
        gates: [f64; 3],
    ) -> Result<Optimum, OfflineError> {
        match self.previous.take() {
            Some(PreviousOptimum::Same(values)) => minimize(self.pass_context(problem, whiteners), values),
            Some(PreviousOptimum::Moved(first)) => {
                let ground = self.pass_context(problem, whiteners);
                let start = initial_values(problem, self.constants, first);
                minimize(ground, filter_initial_guess(ground, &start, UNGATED).0)
            }
            None => self.minimize_from_scratch(problem, whiteners, gates),
        }
    }

    fn minimize_from_scratch(
        &mut self,
        problem: &SmoothingProblem<'_>,
        whiteners: &[Whitener],
        gates: [f64; 3],
    ) -> Result<Optimum, OfflineError> {
        let starts = candidate_starts(problem, self.constants);
        let [only] = starts.as_slice() else {
            return self.minimize_from_best(problem, whiteners, &starts);
        };
        let guess = InitialGuess { gates, ..UNGATED };
        let (values, let_through) = filter_initial_guess(self.pass_context(problem, whiteners), only, guess);
        let refused = let_through.iter().filter(|used| !**used).count();
        if 2 * refused > let_through.len() {
            // A gate that refuses most fixes has locked itself out: the fixes know better than the guess.
            return self.minimize_from_best(problem, whiteners, &starts);
        }
        self.is_used = let_through;
        minimize(self.pass_context(problem, whiteners), values)
    }

    fn pass_context<'p, 'a>(
        &'p self,
        problem: &'p SmoothingProblem<'a>,
        whiteners: &'p [Whitener],
    ) -> PassContext<'p, 'a> {
        PassContext { problem, whiteners, is_used: &self.is_used }
    }

    /// Descends from each start with all fixes, and keeps the least cost.
    fn minimize_from_best(
        &self,
        problem: &SmoothingProblem<'_>,
        whiteners: &[Whitener],
        starts: &[ProblemValues],
    ) -> Result<Optimum, OfflineError> {
        let guess = InitialGuess { heading_sigma_rad: VAGUE_HEADING_SIGMA_RAD, ..UNGATED };
        let ground = self.pass_context(problem, whiteners);
        let mut best: Result<Optimum, OfflineError> = Err(OfflineError::NotFinite);
        for start in starts {
            let (values, _) = filter_initial_guess(ground, start, guess);
            let descended = minimize(ground, values);
            best = match (best, descended) {
                (Ok(best), Ok(other)) if other.linearised.cost >= best.linearised.cost => Ok(best),
                (_, Ok(other)) => Ok(other),
                (Ok(best), Err(_)) => Ok(best),
                (Err(_), Err(error)) => Err(error),
            };
        }
        best
    }

    /// Stores the result of a round; true if it changed nothing.
    pub(super) fn update(&mut self, values: ProblemValues, fits: &[bool], round: u32) -> bool {
        let mut is_settled = true;
        for (used, fits) in self.is_used.iter_mut().zip(fits) {
            let next = *fits && (*used || round < LAST_READMISSION_ROUND);
            is_settled &= next == *used;
            *used = next;
        }
        self.constants = values.constants;
        let delay_s = values.constants[FIX_DELAY];
        self.previous = if (delay_s - self.delay_s).abs() < SETTLED_DELAY_S {
            Some(PreviousOptimum::Same(values))
        } else {
            is_settled = false;
            self.delay_s = delay_s;
            values.poses.first().copied().map(PreviousOptimum::Moved)
        };
        is_settled
    }
}

/// Initial values for everything but the first pose.
fn initial_values(problem: &SmoothingProblem<'_>, constants: [f64; CONSTANTS], first: UnwrappedPose) -> ProblemValues {
    ProblemValues {
        poses: vec![first; problem.poses],
        biases: vec![bias_prior(problem.config).value; problem.windows.len()],
        constants,
    }
}

/// The initial values: one start, or several directions where the heading is not known.
fn candidate_starts(problem: &SmoothingProblem<'_>, constants: [f64; CONSTANTS]) -> Vec<ProblemValues> {
    let first_fix = problem.fixes.first();
    let start = problem.config.start;
    let start_pose = start.map(|start| UnwrappedPose::from_pose(start.pose));
    let at = |heading_rad: f64| {
        let nowhere = initial_values(problem, constants, UnwrappedPose::default());
        let first = match (start_pose, first_fix) {
            (Some(start_pose), _) => UnwrappedPose { heading_rad, ..start_pose },
            (None, Some(fix)) => pose_from_fix(fix, &nowhere, heading_rad),
            (None, None) => UnwrappedPose::default(),
        };
        initial_values(problem, constants, first)
    };
    let known = start.filter(|start| start.heading_sigma_rad <= VAGUE_HEADING_SIGMA_RAD);
    let fix_heading = first_fix.and_then(|fix| fix.fix.heading);
    match known.map(|start| start.pose.heading).or(fix_heading) {
        Some(heading) => vec![at(heading.rad())],
        None => {
            (0..HEADING_STARTS).map(|k| at(std::f64::consts::TAU * f64::from(k) / f64::from(HEADING_STARTS))).collect()
        }
    }
}

/// The whitener of every move; an error when the noise is not finite.
pub(super) fn whiteners(
    problem: &SmoothingProblem<'_>,
    constants: &[f64; CONSTANTS],
) -> Result<Vec<Whitener>, OfflineError> {
    problem.segments.iter().map(|by| whitener(by, problem.config, constants).ok_or(OfflineError::NotFinite)).collect()
}

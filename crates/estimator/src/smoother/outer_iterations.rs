//! What one round of the batch solution leaves to the next, and where the first one begins.
//!
//! Source: docs/maths/pose.md section B3.

use super::factors::bias_prior;
use super::fix_factors::pose_from_fix;
use super::forward_pass::{InitialGuess, PassContext, filter_initial_guess};
use super::gauss_newton::{Optimum, minimize};
use super::motion_factors::{Whitener, whitener};
use super::problem::SmoothingProblem;
use super::trajectory::OfflineError;
use super::values::{CONSTANTS, FIX_DELAY, ProblemValues, UnwrappedPose, constants_of};
use crate::filter::FilterConfig;

/// From this round on fixes are only left out and not taken back, so that the rounds end.
const LAST_READMISSION_ROUND: u32 = 8;
/// The delay of fixes is settled when a round changes it by less, s: at 1 m/s a micrometre.
const SETTLED_DELAY_S: f64 = 1e-6;
/// A heading known worse than this is tried all around, rad.
const VAGUE_HEADING_SIGMA_RAD: f64 = 0.4;
/// In how many directions.
const HEADING_STARTS: u32 = 8;
/// A first guess from all fixes in use.
const UNGATED: InitialGuess = InitialGuess { gates: [f64::INFINITY; 3], heading_sigma_rad: f64::INFINITY };

/// What one round leaves to the next.
pub(super) struct OuterIteration {
    /// By them the noise of the motion is taken.
    pub(super) constants: [f64; CONSTANTS],
    /// With which delay of fixes the poses are chosen, s.
    pub(super) delay_s: f64,
    /// Which fixes of the run are used.
    pub(super) is_used: Vec<bool>,
    previous: Option<PreviousOptimum>,
}

/// The optimum of the round before.
enum PreviousOptimum {
    /// The next problem has the same unknowns.
    Same(ProblemValues),
    /// The poses are at other instants; here is the first of them.
    Moved(UnwrappedPose),
}

impl OuterIteration {
    /// Before the first round.
    pub(super) fn initial(config: &FilterConfig, fixes: usize) -> Self {
        let constants = constants_of(&config.calibration).map(|known| known.value);
        Self { constants, delay_s: constants[FIX_DELAY], is_used: vec![true; fixes], previous: None }
    }

    /// Descends to the least cost with the fixes in use; the first round chooses them as well.
    ///
    /// # Errors
    /// Those of the descent.
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

    /// Takes over what a round found; says whether it changed nothing.
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

/// Values that know no more than a first pose.
fn initial_values(problem: &SmoothingProblem<'_>, constants: [f64; CONSTANTS], first: UnwrappedPose) -> ProblemValues {
    let (bias, _) = bias_prior(problem.config);
    ProblemValues { poses: vec![first; problem.poses], biases: vec![bias; problem.windows.len()], constants }
}

/// Where to begin: one start, or several all around where the heading is not known.
fn candidate_starts(problem: &SmoothingProblem<'_>, constants: [f64; CONSTANTS]) -> Vec<ProblemValues> {
    let first_fix = problem.fixes.first();
    let start = problem.config.start;
    let told = start.map(|start| UnwrappedPose::from_pose(start.pose));
    let at = |heading_rad: f64| {
        let nowhere = initial_values(problem, constants, UnwrappedPose::default());
        let first = match (told, first_fix) {
            (Some(told), _) => UnwrappedPose { heading_rad, ..told },
            (None, Some(seen)) => pose_from_fix(seen, &nowhere, heading_rad),
            (None, None) => UnwrappedPose::default(),
        };
        initial_values(problem, constants, first)
    };
    let known = start.filter(|start| start.heading_sigma_rad <= VAGUE_HEADING_SIGMA_RAD);
    let seen = first_fix.and_then(|seen| seen.fix.heading);
    match known.map(|start| start.pose.heading).or(seen) {
        Some(heading) => vec![at(heading.rad())],
        None => {
            (0..HEADING_STARTS).map(|k| at(std::f64::consts::TAU * f64::from(k) / f64::from(HEADING_STARTS))).collect()
        }
    }
}

/// The whitener of every move.
///
/// # Errors
/// [`OfflineError::NotFinite`] when the noise is no number.
pub(super) fn whiteners(
    problem: &SmoothingProblem<'_>,
    constants: &[f64; CONSTANTS],
) -> Result<Vec<Whitener>, OfflineError> {
    problem.segments.iter().map(|by| whitener(by, problem.config, constants).ok_or(OfflineError::NotFinite)).collect()
}

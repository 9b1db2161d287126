//! What one round of the batch solution leaves to the next, and where the first one begins.
//!
//! Source: docs/maths/batch.md section 3.

use super::OfflineError;
use super::descent::{Descended, descend};
use super::factors::bias_prior;
use super::fixes::suggested;
use super::motion::{Whitener, whitener};
use super::problem::Problem;
use super::values::{CONSTANTS, FIX_DELAY, Placed, Values, constants_of};
use super::walk::{Ground, Guess, filter};
use crate::filters::FilterConfig;

/// From this round on fixes are only left out and not taken back, so that the rounds end.
const LAST_RETURN: u32 = 8;
/// The delay of fixes is settled when a round changes it by less, s: at 1 m/s a micrometre.
const SETTLED_DELAY_S: f64 = 1e-6;
/// A heading known worse than this is tried all around, rad.
const VAGUE_HEADING_RAD: f64 = 0.4;
/// In how many directions.
const DIRECTIONS: u32 = 8;
/// A first guess from all fixes in use.
const UNGATED: Guess = Guess { gates: [f64::INFINITY; 3], heading_sigma_rad: f64::INFINITY };

/// What one round leaves to the next.
pub(super) struct Round {
    /// By them the noise of the motion is taken.
    pub(super) constants: [f64; CONSTANTS],
    /// With which delay of fixes the poses are chosen, s.
    pub(super) delay_s: f64,
    /// Which fixes of the run are used.
    pub(super) is_used: Vec<bool>,
    last: Option<Last>,
}

/// The optimum of the round before.
enum Last {
    /// The next problem has the same unknowns.
    Same(Values),
    /// The poses are at other instants; here is the first of them.
    Moved(Placed),
}

impl Round {
    /// Before the first round.
    pub(super) fn first(config: &FilterConfig, fixes: usize) -> Self {
        let constants = constants_of(&config.calibration).map(|known| known.value);
        Self { constants, delay_s: constants[FIX_DELAY], is_used: vec![true; fixes], last: None }
    }

    /// Descends to the least cost with the fixes in use; the first round chooses them as well.
    ///
    /// # Errors
    /// Those of the descent.
    pub(super) fn descend(
        &mut self,
        problem: &Problem<'_>,
        whiteners: &[Whitener],
        gates: [f64; 3],
    ) -> Result<Descended, OfflineError> {
        match self.last.take() {
            Some(Last::Same(values)) => descend(self.ground(problem, whiteners), values),
            Some(Last::Moved(first)) => {
                let ground = self.ground(problem, whiteners);
                let start = beginning(problem, self.constants, first);
                descend(ground, filter(ground, &start, UNGATED).0)
            }
            None => self.descend_anew(problem, whiteners, gates),
        }
    }

    fn descend_anew(
        &mut self,
        problem: &Problem<'_>,
        whiteners: &[Whitener],
        gates: [f64; 3],
    ) -> Result<Descended, OfflineError> {
        let starts = starts(problem, self.constants);
        let [only] = starts.as_slice() else {
            return self.best_of(problem, whiteners, &starts);
        };
        let guess = Guess { gates, ..UNGATED };
        let (values, let_through) = filter(self.ground(problem, whiteners), only, guess);
        let refused = let_through.iter().filter(|used| !**used).count();
        if 2 * refused > let_through.len() {
            // A gate that refuses most fixes has locked itself out: the fixes know better than the guess.
            return self.best_of(problem, whiteners, &starts);
        }
        self.is_used = let_through;
        descend(self.ground(problem, whiteners), values)
    }

    fn ground<'p, 'a>(&'p self, problem: &'p Problem<'a>, whiteners: &'p [Whitener]) -> Ground<'p, 'a> {
        Ground { problem, whiteners, is_used: &self.is_used }
    }

    /// Descends from each start with all fixes, and keeps the least cost.
    fn best_of(
        &self,
        problem: &Problem<'_>,
        whiteners: &[Whitener],
        starts: &[Values],
    ) -> Result<Descended, OfflineError> {
        let guess = Guess { heading_sigma_rad: VAGUE_HEADING_RAD, ..UNGATED };
        let ground = self.ground(problem, whiteners);
        let mut best: Result<Descended, OfflineError> = Err(OfflineError::NotFinite);
        for start in starts {
            let (values, _) = filter(ground, start, guess);
            let descended = descend(ground, values);
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
    pub(super) fn adopt(&mut self, values: Values, fits: &[bool], round: u32) -> bool {
        let mut is_settled = true;
        for (used, fits) in self.is_used.iter_mut().zip(fits) {
            let next = *fits && (*used || round < LAST_RETURN);
            is_settled &= next == *used;
            *used = next;
        }
        self.constants = values.constants;
        let delay_s = values.constants[FIX_DELAY];
        self.last = if (delay_s - self.delay_s).abs() < SETTLED_DELAY_S {
            Some(Last::Same(values))
        } else {
            is_settled = false;
            self.delay_s = delay_s;
            values.poses.first().copied().map(Last::Moved)
        };
        is_settled
    }
}

/// Values that know no more than a first pose.
fn beginning(problem: &Problem<'_>, constants: [f64; CONSTANTS], first: Placed) -> Values {
    let (bias, _) = bias_prior(problem.config);
    Values { poses: vec![first; problem.poses], biases: vec![bias; problem.windows.len()], constants }
}

/// Where to begin: one start, or several all around where the heading is not known.
fn starts(problem: &Problem<'_>, constants: [f64; CONSTANTS]) -> Vec<Values> {
    let first_fix = problem.fixes.first();
    let start = problem.config.start;
    let told = start.map(|start| Placed::at(start.pose));
    let at = |heading_rad: f64| {
        let nowhere = beginning(problem, constants, Placed::default());
        let first = match (told, first_fix) {
            (Some(told), _) => Placed { heading_rad, ..told },
            (None, Some(seen)) => suggested(seen, &nowhere, heading_rad),
            (None, None) => Placed::default(),
        };
        beginning(problem, constants, first)
    };
    let known = start.filter(|start| start.heading_sigma_rad <= VAGUE_HEADING_RAD);
    let seen = first_fix.and_then(|seen| seen.fix.heading);
    match known.map(|start| start.pose.heading).or(seen) {
        Some(heading) => vec![at(heading.rad())],
        None => (0..DIRECTIONS).map(|k| at(std::f64::consts::TAU * f64::from(k) / f64::from(DIRECTIONS))).collect(),
    }
}

/// The whitener of every move.
///
/// # Errors
/// [`OfflineError::NotFinite`] when the noise is no number.
pub(super) fn whiteners(problem: &Problem<'_>, constants: &[f64; CONSTANTS]) -> Result<Vec<Whitener>, OfflineError> {
    problem.moves.iter().map(|by| whitener(by, problem.config, constants).ok_or(OfflineError::NotFinite)).collect()
}

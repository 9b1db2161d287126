//! One pass over a problem in time order, with the same rows in the same order either way: to linearise it at given
//! values, or to filter a first guess (an extended information filter, in which everything active moves to the solution
//! so far after each observation).
//!
//! Source: docs/maths/pose.md sections B3 and B4.

use nalgebra::{Matrix3, Vector3};

use super::factors::{
    WhitenedRow, Whitener, bias_row, calibrated_motion, constant_row, fix_rows, motion_rows, start_rows, window_row,
};
use super::problem::{
    AssociatedFix, CONSTANTS, MotionSegment, ProblemValues, SmoothingProblem, VariableKind, VariableLayout,
};
use super::trajectory::OfflineError;
use crate::models::se2::BodyStep;
use crate::numerics::elimination::{EliminationChain, EliminationFront};
use crate::update::nis_and_log_likelihood;

#[derive(Clone, Copy)]
pub(super) struct PassContext<'p, 'a> {
    pub(super) problem: &'p SmoothingProblem<'a>,
    pub(super) whiteners: &'p [Whitener],
    pub(super) is_used: &'p [bool],
}

#[derive(Clone, Debug)]
pub(super) struct LinearizedProblem {
    /// Sum of the squared residuals at the values.
    pub(super) cost: f64,
    /// All variables, each conditional on the later ones.
    pub(super) chain: EliminationChain,
}

/// Linearises a problem at `values`; `damping` per variable shortens the step.
fn linearize(ground: PassContext<'_, '_>, values: &ProblemValues, damping: f64) -> LinearizedProblem {
    let mut walk = ForwardPass::new(ground, values.clone(), PassMode::Linearise { damping });
    walk.run();
    LinearizedProblem { cost: walk.cost, chain: walk.chain }
}

/// The gates and the prior of a filtered first guess.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct InitialGuess {
    /// Fixes whose NIS exceeds these quantiles, by their degrees of freedom, are left out; infinite for none.
    pub(super) gates: [f64; 3],
    /// Sigma of the guessed heading of the first pose; infinite adds no information.
    pub(super) heading_sigma_rad: f64,
}

/// Filters a first guess, from the first pose and the constants of `values`; returns which fixes pass the gates.
pub(super) fn filter_initial_guess(
    ground: PassContext<'_, '_>,
    values: &ProblemValues,
    guess: InitialGuess,
) -> (ProblemValues, Vec<bool>) {
    let mut walk = ForwardPass::new(ground, values.clone(), PassMode::Filter(guess));
    walk.run();
    (walk.values, walk.is_used)
}

#[derive(Clone, Copy, Debug)]
enum PassMode {
    Linearise { damping: f64 },
    Filter(InitialGuess),
}

struct ForwardPass<'p, 'a> {
    context: PassContext<'p, 'a>,
    layout: VariableLayout,
    mode: PassMode,
    values: ProblemValues,
    is_used: Vec<bool>,
    front: EliminationFront,
    chain: EliminationChain,
    cost: f64,
    /// The gyro window that has begun and not ended.
    open_window: Option<usize>,
    next_window: usize,
}

impl<'p, 'a> ForwardPass<'p, 'a> {
    fn new(context: PassContext<'p, 'a>, values: ProblemValues, mode: PassMode) -> Self {
        Self {
            context,
            layout: context.problem.layout(),
            mode,
            values,
            is_used: context.is_used.to_vec(),
            front: EliminationFront::default(),
            chain: EliminationChain::default(),
            cost: 0.0,
            open_window: None,
            next_window: 0,
        }
    }

    fn run(&mut self) {
        self.start();
        for node in 0..self.context.problem.poses {
            if node > 0 {
                self.advance_to(node);
            }
            self.use_windows(node);
            for fix in self.context.problem.fixes_at(node) {
                self.use_fix(fix);
            }
        }
        while let Some(&variable) = self.front.variables().first() {
            self.front.eliminate(variable, &mut self.chain);
        }
    }

    fn start(&mut self) {
        let problem = self.context.problem;
        for constant in 0..CONSTANTS {
            if problem.is_free[constant] {
                self.add_variable(constant);
                let value = self.values.constants[constant];
                self.add_row(&constant_row(problem.config, constant, value));
            }
        }
        self.add_pose(0);
        for row in start_rows(problem.config, self.layout, self.values.poses[0]) {
            self.add_row(&row);
        }
        if let PassMode::Filter(guess) = self.mode {
            let weight = 1.0 / guess.heading_sigma_rad;
            self.add_row(&WhitenedRow::from_residual(0.0).with_derivative(self.layout.pose(0, 2), weight));
            self.correct(0);
        }
    }

    fn add_row(&mut self, row: &WhitenedRow) {
        self.cost += row.residual * row.residual;
        self.front.add_row(row.entries(), -row.residual);
    }

    /// Poses come first in the front and constants last, so that the variable to eliminate next is first.
    fn add_variable(&mut self, variable: usize) {
        let rank = |meaning| match meaning {
            VariableKind::Pose(..) => 0,
            VariableKind::Bias(_) => 1,
            VariableKind::Constant(_) => 2,
        };
        let own = rank(self.layout.kind_of(variable));
        let position = self
            .front
            .variables()
            .iter()
            .position(|other| rank(self.layout.kind_of(*other)) > own)
            .unwrap_or(self.front.variables().len());
        self.front.add_variable(variable, position);
        if let PassMode::Linearise { damping } = self.mode
            && damping > 0.0
        {
            self.front.add_row(&[(variable, damping.sqrt())], 0.0);
        }
    }

    fn add_pose(&mut self, node: usize) {
        for row in 0..3 {
            self.add_variable(self.layout.pose(node, row));
        }
    }

    fn advance_to(&mut self, node: usize) {
        let problem = self.context.problem;
        let before = node - 1;
        if let PassMode::Filter(_) = self.mode {
            self.predict(node);
        }
        self.add_pose(node);
        let whitener = &self.context.whiteners[before];
        for row in motion_rows(problem, &self.values, before, whitener) {
            self.add_row(&row);
        }
        let is_window_start = self.open_window.is_some_and(|open| problem.windows[open].from == before);
        let last = if is_window_start { 2 } else { 3 };
        for row in 0..last {
            self.front.eliminate(self.layout.pose(before, row), &mut self.chain);
        }
    }

    /// Predicts a pose by the wheels from the one before it.
    fn predict(&mut self, node: usize) {
        let from = self.values.poses[node - 1];
        self.values.poses[node] = match self.context.problem.segments[node - 1] {
            MotionSegment::Driven { travel, .. } => {
                let config = self.context.problem.config;
                let BodyStep { forward_m, turn_rad } = calibrated_motion(travel, config, &self.values.constants).step;
                from.retract([forward_m, 0.0, turn_rad])
            }
            MotionSegment::Unobserved(_) => from,
        };
    }

    /// Closes the gyro windows that end at a pose and opens those that begin there.
    fn use_windows(&mut self, node: usize) {
        let windows = &self.context.problem.windows;
        loop {
            if let Some(index) = self.open_window {
                let window = &windows[index];
                if window.to != node {
                    return;
                }
                self.add_row(&window_row(self.layout, window, index, &self.values));
                self.correct(node);
                self.open_window = None;
                if window.from != node {
                    self.front.eliminate(self.layout.pose(window.from, 2), &mut self.chain);
                }
            } else {
                let next = windows.get(self.next_window);
                if next.is_none_or(|window| window.from != node) {
                    return;
                }
                self.open_window(self.next_window);
            }
        }
    }

    fn open_window(&mut self, index: usize) {
        if let (PassMode::Filter(_), Some(before)) = (self.mode, index.checked_sub(1)) {
            self.values.biases[index] = self.values.biases[before];
        }
        self.add_variable(VariableLayout::bias(index));
        let row = bias_row(self.context.problem, &self.values, index);
        self.add_row(&row);
        if let Some(before) = index.checked_sub(1) {
            self.front.eliminate(VariableLayout::bias(before), &mut self.chain);
        }
        self.open_window = Some(index);
        self.next_window = index + 1;
    }

    fn use_fix(&mut self, fix: &AssociatedFix) {
        let Some((rows, degrees)) = fix_rows(self.context.problem, fix, &self.values) else {
            self.is_used[fix.index] = false;
            return;
        };
        if !self.is_used[fix.index] {
            return;
        }
        if let PassMode::Filter(guess) = self.mode
            && self.nis(&rows) > guess.gates[usize::from(degrees) - 1]
        {
            self.is_used[fix.index] = false;
            return;
        }
        for row in &rows {
            self.add_row(row);
        }
        self.correct(fix.node);
    }

    /// Normalised innovation squared of whitened rows at the solution so far.
    fn nis(&self, rows: &[WhitenedRow; 3]) -> f64 {
        let white = rows.map(|row| self.front.whiten(row.entries()));
        let s = Matrix3::from_fn(|i, j| {
            let shared: f64 = white[i].iter().zip(&white[j]).map(|(a, b)| a * b).sum();
            shared + f64::from(u8::from(i == j))
        });
        let innovation = Vector3::from(rows.map(|row| row.residual));
        nis_and_log_likelihood(&innovation, &s).map_or(f64::INFINITY, |(nis, _)| nis)
    }

    /// When filtering, moves everything active to the solution so far.
    fn correct(&mut self, node: usize) {
        let (PassMode::Filter(_), Some(solved)) = (self.mode, self.front.solve()) else {
            return;
        };
        let mut moves = [(node, [0.0; 3]), (node, [0.0; 3])];
        if let Some(open) = self.open_window {
            moves[1].0 = self.context.problem.windows[open].from;
        }
        for (&variable, step) in self.front.variables().iter().zip(solved) {
            match self.layout.kind_of(variable) {
                VariableKind::Constant(constant) => self.values.constants[constant] += step,
                VariableKind::Bias(window) => self.values.biases[window] += step,
                VariableKind::Pose(of, row) => {
                    if let Some((_, xi)) = moves.iter_mut().find(|(owner, _)| *owner == of) {
                        xi[row] = step;
                    }
                }
            }
        }
        for (owner, xi) in moves {
            self.values.poses[owner] = self.values.poses[owner].retract(xi);
        }
        self.front.clear_right_hand_sides();
    }
}

// The damped Gauss-Newton descent, from a first guess to the values of least cost.
//
//     (J'J + lambda I) delta = -J'r         Levenberg (1944); units of m, rad, rad/s, s, and one for the scales
//
// lambda is zero as long as the cost falls; a step that would raise it is rejected, and lambda grows.
// Source: docs/maths/pose.md section B3.

const MAX_STEPS: u32 = 100;
/// Converged when no unknown moves by more: ten nanometres, ten nanoradians.
const CONVERGED: f64 = 1e-8;
/// The first damping; the information of one good fix is ten thousand times that.
const INITIAL_DAMPING: f64 = 1.0;
/// Smaller damping is set to zero; earlier, the undamped step would overshoot along rows known to a micrometre.
const MIN_DAMPING: f64 = 1e-6;
/// At this damping the step is far below a nanometre.
const MAX_DAMPING: f64 = 1e16;
/// Share of the cost by which rounding alone may raise it.
const ROUNDING: f64 = 1e-9;

#[derive(Clone, Debug)]
pub(super) struct Optimum {
    pub(super) values: ProblemValues,
    /// Linearised there, undamped.
    pub(super) linearised: LinearizedProblem,
    pub(super) steps: u32,
}

/// Errors: no step lowers the cost, they do not become small, or the first guess has no finite cost.
pub(super) fn minimize(ground: PassContext<'_, '_>, mut values: ProblemValues) -> Result<Optimum, OfflineError> {
    let layout = ground.problem.layout();
    let mut damping = 0.0;
    let mut here = linearize(ground, &values, damping);
    if !here.cost.is_finite() {
        return Err(OfflineError::NotFinite);
    }
    for steps in 1..=MAX_STEPS {
        let step = here.chain.solve(layout.count());
        let size = step.iter().fold(0.0_f64, |most, part| most.max(part.abs()));
        let mut there = values.clone();
        there.retract(layout, &step);
        // A maximum over NaN is none: the sum is checked as well.
        let is_finite = step.iter().sum::<f64>().is_finite();
        if is_finite && size < CONVERGED && damping == 0.0 {
            let linearised = linearize(ground, &there, 0.0);
            return Ok(Optimum { values: there, linearised, steps });
        }
        let tried = linearize(ground, &there, damping);
        if is_finite && tried.cost <= here.cost * (1.0 + ROUNDING) + ROUNDING {
            let relaxed = if damping > MIN_DAMPING { damping / 10.0 } else { 0.0 };
            values = there;
            here = if relaxed == damping { tried } else { linearize(ground, &values, relaxed) };
            damping = relaxed;
        } else {
            damping = (damping * 10.0).max(INITIAL_DAMPING);
            if damping > MAX_DAMPING {
                break;
            }
            here = linearize(ground, &values, damping);
        }
    }
    Err(OfflineError::Diverged { cost: here.cost })
}

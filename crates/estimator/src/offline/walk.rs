//! One walk over a problem in the order of time: to linearise it, or to filter a first guess.
//!
//! Both meet the same rows in the same order. To linearise, the rows are taken at given values and each variable is
//! eliminated when its last row has come. To filter, the values themselves are made on the way: each pose is predicted from
//! the one before it, and after each observation everything that is active moves to the solution so far. That is an
//! extended information filter; what it leaves behind is a first guess near enough for the descent.
//!
//! Source: docs/maths/batch.md sections 3 and 4.

use nalgebra::{Matrix3, Vector3};

use super::factors::{Row, bias_row, constant_row, start_rows, window_row};
use super::fixes::fix_rows;
use super::front::{Chain, Front};
use super::motion::{Whitener, calibrated, motion_rows};
use super::problem::{Move, Problem, SeenFix};
use super::values::{CONSTANTS, Layout, Meaning, Values};
use crate::update::consistency;

/// What a problem is walked with.
#[derive(Clone, Copy)]
pub(super) struct Ground<'p, 'a> {
    /// The problem.
    pub(super) problem: &'p Problem<'a>,
    /// For each move.
    pub(super) whiteners: &'p [Whitener],
    /// Which fixes of the run are used.
    pub(super) is_used: &'p [bool],
}

/// A linearised problem, eliminated.
#[derive(Clone, Debug)]
pub(super) struct Linearised {
    /// Sum of the squared residuals at the values.
    pub(super) cost: f64,
    /// All variables, each given the later ones.
    pub(super) chain: Chain,
}

/// Linearises a problem at `values`; `damping` per variable holds the step back.
pub(super) fn linearise(ground: Ground<'_, '_>, values: &Values, damping: f64) -> Linearised {
    let mut walk = Walk::new(ground, values.clone(), Purpose::Linearise { damping });
    walk.run();
    Linearised { cost: walk.cost, chain: walk.chain }
}

/// How a first guess is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Guess {
    /// Leaves fixes out whose NIS exceeds these quantiles, by their degrees of freedom; infinite for none.
    pub(super) gates: [f64; 3],
    /// For how well the guessed heading of the first pose is taken, rad; infinite adds nothing to what is known.
    pub(super) heading_sigma_rad: f64,
}

/// Filters a first guess, from the first pose and the constants of `values`; says which fixes the gates let through.
pub(super) fn filter(ground: Ground<'_, '_>, values: &Values, guess: Guess) -> (Values, Vec<bool>) {
    let mut walk = Walk::new(ground, values.clone(), Purpose::Filter(guess));
    walk.run();
    (walk.values, walk.is_used)
}

#[derive(Clone, Copy, Debug)]
enum Purpose {
    Linearise { damping: f64 },
    Filter(Guess),
}

struct Walk<'p, 'a> {
    ground: Ground<'p, 'a>,
    layout: Layout,
    purpose: Purpose,
    values: Values,
    is_used: Vec<bool>,
    front: Front,
    chain: Chain,
    cost: f64,
    /// The gyro window that has begun and not ended.
    open: Option<usize>,
    next_window: usize,
}

impl<'p, 'a> Walk<'p, 'a> {
    fn new(ground: Ground<'p, 'a>, values: Values, purpose: Purpose) -> Self {
        Self {
            ground,
            layout: ground.problem.layout(),
            purpose,
            values,
            is_used: ground.is_used.to_vec(),
            front: Front::default(),
            chain: Chain::default(),
            cost: 0.0,
            open: None,
            next_window: 0,
        }
    }

    fn run(&mut self) {
        self.begin();
        for node in 0..self.ground.problem.poses {
            if node > 0 {
                self.step_to(node);
            }
            self.use_windows(node);
            for seen in self.ground.problem.fixes_at(node) {
                self.use_fix(seen);
            }
        }
        while let Some(&variable) = self.front.variables().first() {
            self.front.eliminate(variable, &mut self.chain);
        }
    }

    fn begin(&mut self) {
        let problem = self.ground.problem;
        for constant in 0..CONSTANTS {
            if problem.is_free[constant] {
                self.introduce(constant);
                let value = self.values.constants[constant];
                self.take(&constant_row(problem.config, constant, value));
            }
        }
        self.introduce_pose(0);
        for row in start_rows(problem.config, self.layout, self.values.poses[0]) {
            self.take(&row);
        }
        if let Purpose::Filter(guess) = self.purpose {
            let weight = 1.0 / guess.heading_sigma_rad;
            self.take(&Row::of(0.0).with(self.layout.pose(0, 2), weight));
            self.correct(0);
        }
    }

    fn take(&mut self, row: &Row) {
        self.cost += row.residual * row.residual;
        self.front.absorb(row.entries(), -row.residual);
    }

    /// Poses come before all others in the front and biases before constants, so that what is eliminated next stands first.
    fn introduce(&mut self, variable: usize) {
        let rank = |meaning| match meaning {
            Meaning::Pose(..) => 0,
            Meaning::Bias(_) => 1,
            Meaning::Constant(_) => 2,
        };
        let own = rank(self.layout.meaning(variable));
        let position = self
            .front
            .variables()
            .iter()
            .position(|other| rank(self.layout.meaning(*other)) > own)
            .unwrap_or(self.front.variables().len());
        self.front.introduce(variable, position);
        if let Purpose::Linearise { damping } = self.purpose
            && damping > 0.0
        {
            self.front.absorb(&[(variable, damping.sqrt())], 0.0);
        }
    }

    fn introduce_pose(&mut self, node: usize) {
        for row in 0..3 {
            self.introduce(self.layout.pose(node, row));
        }
    }

    fn step_to(&mut self, node: usize) {
        let problem = self.ground.problem;
        let before = node - 1;
        if let Purpose::Filter(_) = self.purpose {
            self.predict(node);
        }
        self.introduce_pose(node);
        let whitener = &self.ground.whiteners[before];
        for row in motion_rows(problem, &self.values, before, whitener) {
            self.take(&row);
        }
        let is_window_start = self.open.is_some_and(|open| problem.windows[open].from == before);
        let last = if is_window_start { 2 } else { 3 };
        for row in 0..last {
            self.front.eliminate(self.layout.pose(before, row), &mut self.chain);
        }
    }

    /// Puts a pose where the wheels lead from the one before it.
    fn predict(&mut self, node: usize) {
        let from = self.values.poses[node - 1];
        self.values.poses[node] = match self.ground.problem.moves[node - 1] {
            Move::Driven { travel, .. } => {
                let config = self.ground.problem.config;
                let step = calibrated(travel, config, &self.values.constants);
                from.moved([step.forward_m, 0.0, step.turn_rad])
            }
            Move::Unseen(_) => from,
        };
    }

    /// Closes the gyro windows that end at a pose and opens those that begin there.
    fn use_windows(&mut self, node: usize) {
        let windows = &self.ground.problem.windows;
        loop {
            if let Some(index) = self.open {
                let window = &windows[index];
                if window.to != node {
                    return;
                }
                self.take(&window_row(self.layout, window, index, &self.values));
                self.correct(node);
                self.open = None;
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
        if let (Purpose::Filter(_), Some(before)) = (self.purpose, index.checked_sub(1)) {
            self.values.biases[index] = self.values.biases[before];
        }
        self.introduce(Layout::bias(index));
        let row = bias_row(self.ground.problem, &self.values, index);
        self.take(&row);
        if let Some(before) = index.checked_sub(1) {
            self.front.eliminate(Layout::bias(before), &mut self.chain);
        }
        self.open = Some(index);
        self.next_window = index + 1;
    }

    fn use_fix(&mut self, seen: &SeenFix) {
        let Some((rows, degrees)) = fix_rows(self.ground.problem, seen, &self.values) else {
            self.is_used[seen.index] = false;
            return;
        };
        if !self.is_used[seen.index] {
            return;
        }
        if let Purpose::Filter(guess) = self.purpose
            && self.nis(&rows) > guess.gates[usize::from(degrees) - 1]
        {
            self.is_used[seen.index] = false;
            return;
        }
        for row in &rows {
            self.take(row);
        }
        self.correct(seen.node);
    }

    /// Normalised innovation squared of whitened rows at the solution so far.
    fn nis(&self, rows: &[Row; 3]) -> f64 {
        let white = rows.map(|row| self.front.whitened(row.entries()));
        let s = Matrix3::from_fn(|i, j| {
            let shared: f64 = white[i].iter().zip(&white[j]).map(|(a, b)| a * b).sum();
            shared + f64::from(u8::from(i == j))
        });
        let innovation = Vector3::from(rows.map(|row| row.residual));
        consistency(&innovation, &s).map_or(f64::INFINITY, |(nis, _)| nis)
    }

    /// When filtering, moves everything active to the solution so far.
    fn correct(&mut self, node: usize) {
        let (Purpose::Filter(_), Some(solved)) = (self.purpose, self.front.solve()) else {
            return;
        };
        let mut moves = [(node, [0.0; 3]), (node, [0.0; 3])];
        if let Some(open) = self.open {
            moves[1].0 = self.ground.problem.windows[open].from;
        }
        for (&variable, step) in self.front.variables().iter().zip(solved) {
            match self.layout.meaning(variable) {
                Meaning::Constant(constant) => self.values.constants[constant] += step,
                Meaning::Bias(window) => self.values.biases[window] += step,
                Meaning::Pose(of, row) => {
                    if let Some((_, xi)) = moves.iter_mut().find(|(owner, _)| *owner == of) {
                        xi[row] = step;
                    }
                }
            }
        }
        for (owner, xi) in moves {
            self.values.poses[owner] = self.values.poses[owner].moved(xi);
        }
        self.front.clear_right_hand_sides();
    }
}

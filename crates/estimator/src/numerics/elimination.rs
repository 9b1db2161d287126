//! Elimination of one variable at a time by plane rotations: a sparse QR factorisation along a chain.
//!
//! Rows come in the order of time and touch only the active variables, the *front*; a variable that no later row
//! touches is eliminated into the triangle R. The normal equations are never formed: rows whose weights differ by 1e9
//! would lose all digits when squared.
//!
//! ```text
//! minimise |A delta - rhs|^2          A = Q R
//! r_v delta_v + sum r_s delta_s = rhs_v                      one conditional per variable v, s the front that it leaves
//! cov(v, s') = -(1/r_v) sum r_s cov(s, s')                   in reverse order: the joint covariance of each front,
//! var v      = (1 - r_v sum r_s cov(s, v)) / r_v^2           which is Takahashi's selected inverse on a chain
//! ```
//! Source: Bierman (1977), chapters 4 and 5; Takahashi, Fagan and Chen (1973); docs/maths/pose.md section B4.

/// Most active variables: two poses, the heading where a window began, two biases and six constants are 15.
const CAPACITY: usize = 16;
/// Index of a row's right-hand side.
const RHS: usize = CAPACITY;

/// A variable's number, from zero.
pub(crate) type Variable = usize;

/// One row of a triangle: coefficients by position in the front, then the right-hand side.
type Coefficients = [f64; CAPACITY + 1];

/// The active variables and the triangle over them.
#[derive(Clone, Debug, Default)]
pub(crate) struct EliminationFront {
    variables: Vec<Variable>,
    /// Upper triangle: row i begins at column i.
    triangle: Vec<Coefficients>,
}

impl EliminationFront {
    /// In the order of the triangle.
    pub(crate) fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// Makes an unobserved variable active, before the one at `position`.
    pub(crate) fn add_variable(&mut self, variable: Variable, position: usize) {
        let count = self.variables.len();
        for row in &mut self.triangle {
            row.copy_within(position..count, position + 1);
            row[position] = 0.0;
        }
        self.variables.insert(position, variable);
        self.triangle.insert(position, [0.0; CAPACITY + 1]);
    }

    /// Adds a row of the problem; ignores its entries for inactive variables.
    pub(crate) fn add_row(&mut self, entries: &[(Variable, f64)], rhs: f64) {
        let mut row = self.dense(entries);
        row[RHS] = rhs;
        let count = self.variables.len();
        for (position, own) in self.triangle.iter_mut().enumerate() {
            if row[position] != 0.0 {
                rotate(own, &mut row, position, count);
            }
        }
    }

    fn dense(&self, entries: &[(Variable, f64)]) -> Coefficients {
        let mut row = [0.0; CAPACITY + 1];
        for &(variable, coefficient) in entries {
            if let Some(position) = self.position(variable) {
                row[position] += coefficient;
            }
        }
        row
    }

    fn position(&self, variable: Variable) -> Option<usize> {
        self.variables.iter().position(|other| *other == variable)
    }

    /// Eliminates a variable into the chain; ignores one that is not active.
    pub(crate) fn eliminate(&mut self, variable: Variable, chain: &mut EliminationChain) {
        let Some(position) = self.position(variable) else {
            return;
        };
        self.move_to_front(position);
        let count = self.variables.len();
        let row = self.triangle.remove(0);
        self.variables.remove(0);
        chain.conditionals.push(GaussianConditional {
            variable,
            diagonal: row[0],
            rhs: row[RHS],
            first: chain.coefficients.len(),
        });
        chain.variables.extend_from_slice(&self.variables);
        chain.coefficients.extend_from_slice(&row[1..count]);
        for row in &mut self.triangle {
            row.copy_within(1..count, 0);
            row[count - 1] = 0.0;
        }
    }

    fn move_to_front(&mut self, position: usize) {
        let count = self.variables.len();
        self.variables[..=position].rotate_right(1);
        for row in &mut self.triangle[..=position] {
            row[..=position].rotate_right(1);
        }
        for below in (1..=position).rev() {
            let (upper, lower) = self.triangle.split_at_mut(below);
            rotate(&mut upper[below - 1], &mut lower[0], 0, count);
        }
    }

    /// The solution for the active variables so far, in their order; `None` while one of them is unobserved.
    pub(crate) fn solve(&self) -> Option<[f64; CAPACITY]> {
        let mut solved = [0.0; CAPACITY];
        for (i, row) in self.triangle.iter().enumerate().rev() {
            let known: f64 = (i + 1..self.variables.len()).map(|j| row[j] * solved[j]).sum();
            let value = (row[RHS] - known) / row[i];
            if !value.is_finite() {
                return None;
            }
            solved[i] = value;
        }
        Some(solved)
    }

    /// Clears the right-hand sides after the linearisation point has moved to the solution.
    pub(crate) fn clear_right_hand_sides(&mut self) {
        for row in &mut self.triangle {
            row[RHS] = 0.0;
        }
    }

    /// R'^-1 h: its squared length is the variance of h delta.
    pub(crate) fn whiten(&self, entries: &[(Variable, f64)]) -> [f64; CAPACITY] {
        let row = self.dense(entries);
        let mut solved = [0.0; CAPACITY];
        for i in 0..self.variables.len() {
            let known: f64 = (0..i).map(|j| self.triangle[j][i] * solved[j]).sum();
            solved[i] = (row[i] - known) / self.triangle[i][i];
        }
        solved
    }
}

/// Rotates two rows so that the lower one is zero at `column`; both are zero before it.
fn rotate(upper: &mut Coefficients, lower: &mut Coefficients, column: usize, count: usize) {
    let (a, b) = (upper[column], lower[column]);
    if b == 0.0 {
        return;
    }
    let length = (a * a + b * b).sqrt();
    let (c, s) = (a / length, b / length);
    let turned = |up: f64, low: f64| (c * up + s * low, c * low - s * up);
    for (up, low) in upper[column..count].iter_mut().zip(&mut lower[column..count]) {
        (*up, *low) = turned(*up, *low);
    }
    (upper[RHS], lower[RHS]) = turned(upper[RHS], lower[RHS]);
    lower[column] = 0.0;
}

/// The eliminated variables, in their order, each conditional on those that were active after it.
#[derive(Clone, Debug, Default)]
pub(crate) struct EliminationChain {
    conditionals: Vec<GaussianConditional>,
    variables: Vec<Variable>,
    coefficients: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct GaussianConditional {
    variable: Variable,
    diagonal: f64,
    rhs: f64,
    /// Where its coefficients begin; they end where those of the next one begin.
    first: usize,
}

impl EliminationChain {
    fn parents(&self, index: usize) -> (&[Variable], &[f64]) {
        let first = self.conditionals[index].first;
        let end = self.conditionals.get(index + 1).map_or(self.coefficients.len(), |next| next.first);
        (&self.variables[first..end], &self.coefficients[first..end])
    }

    /// The solution by variable; not finite for a variable that was never observed.
    pub(crate) fn solve(&self, count: usize) -> Vec<f64> {
        let mut solved = vec![0.0; count];
        for (index, conditional) in self.conditionals.iter().enumerate().rev() {
            let (others, coefficients) = self.parents(index);
            let known: f64 =
                others.iter().zip(coefficients).map(|(other, coefficient)| coefficient * solved[*other]).sum();
            solved[conditional.variable] = (conditional.rhs - known) / conditional.diagonal;
        }
        solved
    }

    /// Visits every variable, the last eliminated first, with the joint covariance of it and of those active after it.
    pub(crate) fn visit_covariances(&self, mut visit: impl FnMut(Variable, &JointCovariance)) {
        let mut joint = JointCovariance::default();
        for (index, conditional) in self.conditionals.iter().enumerate().rev() {
            let (others, coefficients) = self.parents(index);
            joint = joint.extended(others, coefficients, conditional);
            visit(conditional.variable, &joint);
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct JointCovariance {
    variables: Vec<Variable>,
    matrix: [[f64; CAPACITY]; CAPACITY],
}

impl JointCovariance {
    /// Zero where one of the two is not estimated.
    pub(crate) fn between(&self, a: Variable, b: Variable) -> f64 {
        let index_of = |variable| self.variables.iter().position(|own| *own == variable);
        match (index_of(a), index_of(b)) {
            (Some(row), Some(column)) => self.matrix[row][column],
            _ => 0.0,
        }
    }

    fn extended(&self, others: &[Variable], coefficients: &[f64], own: &GaussianConditional) -> Self {
        let mut indices = [0; CAPACITY];
        for (index, other) in indices.iter_mut().zip(others) {
            // Every variable that was active after this one was eliminated later, so it is there.
            *index = self.variables.iter().position(|v| v == other).unwrap_or(0);
        }
        let count = others.len();
        let mut matrix = [[0.0; CAPACITY]; CAPACITY];
        for (row, from_row) in indices.iter().enumerate().take(count) {
            for (column, from_column) in indices.iter().enumerate().take(count) {
                matrix[row][column] = self.matrix[*from_row][*from_column];
            }
        }
        let mut variance = 1.0 / (own.diagonal * own.diagonal);
        for row in 0..count {
            let sum: f64 = (0..count).map(|i| coefficients[i] * matrix[row][i]).sum();
            let cross = -sum / own.diagonal;
            matrix[row][count] = cross;
            matrix[count][row] = cross;
            variance -= coefficients[row] * cross / own.diagonal;
        }
        matrix[count][count] = variance;
        let mut variables = Vec::with_capacity(count + 1);
        variables.extend_from_slice(others);
        variables.push(own.variable);
        Self { variables, matrix }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// Rows over four variables, eliminated in the order 1, 0, 3, 2 as soon as nothing follows.
    const ROWS: [(&[(Variable, f64)], f64); 7] = [
        (&[(0, 2.0)], 1.0),
        (&[(0, -1.0), (1, 1.0)], 0.3),
        (&[(1, 0.5), (2, 1e6)], -2.0),
        (&[(0, 1.0), (2, 0.4)], 0.7),
        (&[(2, -3.0), (3, 2.0)], 0.1),
        (&[(3, 0.2)], 5.0),
        (&[(2, 0.9), (3, -0.3)], 1.5),
    ];

    fn eliminated() -> EliminationChain {
        let (mut front, mut chain) = (EliminationFront::default(), EliminationChain::default());
        for (variable, position) in [(2, 0), (0, 0), (1, 1)] {
            front.add_variable(variable, position);
        }
        for (entries, rhs) in &ROWS[..4] {
            front.add_row(entries, *rhs);
        }
        front.eliminate(1, &mut chain);
        front.eliminate(0, &mut chain);
        front.add_variable(3, 0);
        for (entries, rhs) in &ROWS[4..] {
            front.add_row(entries, *rhs);
        }
        front.eliminate(3, &mut chain);
        front.eliminate(2, &mut chain);
        chain
    }

    fn dense() -> (DMatrix<f64>, DVector<f64>) {
        let mut matrix = DMatrix::zeros(7, 4);
        for (row, (entries, _)) in ROWS.iter().enumerate() {
            for (variable, coefficient) in *entries {
                matrix[(row, *variable)] = *coefficient;
            }
        }
        (matrix, DVector::from_iterator(7, ROWS.map(|row| row.1)))
    }

    #[test]
    fn the_solution_is_that_of_the_dense_problem() {
        let (matrix, rhs) = dense();
        let expected = matrix.svd(true, true).solve(&rhs, 0.0).unwrap();
        let solved = eliminated().solve(4);
        for (own, other) in solved.iter().zip(expected.iter()) {
            assert!((own - other).abs() < 1e-9, "{solved:?} {expected}");
        }
    }

    #[test]
    fn joint_covariances_are_blocks_of_the_inverse() {
        let (matrix, _) = dense();
        let inverse = (matrix.transpose() * &matrix).try_inverse().unwrap();
        let mut visited = 0;
        eliminated().visit_covariances(|variable, joint| {
            for &other in &joint.variables {
                let (own, expected) = (joint.between(variable, other), inverse[(variable, other)]);
                assert!((own - expected).abs() < 1e-9, "{variable} {other}: {own} {expected}");
                visited += 1;
            }
        });
        assert_eq!(visited, 3 + 2 + 2 + 1);
    }

    #[test]
    fn a_variable_that_nothing_observes_has_no_solution() {
        let mut front = EliminationFront::default();
        front.add_variable(0, 0);
        front.add_variable(1, 1);
        front.add_row(&[(0, 1.0)], 2.0);
        assert!(front.solve().is_none());
        front.add_row(&[(1, 2.0)], 1.0);
        assert_eq!(front.solve().map(|x| (x[0], x[1])), Some((2.0, 0.5)));
        assert_eq!(front.whiten(&[(1, 1.0)])[1], 0.5);
    }
}

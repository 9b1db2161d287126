//! Errors of a path, and the number of drives in which one method is worse than another.
//!
//! # Model
//! ```text
//! e_k     distance of (x, y) to the reference after row k; heading the short way; speeds against central differences of the truth
//! rms     sqrt(mean(e_k^2)) over the rows that have a reference; none if one of these e_k is not finite: the method diverged
//! order   method i is worse than method i + 1 in a drive when its rms is larger there; equal ones are not worse
//! p       two-sided sign test: the probability that a tossed coin is as uneven, drives without a tie
//! share   of the drives in which the step holds, and its 95 % interval by Wilson
//! ratio   exp of the mean of ln(rms_i / rms_(i+1)) over the drives, and its 95 % interval by the normal quantile 1.96
//! verdict none for fewer than 100 drives
//! ```
//! Source: W. J. Conover, Practical Nonparametric Statistics (1999), section 3.4, for the sign test.

use posebridge_estimator::numerics::statistics::NORMAL_95;
use posebridge_telemetry::UncertainValue;
use posebridge_telemetry::quantities::wrap_rad;

use super::methods::DriveState;
use super::table::SensorTable;
use crate::statistics::{RunningMean, uncertain_mean};

/// Fewer drives have no verdict.
const MIN_VERDICT_DRIVES: u64 = 100;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorMetric {
    /// Over the whole drive, rms, m.
    Position,
    /// After the last row, m.
    End,
    /// Over the whole drive, rms, rad.
    Heading,
    /// Rms, m/s.
    Forward,
    /// Rms, rad/s.
    Turn,
}

impl ErrorMetric {
    /// All, with their keys in JSON.
    pub const KEYS: [(&str, Self); 5] = [
        ("position_rms_m", Self::Position),
        ("position_end_m", Self::End),
        ("heading_rms_rad", Self::Heading),
        ("forward_rms_m_per_s", Self::Forward),
        ("turn_rms_rad_per_s", Self::Turn),
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Position => "position rms",
            Self::End => "position at the end",
            Self::Heading => "heading rms",
            Self::Forward => "forward speed rms",
            Self::Turn => "turn rate rms",
        }
    }
}

/// Errors of one method over one drive; `None` without a reference, and where the method diverged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathErrors {
    pub position_m: Option<f64>,
    pub end_m: Option<f64>,
    pub heading_rad: Option<f64>,
    pub forward_m_per_s: Option<f64>,
    pub turn_rad_per_s: Option<f64>,
    pub diverged: bool,
}

impl PathErrors {
    pub const fn value(&self, metric: ErrorMetric) -> Option<f64> {
        match metric {
            ErrorMetric::Position => self.position_m,
            ErrorMetric::End => self.end_m,
            ErrorMetric::Heading => self.heading_rad,
            ErrorMetric::Forward => self.forward_m_per_s,
            ErrorMetric::Turn => self.turn_rad_per_s,
        }
    }
}

/// `path` has one state for each row of the table.
pub fn path_errors(table: &SensorTable, path: &[DriveState], camera_every: usize) -> PathErrors {
    let [mut position, mut heading, mut forward, mut turn] = [RunningMean::default(); 4];
    let mut end_m = None;
    let references = table.references(camera_every);
    for (row, (state, reference)) in path.iter().zip(references).enumerate() {
        let Some(reference) = reference else { continue };
        let square_m2 = (state[0] - reference.x_m).powi(2) + (state[1] - reference.y_m).powi(2);
        position.add(square_m2);
        end_m = Some(square_m2.sqrt()).filter(|end_m| end_m.is_finite());
        if let Some(theta_deg) = reference.theta_deg {
            heading.add(wrap_rad(state[2] - theta_deg.to_radians()).powi(2));
        }
        if let Some([v, w]) = true_speeds(table, row) {
            forward.add((state[3] - v).powi(2));
            turn.add((state[4] - w).powi(2));
        }
    }
    // A square that is not finite stays in the mean: a method that diverged has no error.
    let roots = [position, heading, forward, turn].map(|squares| squares.root());
    let [position_m, heading_rad, forward_m_per_s, turn_rad_per_s] =
        roots.map(|root| root.filter(|root| root.is_finite()));
    let diverged = roots.into_iter().flatten().any(|root| !root.is_finite());
    PathErrors { position_m, end_m, heading_rad, forward_m_per_s, turn_rad_per_s, diverged }
}

/// v and w at a row, by central differences of the neighbouring true poses.
pub fn true_speeds(table: &SensorTable, row: usize) -> Option<[f64; 2]> {
    let before = table.rows.get(row.checked_sub(1)?)?;
    let after = table.rows.get(row + 1)?;
    let (from, to, at) = (before.truth?, after.truth?, table.rows.get(row)?.truth?);
    let dt_s = after.time_s - before.time_s;
    let (sin, cos) = at.theta_deg?.to_radians().sin_cos();
    let forward_m = (to.x_m - from.x_m) * cos + (to.y_m - from.y_m) * sin;
    let turned_rad = wrap_rad((to.theta_deg? - from.theta_deg?).to_radians());
    Some([forward_m / dt_s, turned_rad / dt_s])
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderStep {
    /// Should be worse.
    pub worse: &'static str,
    /// Should be better.
    pub better: &'static str,
    pub holds: u64,
    pub drives: u64,
    pub sign_p: f64,
    /// Geometric mean of the ratio of the errors, worse over better, with its 95 % interval; `None` for fewer than two drives, and
    /// where an error is exactly zero.
    pub ratio: Option<[f64; 3]>,
}

impl OrderStep {
    pub fn share(&self) -> f64 {
        self.holds as f64 / self.drives.max(1) as f64
    }

    /// Whether the error decreases on average: the 95 % interval of the ratio lies above one.
    pub fn holds_on_average(&self) -> bool {
        self.ratio.is_some_and(|ratio| ratio[1] > 1.0)
    }

    pub fn as_text(&self) -> &'static str {
        match self.ratio {
            _ if self.drives < MIN_VERDICT_DRIVES => "fewer than 100 drives",
            _ if self.share() >= 0.95 => "holds",
            _ if self.holds_on_average() => "on average only",
            Some([_, _, most]) if most < 1.0 => "the other way round",
            Some(_) => "no difference on average",
            None => "no ratio on average",
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct MethodOrder {
    pub steps: Vec<OrderStep>,
    pub all_hold: u64,
    pub drives: u64,
    /// Drives omitted because a method diverged or had no reference.
    pub excluded: u64,
}

impl MethodOrder {
    /// Whether the error of each step decreases on average.
    pub fn holds_on_average(&self) -> bool {
        !self.steps.is_empty() && self.steps.iter().all(OrderStep::holds_on_average)
    }
}

/// Compares methods in the claimed order, from the worst to the best. `runs` has the errors of all methods, in the same order, for each
/// drive; a drive in which one has none is omitted.
pub fn compare_order(names: &[&'static str], runs: &[Vec<PathErrors>], metric: ErrorMetric) -> MethodOrder {
    let figures: Vec<Vec<f64>> =
        runs.iter().filter_map(|run| run.iter().map(|errors| errors.value(metric)).collect()).collect();
    let steps = names.windows(2).enumerate();
    let steps = steps.filter_map(|(index, pair)| {
        let [worse, better] = pair else { return None };
        let pairs: Vec<[f64; 2]> =
            figures.iter().filter_map(|run| Some([*run.get(index)?, *run.get(index + 1)?])).collect();
        Some(order_step(worse, better, &pairs))
    });
    let falls = |run: &&Vec<f64>| run.windows(2).all(|pair| pair[0] > pair[1]);
    MethodOrder {
        steps: steps.collect(),
        all_hold: figures.iter().filter(falls).count() as u64,
        drives: figures.len() as u64,
        excluded: (runs.len() - figures.len()) as u64,
    }
}

fn order_step(worse: &'static str, better: &'static str, pairs: &[[f64; 2]]) -> OrderStep {
    let holds = pairs.iter().filter(|[one, other]| one > other).count() as u64;
    let fails = pairs.iter().filter(|[one, other]| one < other).count() as u64;
    let logs: Vec<f64> = pairs.iter().map(|[one, other]| (one / other).ln()).collect();
    OrderStep {
        worse,
        better,
        holds,
        drives: pairs.len() as u64,
        sign_p: sign_test(holds, fails),
        ratio: geometric_mean(&logs),
    }
}

fn geometric_mean(logs: &[f64]) -> Option<[f64; 3]> {
    if logs.iter().any(|log| !log.is_finite()) {
        return None;
    }
    let UncertainValue { value: mean, sigma } = uncertain_mean(logs)?;
    let half = NORMAL_95 * sigma;
    Some([mean, mean - half, mean + half].map(f64::exp))
}

/// The probability that a fair coin is at least as uneven.
fn sign_test(one: u64, other: u64) -> f64 {
    let n = one + other;
    let fewer = one.min(other);
    // ln of n over k, from one k to the next; in logarithms because 2^-n is no number for a large n.
    let mut log_choose = 0.0;
    let mut tail = 0.0;
    for k in 0..=fewer {
        tail += (log_choose - n as f64 * std::f64::consts::LN_2).exp();
        log_choose += ((n - k) as f64).ln() - ((k + 1) as f64).ln();
    }
    f64::min(2.0 * tail, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::square::table::{MeasuredPose, SensorRow};
    use posebridge_telemetry::Timestamp;

    fn table(truth: &[(f64, f64, f64)]) -> SensorTable {
        let rows = truth.iter().enumerate().map(|(index, (x, y, theta))| SensorRow {
            truth: Some(MeasuredPose { x_m: *x, y_m: *y, theta_deg: Some(*theta) }),
            ..SensorRow::empty(Timestamp::from_millis(100 * index as i64))
        });
        SensorTable { rows: rows.collect(), ..SensorTable::default() }
    }

    #[test]
    fn errors_are_those_computed_by_hand() {
        // Northwards at 1 m/s, turning at 100 degrees/s.
        let table = table(&[(0.0, 0.0, 80.0), (0.0, 0.1, 90.0), (0.0, 0.2, 100.0)]);
        let path =
            [[9.0; 5], [0.3, 0.5, 92.0_f64.to_radians(), 1.5, 0.0], [0.0, 0.2, -258.0_f64.to_radians(), 9.0, 9.0]];
        let errors = path_errors(&table, &path, 10);
        assert!((errors.position_m.unwrap() - f64::sqrt(0.125)).abs() < 1e-12);
        assert!(errors.end_m.unwrap() < 1e-12);
        assert!((errors.heading_rad.unwrap() - 2.0_f64.to_radians()).abs() < 1e-12);
        assert!((errors.forward_m_per_s.unwrap() - 0.5).abs() < 1e-12);
        assert!((errors.turn_rad_per_s.unwrap() - 100.0_f64.to_radians()).abs() < 1e-9);
    }

    #[test]
    fn an_order_counts_drives_and_ties_do_not_hold() {
        let run = |a, b, c| [a, b, c].map(|m| PathErrors { position_m: Some(m), ..PathErrors::default() }).to_vec();
        let runs = [run(3.0, 2.0, 1.0), run(3.0, 2.0, 2.0), run(1.0, 2.0, 1.0), vec![PathErrors::default(); 3]];
        let order = compare_order(&["a", "b", "c"], &runs, ErrorMetric::Position);
        assert_eq!((order.all_hold, order.drives, order.excluded), (1, 3, 1));
        assert_eq!((order.steps[0].holds, order.steps[1].holds), (2, 2));
        // (3/2 3/2 1/2)^(1/3)
        assert!((order.steps[0].ratio.unwrap()[0] - 1.125_f64.cbrt()).abs() < 1e-12);
        assert!(!order.holds_on_average());
        assert_eq!(order.steps[0].as_text(), "fewer than 100 drives");
        let verdict = |pairs: &[[f64; 2]]| order_step("a", "b", &pairs.repeat(50)).as_text();
        assert_eq!(verdict(&[[2.0, 1.0], [3.0, 2.0]]), "holds");
        assert_eq!(verdict(&[[2.0, 1.0], [2.1, 1.0], [0.9, 1.0], [2.0, 1.0], [2.0, 1.0]]), "on average only");
        assert_eq!(verdict(&[[1.0, 2.0], [1.0, 2.1]]), "the other way round");
        assert_eq!(verdict(&[[1.0, 2.0], [2.0, 1.0]]), "no difference on average");
        let exact = order_step("a", "b", &[[2.0, 1.0], [0.0, 1.0], [2.0, 1.0]].repeat(50));
        assert_eq!((exact.ratio, exact.as_text()), (None, "no ratio on average"));
    }

    #[test]
    fn who_diverges_has_no_error_instead_of_that_of_its_good_rows() {
        let table = table(&[(0.0, 0.0, 90.0), (0.0, 0.1, 90.0), (0.0, 0.2, 90.0)]);
        let good = [0.0, 0.1, 1.0, 1.0, 0.0];
        let path = [good, [f64::NAN, 0.1, 1.0, f64::INFINITY, 0.0], good];
        let errors = path_errors(&table, &path, 10);
        assert!(errors.diverged);
        assert_eq!((errors.position_m, errors.forward_m_per_s), (None, None));
        // What stayed finite is compared.
        assert!(errors.end_m.is_some() && errors.heading_rad.is_some());
        assert!(!path_errors(&table, &[good; 3], 10).diverged);
    }

    #[test]
    fn an_order_holds_on_average_if_each_step_does() {
        let error = |position_m: f64| PathErrors { position_m: Some(position_m), ..PathErrors::default() };
        let run = |all: [f64; 3]| all.map(error).to_vec();
        let names = ["a", "b", "c"];
        // One drive falls out, and the ratios of both steps stay above one.
        let falls = [[3.0, 2.0, 1.0], [3.1, 2.1, 1.0], [3.0, 2.1, 1.1], [1.9, 2.0, 1.0]];
        let falls = compare_order(&names, &falls.map(run), ErrorMetric::Position);
        assert!(falls.holds_on_average());
        assert_eq!(falls.all_hold, 3);
        // The second step does the opposite.
        let rises = [[3.0, 2.0, 2.5], [3.1, 2.1, 2.6]];
        assert!(!compare_order(&names, &rises.map(run), ErrorMetric::Position).holds_on_average());
        assert!(!MethodOrder::default().holds_on_average());
    }

    #[test]
    fn the_sign_test_agrees_with_binomials_by_hand() {
        // 2 (1 + 10) / 2^10, and the whole of it.
        assert!((sign_test(1, 9) - 22.0 / 1024.0).abs() < 1e-12);
        assert!((sign_test(9, 1) - 22.0 / 1024.0).abs() < 1e-12);
        assert_eq!(sign_test(5, 5), 1.0);
        assert_eq!(sign_test(0, 0), 1.0);
        assert!(sign_test(0, 5_000) == 0.0, "too little for a number");
    }
}

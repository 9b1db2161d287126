//! The robots for which the claim of paper 4 holds: many robots, each with its own wheels and accelerometers, and the line between those
//! that accelerometers help and those that they do not.
//!
//! ```text
//! e_w = sigma_b pi / 2                                  error of a quarter turn by wheels whose track is known to sigma_b
//! e_a = (sigma_a sqrt(2 dt) / b) sqrt(T^3 / 12)         the same by two accelerometers, docs/lab/indirect.md (4)
//! P(helped) = 1 / (1 + e^-(c_0 + c_w ln e_w + c_a ln e_a))      boundary at one half: e_a = K e_w^p, K = e^(-c_0/c_a), p = -c_w/c_a
//! ```
//! It draws robots and judges their ends; driving them is the caller's.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Vector3};
use posebridge_estimator::numerics::statistics::{root_mean_square, wilson_interval_95};
use posebridge_report::metrics::PoseError;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Range of the drawn one-sigma errors of the effective track, relative.
const TRACK_SIGMAS: (f64, f64) = (0.003, 0.15);
/// Range of the drawn noises of an accelerometer sample, m/s²: from better than any MEMS sensor to an NXT's.
const ACCELEROMETER_SIGMAS: (f64, f64) = (0.001, 0.3);
/// A robot is helped if its end error becomes this share of the wheels' or less. Pure chance passes 1 in half of the robots.
const HELPED_SHARE: f64 = 0.75;
/// Keeps the coefficients finite where a line separates all robots.
const RIDGE: f64 = 0.01;
/// Newton's method needs about eight.
const NEWTON_STEPS: usize = 50;

/// What is drawn of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawnRobot {
    pub track_scale_sigma: f64,
    pub accelerometer_m_per_s2: f64,
}

/// Both are drawn uniformly in their logarithms.
pub fn draw_robots(seed: u64, robots: u32) -> Vec<DrawnRobot> {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut draw = |(low, high): (f64, f64)| low * (high / low).powf(random.random::<f64>());
    let drawn = (0..robots).map(|_| DrawnRobot {
        track_scale_sigma: draw(TRACK_SIGMAS),
        accelerometer_m_per_s2: draw(ACCELEROMETER_SIGMAS),
    });
    drawn.collect()
}

/// One-sigma errors of a quarter turn, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurnErrors {
    pub wheels_rad: f64,
    pub accelerometers_rad: f64,
}

impl DrawnRobot {
    /// `turn_s` is the length of a turn, `sample_s` the interval of the accelerometers' samples.
    pub fn turn_errors(&self, track_width_m: f64, turn_s: f64, sample_s: f64) -> TurnErrors {
        let white = self.accelerometer_m_per_s2 * (2.0 * sample_s).sqrt() / track_width_m;
        TurnErrors {
            wheels_rad: self.track_scale_sigma * FRAC_PI_2,
            accelerometers_rad: white * (turn_s.powi(3) / 12.0).sqrt(),
        }
    }
}

/// Root mean squares of the end errors of some rounds, in x and y.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EndRms {
    pub x_m: f64,
    pub y_m: f64,
}

impl EndRms {
    pub fn of(ends: &[PoseError]) -> Self {
        let rms = |value: fn(&PoseError) -> f64| {
            root_mean_square(&ends.iter().map(value).collect::<Vec<_>>()).unwrap_or(f64::INFINITY)
        };
        Self { x_m: rms(|end| end.dx_m), y_m: rms(|end| end.dy_m) }
    }

    pub fn position_m(&self) -> f64 {
        self.x_m.hypot(self.y_m)
    }
}

/// A robot that has driven its rounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MappedRobot {
    pub drawn: DrawnRobot,
    pub turn: TurnErrors,
    pub wheels: EndRms,
    pub fused: EndRms,
}

impl MappedRobot {
    pub fn is_helped(&self) -> bool {
        self.fused.position_m() <= HELPED_SHARE * self.wheels.position_m()
    }

    pub fn is_within(&self, (x_m, y_m): (f64, f64)) -> bool {
        self.fused.x_m <= x_m && self.fused.y_m <= y_m
    }
}

/// The line between the robots that accelerometers help and the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HelpBoundary {
    /// c_0, c_w, c_a.
    coefficients: Vector3<f64>,
}

impl HelpBoundary {
    /// By logistic regression; `None` where all robots are of one kind or more accurate accelerometers do not help more.
    pub fn fit(robots: &[MappedRobot]) -> Option<Self> {
        let helped = robots.iter().filter(|robot| robot.is_helped()).count();
        if helped == 0 || helped == robots.len() {
            return None;
        }
        let mut coefficients = Vector3::zeros();
        for _ in 0..NEWTON_STEPS {
            let mut gradient = -RIDGE * coefficients;
            let mut hessian = Matrix3::from_diagonal_element(RIDGE);
            for robot in robots {
                let row = regressors(&robot.turn);
                let probability = logistic(row.dot(&coefficients));
                gradient += row * (f64::from(u8::from(robot.is_helped())) - probability);
                hessian += row * row.transpose() * (probability * (1.0 - probability));
            }
            let step = hessian.try_inverse()? * gradient;
            coefficients += step;
            if step.norm() < 1e-10 {
                break;
            }
        }
        (coefficients[2] < 0.0 && coefficients.iter().all(|value| value.is_finite())).then_some(Self { coefficients })
    }

    /// K of e_a = K e_w^p.
    pub fn factor(&self) -> f64 {
        (-self.coefficients[0] / self.coefficients[2]).exp()
    }

    /// p of e_a = K e_w^p.
    pub fn exponent(&self) -> f64 {
        -self.coefficients[1] / self.coefficients[2]
    }

    /// The largest error of the accelerometers that helps wheels with this one.
    pub fn accelerometer_limit_rad(&self, wheels_rad: f64) -> f64 {
        self.factor() * wheels_rad.powf(self.exponent())
    }

    pub fn predicts(&self, robot: &MappedRobot) -> bool {
        robot.turn.accelerometers_rad <= self.accelerometer_limit_rad(robot.turn.wheels_rad)
    }
}

fn regressors(turn: &TurnErrors) -> Vector3<f64> {
    Vector3::new(1.0, turn.wheels_rad.ln(), turn.accelerometers_rad.ln())
}

fn logistic(value: f64) -> f64 {
    1.0 / (1.0 + (-value).exp())
}

/// A share of cases with its 95 % interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CountedShare {
    pub hits: usize,
    pub cases: usize,
}

impl CountedShare {
    pub fn of<T>(cases: &[T], is_hit: impl Fn(&T) -> bool) -> Self {
        Self { hits: cases.iter().filter(|case| is_hit(case)).count(), cases: cases.len() }
    }

    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self { hits: self.hits + other.hits, cases: self.cases + other.cases }
    }

    /// `None` without a case.
    pub fn interval(&self) -> Option<(f64, f64)> {
        (self.cases > 0).then(|| wilson_interval_95(self.hits as u64, self.cases as u64).into())
    }
}

/// How often the boundary is right about robots from which it was not fitted: each half of the robots is judged by that of the other half.
pub fn cross_validate(robots: &[MappedRobot]) -> Option<CountedShare> {
    let (first, second) = robots.split_at(robots.len() / 2);
    let judge = |fitted: &[MappedRobot], judged: &[MappedRobot]| {
        let boundary = HelpBoundary::fit(fitted)?;
        Some(CountedShare::of(judged, |robot| boundary.predicts(robot) == robot.is_helped()))
    };
    Some(judge(first, second)?.and(judge(second, first)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Robots on a grid, helped where e_a <= 2 e_w.
    fn grid() -> Vec<MappedRobot> {
        let logs = |index: u32| 10_f64.powf(f64::from(index) / 7.0 - 3.0);
        let robots = (0..15).flat_map(|i| (0..15).map(move |j| (logs(i), logs(j))));
        robots
            .map(|(wheels_rad, accelerometers_rad)| {
                let end = |x_m| EndRms { x_m, y_m: 0.0 };
                let fused = if accelerometers_rad <= 2.0 * wheels_rad { end(0.5) } else { end(1.0) };
                let turn = TurnErrors { wheels_rad, accelerometers_rad };
                let drawn = DrawnRobot { track_scale_sigma: 0.1, accelerometer_m_per_s2: 0.1 };
                MappedRobot { drawn, turn, wheels: end(1.0), fused }
            })
            .collect()
    }

    #[test]
    fn the_boundary_is_found_between_the_robots_that_it_separates() {
        let boundary = HelpBoundary::fit(&grid()).unwrap();
        assert!((boundary.exponent() - 1.0).abs() < 0.05, "{boundary:?}");
        assert!((boundary.accelerometer_limit_rad(0.03) / 0.06 - 1.0).abs() < 0.2, "{boundary:?}");
        assert!(grid().iter().all(|robot| boundary.predicts(robot) == robot.is_helped()));
        let one_kind: Vec<MappedRobot> = grid().into_iter().filter(MappedRobot::is_helped).collect();
        assert_eq!(HelpBoundary::fit(&one_kind), None);
    }

    #[test]
    fn a_turn_by_accelerometers_errs_by_equation_4() {
        let robot = DrawnRobot { track_scale_sigma: 0.02, accelerometer_m_per_s2: 0.012 };
        let turn = robot.turn_errors(0.112, 1.87, 0.05);
        assert!((turn.accelerometers_rad - 0.025).abs() < 5e-4, "{turn:?}");
        assert!((turn.wheels_rad - 0.0314).abs() < 1e-4);
    }
}

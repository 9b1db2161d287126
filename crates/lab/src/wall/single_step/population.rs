//! Steps of drawn cars, whose true drive has to lie within the reported intervals.

use posebridge_estimator::numerics::statistics::wilson_interval_95;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::*;
use crate::wall::log::test_logs::log_of;

/// How a drawn log ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LogEnd {
    OnTheWay,
    /// The motors go off, and the car stops at once.
    Brake,
    /// The motors go off, and the car rolls out with twice the time constant.
    Coast,
    /// The car stops at once, and the motors stay on.
    Contact,
}

/// A car, its sensor and its log.
#[derive(Clone, Copy, Debug)]
struct DrawnStep {
    steady_m_per_s: f64,
    tau_s: f64,
    sigma_m: f64,
    period_s: f64,
    rest_s: f64,
    driven_s: f64,
    after_s: f64,
    end: LogEnd,
    command: StepCommand,
}

impl DrawnStep {
    fn draw(random: &mut Pcg64, command: StepCommand, end: LogEnd) -> Self {
        let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        Self {
            steady_m_per_s: between(0.2, 1.3),
            tau_s: between(0.1, 0.5),
            sigma_m: between(0.001, 0.01),
            period_s: between(0.03, 0.1),
            rest_s: between(0.3, 1.2),
            driven_s: between(1.5, 3.0),
            after_s: between(0.3, 1.5),
            end,
            command,
        }
    }

    fn travelled_m(&self, at_s: f64) -> f64 {
        let driven_s = if self.end == LogEnd::OnTheWay { f64::INFINITY } else { self.driven_s };
        let since_s = at_s - self.rest_s;
        let lag = |since_s: f64, tau_s: f64| -(-since_s / tau_s).exp_m1();
        let under_drive_s = since_s.clamp(0.0, driven_s);
        let driven_m = self.steady_m_per_s * (under_drive_s - self.tau_s * lag(under_drive_s, self.tau_s));
        if self.end != LogEnd::Coast {
            return driven_m;
        }
        let rolls_s = 2.0 * self.tau_s;
        let rolled_m = lag(driven_s, self.tau_s) * rolls_s * lag((since_s - driven_s).max(0.0), rolls_s);
        driven_m + self.steady_m_per_s * rolled_m
    }

    /// Readings in whole millimetres at times that jitter, each with the motors' input at that instant.
    fn log(&self, random: &mut Pcg64) -> WallLog {
        let off_s = self.rest_s + self.driven_s;
        let last_s = if self.end == LogEnd::OnTheWay { off_s } else { off_s + self.after_s };
        let (mut at_s, mut ranges, mut inputs) = (0.0, Vec::new(), Vec::new());
        while at_s < last_s {
            let noise: f64 = random.sample(StandardNormal);
            let range_mm = (1e3 * (4.5 - self.travelled_m(at_s) + self.sigma_m * noise)).round();
            ranges.push((at_s, 1e-3 * range_mm));
            let is_off = at_s < self.rest_s || at_s > off_s && self.end != LogEnd::Contact;
            inputs.push((at_s, if is_off { 0.0 } else { 1.0 }));
            at_s += self.period_s * (0.8 + 0.4 * random.random::<f64>());
        }
        match self.command {
            StepCommand::Recorded => log_of(inputs, ranges),
            StepCommand::Unknown => log_of([], ranges).with_assumed_drive(),
        }
    }
}

/// How many drawn steps have a value, and in how many the truth lies within its 95 % interval.
#[derive(Clone, Copy, Debug, Default)]
struct Coverage {
    known: u64,
    within: u64,
}

impl Coverage {
    fn add(&mut self, found: Option<UncertainValue>, truth: f64) {
        if let Some(found) = found {
            self.known += 1;
            self.within += u64::from((found.value - truth).abs() < 1.96 * found.sigma);
        }
    }

    const fn merge(&mut self, other: Self) {
        self.known += other.known;
        self.within += other.within;
    }
}

/// Whether what a step is said not to tell is true of the drawn car.
fn is_true(reason: UndeterminedReason, step: &DrawnStep, random: &Pcg64) -> bool {
    match reason {
        // A longer way tells the steady speed.
        UndeterminedReason::NoSteadySpeed { .. } => {
            let longer = DrawnStep { driven_s: 2.0 * step.driven_s, ..*step };
            find_step(&longer.log(&mut random.clone()), step.command).is_ok_and(|found| found.drag_s_per_m.is_some())
        }
        UndeterminedReason::RisesBetweenReadings { .. } => step.period_s > 0.6 * step.tau_s,
        UndeterminedReason::BeginsOnTheWay { .. } => false,
        // With a tenth of the noise the same drive tells everything.
        UndeterminedReason::TooNoisy { .. } => {
            let quiet = DrawnStep { sigma_m: 0.1 * step.sigma_m, ..*step };
            find_step(&quiet.log(&mut random.clone()), step.command).is_ok_and(|found| found.undetermined.is_none())
        }
    }
}

/// Steps of each kind.
const DRAWS: u64 = 40;

#[test]
fn true_drives_lie_within_the_intervals_of_drawn_steps_and_refusals_are_true() {
    const NAMES: [&str; 3] = ["v_ss", "t90", "m"];
    let mut random = Pcg64::seed_from_u64(1);
    let mut all = [Coverage::default(); 3];
    let ends = [LogEnd::OnTheWay, LogEnd::Brake, LogEnd::Coast, LogEnd::Contact];
    for (command, end) in [StepCommand::Recorded, StepCommand::Unknown].into_iter().flat_map(|c| ends.map(|e| (c, e))) {
        let mut kind = [Coverage::default(); 3];
        for _ in 0..DRAWS {
            let step = DrawnStep::draw(&mut random, command, end);
            let before = random.clone();
            let reason = match find_step(&step.log(&mut random), command) {
                Ok(found) => {
                    kind[0].add(found.steady_m_per_s, step.steady_m_per_s);
                    kind[1].add(found.rise_90_s, step.tau_s * std::f64::consts::LN_10);
                    kind[2].add(found.mass_s2_per_m, step.tau_s / step.steady_m_per_s);
                    found.undetermined
                }
                Err(WallStepError::Undetermined(reason)) => Some(reason),
                Err(error) => panic!("{step:?}: {error}"),
            };
            assert!(reason.is_none_or(|reason| is_true(reason, &step, &before)), "{step:?}: {reason:?}");
        }
        for ((name, of_kind), sum) in NAMES.iter().zip(kind).zip(&mut all) {
            println!("{command:?}, {end:?}, {name}: {} of {}", of_kind.within, of_kind.known);
            sum.merge(of_kind);
            // No kind hides behind the others.
            let [low, high] = wilson_interval_95(of_kind.within, of_kind.known);
            assert!(high > 0.90 && low < 0.99, "{command:?} {end:?} {name}: {of_kind:?}");
        }
    }
    for (name, of_all) in NAMES.iter().zip(all) {
        let share = of_all.within as f64 / of_all.known as f64;
        println!("{name}: {:.1} % of {} of {} steps", 1e2 * share, of_all.known, 8 * DRAWS);
        assert!((0.90..0.99).contains(&share) && of_all.known > 8 * DRAWS * 4 / 5, "{name}: {of_all:?}");
    }
}

//! Least-squares evaluation of step tests: one drive model fitted to all readings of all steps, with uncertainties.
//!
//! ```text
//! min over v_ss, a, z_0j of   sum over steps j and readings i of   (z_ij - z_0j + v_ss phi_a(t_ij))^2
//! ```
//! For a given a the rest is linear; a itself is found by grid search and golden section. The sigmas are those of least squares with
//! the noise of the residuals.

use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::numerics::statistics::mean;
use posebridge_telemetry::UncertainValue;

use super::log::{ResponseSample, WallLog, responses};
use super::step_error::WallStepError;
use crate::statistics::{FittedLine, golden_section};

/// Search range of the rate: time constants from 20 ms to 20 s.
const MIN_RATE_PER_S: f64 = 0.05;
const MAX_RATE_PER_S: f64 = 50.0;
/// Points of the grid, equal in ratio; golden section then halves the bracket about 60 times.
const GRID: u32 = 80;
const GOLDEN_STEPS: u32 = 60;

/// The fitted values, each with one standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFit {
    /// Steady speed under the input 1.
    pub steady_m_per_s: UncertainValue,
    /// Time to 90 % of it.
    pub rise_90_s: UncertainValue,
    /// d.
    pub drag_s_per_m: UncertainValue,
    /// m.
    pub mass_s2_per_m: UncertainValue,
    /// Noise of a reading, from the residuals.
    pub range_sigma_m: f64,
    pub readings: usize,
}

impl StepFit {
    pub const fn model(&self) -> WallApproachModel {
        WallApproachModel { drag_s_per_m: self.drag_s_per_m.value, mass_s2_per_m: self.mass_s2_per_m.value }
    }

    /// Share of the steady speed at a time after the start: a fit to steps that end early extrapolates.
    pub fn share_reached(&self, after_s: f64) -> f64 {
        -(-after_s.max(0.0) * std::f64::consts::LN_10 / self.rise_90_s.value).exp_m1()
    }

    /// Time, reading and fitted distance, in s, m and m; the distance at rest is the one that fits the log best.
    pub fn fitted_curve(&self, log: &WallLog) -> Vec<(f64, f64, f64)> {
        let (steady, rate_per_s) = (self.steady_m_per_s.value, std::f64::consts::LN_10 / self.rise_90_s.value);
        let readings = responses(log, rate_per_s);
        let Some((mean_distance_m, range_m)) = means(&readings) else {
            return Vec::new();
        };
        let fitted = readings.iter().map(|reading| {
            let fitted_m = range_m - steady * (reading.distance_m - mean_distance_m);
            (reading.at_s, reading.range_m, fitted_m)
        });
        fitted.collect()
    }
}

/// Fits one drive to all steps. Each begins at rest, at its own distance.
pub fn fit_steps(logs: &[WallLog]) -> Result<StepFit, WallStepError> {
    if logs.iter().any(|log| log.drives_from_s().is_none()) {
        return Err(WallStepError::NoInput);
    }
    let readings: usize = logs.iter().map(|log| log.readings().count()).sum();
    let needed = (3 * logs.len()).max(5);
    if readings < needed {
        return Err(WallStepError::TooFewReadings { found: readings, needed });
    }
    let rate_per_s = best_rate(logs);
    let best = LinearFit::from_logs(logs, rate_per_s).ok_or(WallStepError::NoMotion)?;
    let is_inside = (1.01 * MIN_RATE_PER_S..0.99 * MAX_RATE_PER_S).contains(&rate_per_s);
    if best.steady_m_per_s <= 0.0 || !is_inside {
        return Err(WallStepError::NoMotion);
    }
    let freedom = readings - logs.len() - 2;
    let variance_m2 = best.cost_m2 / freedom.max(1) as f64;
    let covariance = covariance(logs, rate_per_s, best.steady_m_per_s, variance_m2);
    let covariance = covariance.ok_or(WallStepError::NoMotion)?;
    Ok(step_fit(best.steady_m_per_s, rate_per_s, covariance, variance_m2.sqrt(), readings))
}

/// Converts v_ss and a, with their covariance [vv, va, aa], to the result.
fn step_fit(v: f64, a: f64, covariance: [f64; 3], range_sigma_m: f64, readings: usize) -> StepFit {
    let [vv, va, aa] = covariance;
    let mass = 1.0 / (v * a);
    // d = 1/v, m = 1/(v a): relative errors add up.
    let relative = vv / (v * v) + aa / (a * a) + 2.0 * va / (v * a);
    let rise = std::f64::consts::LN_10 / a;
    StepFit {
        steady_m_per_s: UncertainValue { value: v, sigma: vv.sqrt() },
        rise_90_s: UncertainValue { value: rise, sigma: rise * aa.sqrt() / a },
        drag_s_per_m: UncertainValue { value: 1.0 / v, sigma: vv.sqrt() / (v * v) },
        mass_s2_per_m: UncertainValue { value: mass, sigma: mass * relative.max(0.0).sqrt() },
        range_sigma_m,
        readings,
    }
}

fn best_rate(logs: &[WallLog]) -> f64 {
    let cost = |rate: f64| LinearFit::from_logs(logs, rate).map_or(f64::INFINITY, |fit| fit.cost_m2);
    let ratio = MAX_RATE_PER_S / MIN_RATE_PER_S;
    let grid = |index: u32| MIN_RATE_PER_S * ratio.powf(f64::from(index) / f64::from(GRID));
    let best = (0..=GRID).min_by(|a, b| cost(grid(*a)).total_cmp(&cost(grid(*b))));
    let best = best.unwrap_or(0);
    let (low, high) = (grid(best.saturating_sub(1)), grid((best + 1).min(GRID)));
    golden_section(low, high, GOLDEN_STEPS, |rate| -cost(rate))
}

struct LinearFit {
    steady_m_per_s: f64,
    cost_m2: f64,
}

impl LinearFit {
    fn from_logs(logs: &[WallLog], rate_per_s: f64) -> Option<Self> {
        let (mut across, mut along, mut heights) = (0.0, 0.0, 0.0);
        for log in logs {
            let readings = responses(log, rate_per_s);
            let (mean_distance_m, range_m) = means(&readings)?;
            for reading in &readings {
                across += (reading.distance_m - mean_distance_m) * (reading.range_m - range_m);
                along += (reading.distance_m - mean_distance_m).powi(2);
                heights += (reading.range_m - range_m).powi(2);
            }
        }
        (along > 0.0)
            .then_some(Self { steady_m_per_s: -across / along, cost_m2: (heights - across * across / along).max(0.0) })
    }
}

fn means(readings: &[ResponseSample]) -> Option<(f64, f64)> {
    let distance_m = mean(readings.iter().map(|reading| reading.distance_m))?;
    Some((distance_m, mean(readings.iter().map(|reading| reading.range_m))?))
}

/// Covariance [vv, va, aa] by least squares about the minimum.
fn covariance(logs: &[WallLog], a: f64, v: f64, variance_m2: f64) -> Option<[f64; 3]> {
    // Central differences; a relative step of a thousandth leaves an error of its square.
    let h = 1e-3 * a;
    let (mut n_vv, mut n_va, mut n_aa) = (0.0, 0.0, 0.0);
    for log in logs {
        let [here, ahead, behind] = [a, a + h, a - h].map(|rate| responses(log, rate));
        let by_a = ahead.iter().zip(&behind);
        let by_a: Vec<f64> =
            by_a.map(|(ahead, behind)| v * (ahead.distance_m - behind.distance_m) / (2.0 * h)).collect();
        let mean_a = mean(by_a.iter().copied())?;
        let (mean_v, _) = means(&here)?;
        for (reading, by_a) in here.iter().zip(by_a) {
            let (by_v, by_a) = (reading.distance_m - mean_v, by_a - mean_a);
            n_vv += by_v * by_v;
            n_va += by_v * by_a;
            n_aa += by_a * by_a;
        }
    }
    let determinant = n_vv * n_aa - n_va * n_va;
    (determinant > 0.0).then(|| [n_aa, -n_va, n_vv].map(|entry| variance_m2 * entry / determinant))
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedSample {
    pub at_s: f64,
    /// Positive towards the wall.
    pub towards_m_per_s: f64,
}

/// Readings per line in the evaluation by hand, at least.
pub const PIECE: usize = 5;

#[derive(Clone, Debug, PartialEq)]
pub struct ManualStepFit {
    /// Steady speed, from the steepest line.
    pub steady_m_per_s: f64,
    /// The same by the difference of the first and the last reading of that piece.
    pub steady_by_difference_m_per_s: f64,
    pub start_s: f64,
    /// Time to 90 % of the steady speed, interpolated between two lines.
    pub rise_90_s: f64,
    /// d and m from the two.
    pub model: WallApproachModel,
}

pub fn differences(log: &WallLog) -> Vec<SpeedSample> {
    let readings: Vec<(f64, f64)> = log.readings().collect();
    let pairs = readings.windows(2).filter(|pair| pair[1].0 > pair[0].0);
    pairs
        .map(|pair| SpeedSample {
            at_s: f64::midpoint(pair[0].0, pair[1].0),
            towards_m_per_s: (pair[0].1 - pair[1].1) / (pair[1].0 - pair[0].0),
        })
        .collect()
}

/// Slopes of regression lines through pieces of `length` readings, each overlapping half of the previous one.
pub fn overlapping_lines(log: &WallLog, length: usize) -> Vec<SpeedSample> {
    let readings: Vec<(f64, f64)> = log.readings().collect();
    segments(&readings, length).filter_map(slope).collect()
}

/// Pieces of `length` readings that overlap by half; the last ends with the last reading.
fn segments(readings: &[(f64, f64)], length: usize) -> impl Iterator<Item = &[(f64, f64)]> {
    let length = length.max(2);
    let last = readings.len().checked_sub(length);
    let starts = last.into_iter().flat_map(move |last| {
        let step = length.div_ceil(2);
        (0..last).step_by(step).chain([last])
    });
    starts.filter_map(move |start| readings.get(start..start + length))
}

fn slope(samples: &[(f64, f64)]) -> Option<SpeedSample> {
    let line = FittedLine::through(samples)?;
    Some(SpeedSample { at_s: line.centre.0, towards_m_per_s: -line.slope })
}

/// Evaluates a step as by hand: lines through pieces of `length` readings.
///
/// A line's slope is the mean speed of its piece, lower than at its end while the car accelerates, and the steepest of several noisy
/// lines is too steep: such results are accurate to some per cent. [`fit_steps`](super::fit_steps) is more accurate and returns its
/// uncertainty.
pub fn fit_by_hand(log: &WallLog, length: usize) -> Result<ManualStepFit, WallStepError> {
    let start_s = log.drives_from_s().ok_or(WallStepError::NoInput)?;
    let readings: Vec<(f64, f64)> = log.readings().filter(|(at_s, _)| *at_s >= start_s).collect();
    let needed = length.max(2) + 1;
    if readings.len() < needed {
        return Err(WallStepError::TooFewReadings { found: readings.len(), needed });
    }
    let lines = segments(&readings, length).filter_map(|samples| Some((slope(samples)?, samples)));
    let lines: Vec<(SpeedSample, &[(f64, f64)])> = lines.collect();
    let steepest = lines.iter().max_by(|a, b| a.0.towards_m_per_s.total_cmp(&b.0.towards_m_per_s));
    let (steady, of) = steepest.ok_or(WallStepError::NoMotion)?;
    let steady_m_per_s = steady.towards_m_per_s;
    let [first, .., last] = of else {
        return Err(WallStepError::NoMotion);
    };
    let rise_end_s = crossing(&lines, start_s, 0.9 * steady_m_per_s);
    let rise_90_s = rise_end_s.map_or(0.0, |at_s| at_s - start_s);
    if steady_m_per_s <= 0.0 || rise_90_s <= 0.0 {
        return Err(WallStepError::NoMotion);
    }
    Ok(ManualStepFit {
        steady_m_per_s,
        steady_by_difference_m_per_s: (first.1 - last.1) / (last.0 - first.0),
        start_s,
        rise_90_s,
        model: WallApproachModel::from_step_test(steady_m_per_s, rise_90_s),
    })
}

pub fn mean_manual_fit(steps: &[ManualStepFit]) -> Option<ManualStepFit> {
    let mean = |of: fn(&ManualStepFit) -> f64| mean(steps.iter().map(of));
    let (steady_m_per_s, rise_90_s) = (mean(|step| step.steady_m_per_s)?, mean(|step| step.rise_90_s)?);
    Some(ManualStepFit {
        steady_m_per_s,
        steady_by_difference_m_per_s: mean(|step| step.steady_by_difference_m_per_s)?,
        start_s: mean(|step| step.start_s)?,
        rise_90_s,
        model: WallApproachModel::from_step_test(steady_m_per_s, rise_90_s),
    })
}

/// When the speed first reaches `level`, from rest at the start.
fn crossing(lines: &[(SpeedSample, &[(f64, f64)])], start_s: f64, level: f64) -> Option<f64> {
    let mut before = (start_s, 0.0);
    for (line, _) in lines {
        let speed = line.towards_m_per_s;
        if speed >= level {
            let share = (level - before.1) / (speed - before.1);
            return Some(before.0 + share * (line.at_s - before.0));
        }
        before = (line.at_s.max(start_s), speed);
    }
    None
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::wall::log::test_logs::{driven_m, log_of};

    /// A step of the text's car with readings of this noise.
    fn simulated(seed: u64, sigma_m: f64) -> WallLog {
        let mut normals = Pcg64::seed_from_u64(seed);
        let ranges = (0..21).map(|index| {
            let at_s = 0.083 * f64::from(index);
            let noise: f64 = normals.sample(StandardNormal);
            (at_s, 2.0 - driven_m((at_s - 0.241_f64).max(0.0)) + sigma_m * noise)
        });
        log_of([(0.0, 0.0), (0.241, 1.0)], ranges)
    }

    #[test]
    fn readings_without_noise_give_the_drive_itself() {
        let fit = fit_steps(&[simulated(1, 0.0)]).unwrap();
        assert!((fit.steady_m_per_s.value - 1.225).abs() < 1e-6, "{fit:?}");
        assert!((fit.rise_90_s.value - 0.997).abs() < 1e-6);
        assert!((fit.drag_s_per_m.value - 0.816_33).abs() < 1e-5);
        assert!((fit.mass_s2_per_m.value - 0.353_46).abs() < 1e-5);
        assert!(fit.range_sigma_m < 1e-6);
        for (_, range_m, fitted_m) in fit.fitted_curve(&simulated(1, 0.0)) {
            assert!((range_m - fitted_m).abs() < 1e-6);
        }
        assert!((fit.share_reached(0.997) - 0.9).abs() < 1e-5);
        assert_eq!(fit.share_reached(-1.0), 0.0);
        assert_eq!(fit.fitted_curve(&WallLog::default()), []);
    }

    #[test]
    fn the_sigmas_are_those_of_many_draws() {
        let runs = 300;
        let [mut d, mut m, mut sigma_m] = [0.0; 3];
        for seed in 0..runs {
            let fit = fit_steps(&[simulated(seed, 0.01), simulated(seed + 1_000, 0.01)]).unwrap();
            d += ((fit.drag_s_per_m.value - 0.816_327) / fit.drag_s_per_m.sigma).powi(2);
            m += ((fit.mass_s2_per_m.value - 0.353_464) / fit.mass_s2_per_m.sigma).powi(2);
            sigma_m += fit.range_sigma_m;
        }
        let per_run = |sum: f64| sum / runs as f64;
        println!("normalised d {:.2}, m {:.2}", per_run(d), per_run(m));
        // Means of squares of standard normals: 1, known to 0.08.
        assert!((0.75..1.3).contains(&per_run(d)));
        assert!((0.75..1.3).contains(&per_run(m)));
        assert!((per_run(sigma_m) / 0.01 - 1.0).abs() < 0.03);
    }

    #[test]
    fn a_log_that_is_no_step_is_refused() {
        assert_eq!(fit_steps(&[WallLog::default()]), Err(WallStepError::NoInput));
        let forwards = simulated(1, 0.0);
        let backwards = log_of(forwards.inputs(), forwards.readings().map(|(at_s, range_m)| (at_s, 4.0 - range_m)));
        assert_eq!(fit_steps(&[backwards]), Err(WallStepError::NoMotion));
    }

    /// Noise-free readings of the text's car, 18 on the way.
    fn noise_free(period_s: f64, count: u32) -> WallLog {
        let since_s = (0..count).map(|index| f64::from(index) * period_s);
        log_of([(0.241, 1.0)], since_s.map(|since_s| (0.241 + since_s, 4.0 - driven_m(since_s))))
    }

    #[test]
    fn lines_and_differences_come_to_the_texts_car_when_readings_are_dense() {
        let log = noise_free(0.01, 280);
        let found = fit_by_hand(&log, 6).unwrap();
        assert!((found.steady_m_per_s / 1.225 - 1.0).abs() < 0.003, "{found:?}");
        assert!((found.steady_by_difference_m_per_s / found.steady_m_per_s - 1.0).abs() < 0.003);
        assert!((found.rise_90_s / 0.997 - 1.0).abs() < 0.02, "{found:?}");
        assert!((found.start_s - 0.241).abs() < 1e-12);
        let last = *differences(&log).last().unwrap();
        assert!((last.towards_m_per_s - 1.223).abs() < 0.003, "{last:?}");
    }

    #[test]
    fn the_mean_of_steps_has_the_model_of_the_mean_figures() {
        let one = fit_by_hand(&noise_free(0.01, 280), 6).unwrap();
        let mut other = one.clone();
        other.steady_m_per_s += 0.2;
        other.rise_90_s -= 0.1;
        let mean = mean_manual_fit(&[one.clone(), other]).unwrap();
        let expected = WallApproachModel::from_step_test(one.steady_m_per_s + 0.1, one.rise_90_s - 0.05);
        assert!((mean.model.mass_s2_per_m - expected.mass_s2_per_m).abs() < 1e-12);
        assert_eq!(mean_manual_fit(&[]), None);
    }

    #[test]
    fn pieces_overlap_by_half_and_reach_the_end() {
        let log = noise_free(0.1, 10);
        let lines = overlapping_lines(&log, 4);
        let middles: Vec<f64> = lines.iter().map(|line| line.at_s - 0.241).collect();
        for (found, expected) in middles.iter().zip([0.15, 0.35, 0.55, 0.75]) {
            assert!((found - expected).abs() < 1e-12, "{middles:?}");
        }
        assert_eq!(middles.len(), 4);
        assert!(overlapping_lines(&log, 11).is_empty());
    }

    #[test]
    fn what_is_no_step_is_refused_with_the_reason() {
        let full = noise_free(0.1, 4);
        let few = WallStepError::TooFewReadings { found: 4, needed: 5 };
        assert_eq!(fit_by_hand(&full, 4), Err(few));
        assert_eq!(fit_by_hand(&log_of([], full.readings()), 3), Err(WallStepError::NoInput));
        let resting = log_of([(0.0, 1.0)], (0..9).map(|index| (f64::from(index), 1.0)));
        assert_eq!(fit_by_hand(&resting, 3), Err(WallStepError::NoMotion));
    }
}

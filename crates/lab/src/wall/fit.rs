//! A step test as it is done by a computer: one drive through all readings of all steps, with how sure it is.
//!
//! ```text
//! min over v_ss, a, z_0j of   sum over steps j and readings i of   (z_ij - z_0j + v_ss phi_a(t_ij))^2
//! ```
//! For a given a the rest is linear; a itself is searched on a grid and then by golden section. The sigmas are those of least
//! squares with the noise that the residuals show.

use posebridge_estimator::models::wall_approach::WallApproachModel;

use super::log::WallLog;
use super::response::{ResponseSample, responses};
use super::step_by_hand::WallStepError;

/// Rates that are searched, 1/s: time constants from 20 ms to 20 s.
const MIN_RATE_PER_S: f64 = 0.05;
const MAX_RATE_PER_S: f64 = 50.0;
/// Points of the grid between them, equal in ratio; golden section then halves the bracket about 60 times.
const GRID: u32 = 80;
const GOLDEN_STEPS: u32 = 60;

/// What is found, each with one standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFit {
    /// Steady speed under the input 1, m/s.
    pub steady_m_per_s: (f64, f64),
    /// Time to 90 % of it, s.
    pub rise_90_s: (f64, f64),
    /// d, s/m.
    pub drag_s_per_m: (f64, f64),
    /// m, s²/m.
    pub mass_s2_per_m: (f64, f64),
    /// The noise of a reading, as the residuals show it, m.
    pub range_sigma_m: f64,
    /// Readings that were used.
    pub readings: usize,
}

impl StepFit {
    /// The drive as the filter's model has it.
    pub const fn model(&self) -> WallApproachModel {
        WallApproachModel { drag_s_per_m: self.drag_s_per_m.0, mass_s2_per_m: self.mass_s2_per_m.0 }
    }
}

impl StepFit {
    /// The share of the steady speed that the car has at a time in seconds after the drive began: a fit to steps that end early
    /// extrapolates.
    pub fn share_reached(&self, after_s: f64) -> f64 {
        -(-after_s.max(0.0) * std::f64::consts::LN_10 / self.rise_90_s.0).exp_m1()
    }

    /// Time, reading and what this drive makes of it, in s, m and m; the distance at rest is the one that fits the log best.
    pub fn fitted_curve(&self, log: &WallLog) -> Vec<(f64, f64, f64)> {
        let (steady, rate_per_s) = (self.steady_m_per_s.0, std::f64::consts::LN_10 / self.rise_90_s.0);
        let readings = responses(log, rate_per_s);
        let Some((way_m, range_m)) = means(&readings) else {
            return Vec::new();
        };
        let fitted = readings.iter().map(|reading| {
            let fitted_m = range_m - steady * (reading.distance_m - way_m);
            (reading.at_s, reading.range_m, fitted_m)
        });
        fitted.collect()
    }
}

/// Finds the drive that explains all steps best. Each begins at rest, at a distance of its own.
///
/// # Errors
/// [`WallStepError`] as it says; a step takes three readings at least, all together five.
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

/// From v_ss and a with their covariance [vv, va, aa] to what people call them.
fn step_fit(v: f64, a: f64, covariance: [f64; 3], range_sigma_m: f64, readings: usize) -> StepFit {
    let [vv, va, aa] = covariance;
    let mass = 1.0 / (v * a);
    // d = 1/v, m = 1/(v a): relative errors add up.
    let relative = vv / (v * v) + aa / (a * a) + 2.0 * va / (v * a);
    let rise = std::f64::consts::LN_10 / a;
    StepFit {
        steady_m_per_s: (v, vv.sqrt()),
        rise_90_s: (rise, rise * aa.sqrt() / a),
        drag_s_per_m: (1.0 / v, vv.sqrt() / (v * v)),
        mass_s2_per_m: (mass, mass * relative.max(0.0).sqrt()),
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
    let (mut low, mut high) = (grid(best.saturating_sub(1)), grid((best + 1).min(GRID)));
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    for _ in 0..GOLDEN_STEPS {
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        if cost(left) < cost(right) {
            high = right;
        } else {
            low = left;
        }
    }
    f64::midpoint(low, high)
}

/// What is best for a given rate.
struct LinearFit {
    steady_m_per_s: f64,
    cost_m2: f64,
}

impl LinearFit {
    fn from_logs(logs: &[WallLog], rate_per_s: f64) -> Option<Self> {
        let (mut across, mut along, mut heights) = (0.0, 0.0, 0.0);
        for log in logs {
            let readings = responses(log, rate_per_s);
            let (way_m, range_m) = means(&readings)?;
            for reading in &readings {
                across += (reading.distance_m - way_m) * (reading.range_m - range_m);
                along += (reading.distance_m - way_m).powi(2);
                heights += (reading.range_m - range_m).powi(2);
            }
        }
        (along > 0.0)
            .then_some(Self { steady_m_per_s: -across / along, cost_m2: (heights - across * across / along).max(0.0) })
    }
}

fn means(readings: &[ResponseSample]) -> Option<(f64, f64)> {
    let count = readings.len() as f64;
    let way_m = readings.iter().map(|reading| reading.distance_m).sum::<f64>() / count;
    let range_m = readings.iter().map(|reading| reading.range_m).sum::<f64>() / count;
    (count > 0.0).then_some((way_m, range_m))
}

/// Covariance [vv, va, aa] by least squares about the best.
fn covariance(logs: &[WallLog], a: f64, v: f64, variance_m2: f64) -> Option<[f64; 3]> {
    // Central differences; a relative step of a thousandth leaves an error of its square.
    let h = 1e-3 * a;
    let (mut n_vv, mut n_va, mut n_aa) = (0.0, 0.0, 0.0);
    for log in logs {
        let [here, ahead, behind] = [a, a + h, a - h].map(|rate| responses(log, rate));
        let by_a = ahead.iter().zip(&behind);
        let by_a: Vec<f64> =
            by_a.map(|(ahead, behind)| v * (ahead.distance_m - behind.distance_m) / (2.0 * h)).collect();
        let mean_a = by_a.iter().sum::<f64>() / by_a.len() as f64;
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

#[cfg(test)]
mod tests {
    use super::super::log::{WallEntry, WallReading};
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    /// A step of the text's car with readings of this noise.
    fn simulated(seed: u64, sigma_m: f64) -> WallLog {
        let mut normals = Pcg64::seed_from_u64(seed);
        let tau_s = 0.997 / std::f64::consts::LN_10;
        let readings = (0..21).map(|index| {
            let at_s = 0.083 * f64::from(index);
            let t = (at_s - 0.241_f64).max(0.0);
            let way = 1.225 * (t - tau_s * (1.0 - (-t / tau_s).exp()));
            let noise: f64 = normals.sample(StandardNormal);
            WallEntry { at_s, reading: WallReading::Range(2.0 - way + sigma_m * noise) }
        });
        let inputs =
            [(0.0, 0.0), (0.241, 1.0)].map(|(at_s, input)| WallEntry { at_s, reading: WallReading::Input(input) });
        WallLog::new(inputs.into_iter().chain(readings).collect())
    }

    #[test]
    fn readings_without_noise_give_the_drive_itself() {
        let fit = fit_steps(&[simulated(1, 0.0)]).unwrap();
        assert!((fit.steady_m_per_s.0 - 1.225).abs() < 1e-6, "{fit:?}");
        assert!((fit.rise_90_s.0 - 0.997).abs() < 1e-6);
        assert!((fit.drag_s_per_m.0 - 0.816_33).abs() < 1e-5);
        assert!((fit.mass_s2_per_m.0 - 0.353_46).abs() < 1e-5);
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
            d += ((fit.drag_s_per_m.0 - 0.816_327) / fit.drag_s_per_m.1).powi(2);
            m += ((fit.mass_s2_per_m.0 - 0.353_464) / fit.mass_s2_per_m.1).powi(2);
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
        let backwards = simulated(1, 0.0).entries().to_vec();
        let backwards = backwards.into_iter().map(|entry| match entry.reading {
            WallReading::Range(range_m) => WallEntry { reading: WallReading::Range(4.0 - range_m), ..entry },
            WallReading::Input(_) => entry,
        });
        let backwards = WallLog::new(backwards.collect());
        assert_eq!(fit_steps(&[backwards]), Err(WallStepError::NoMotion));
    }
}

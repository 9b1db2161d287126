//! Compares each reading with its prediction from earlier readings.

use posebridge_estimator::Params;
use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::numerics::statistics::mean;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_telemetry::{FusionOutcome, FusionRecord};

use super::log::{WallLog, WallReading, responses};
use super::replay_filter::{
    ApproachEstimator, GATE_SIGMAS, KalmanNoise, LinearExtrapolation, WallKalman, innovation_sigma,
};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeForecast {
    pub at_s: f64,
    pub range_m: f64,
    /// By the filter, with drive and noise identified from the earlier readings.
    pub kalman_m: f64,
    /// By the line through the last two; `None` before there are two.
    pub line_m: Option<f64>,
    pub plant: Plant,
    /// Half-width of the gate, max(GATE_MIN, 3 sqrt(S)): a reading further from its prediction is rejected. `None` without a
    /// prediction.
    pub gate_m: Option<f64>,
    pub is_gated: bool,
}

/// Growth of the number of readings after which the drive is identified again; early, at each reading. Bounds the run time for long
/// logs.
const REFIT_GROWTH: f64 = 1.02;

/// Predicts every reading but the first from the earlier ones.
pub fn forecast(log: &WallLog, range_sigma_m: f64) -> Vec<RangeForecast> {
    let least_gate_m = Params::default().wall_gate_m;
    let mut foreseen = Vec::new();
    let mut line = LinearExtrapolation::default();
    let mut known: Option<(Plant, PlantFilter)> = None;
    let (mut readings, mut identified_at) = (0_usize, 0_usize);
    for (index, entry) in log.entries().iter().enumerate() {
        let WallReading::Range(range_m) = entry.reading else {
            if let Some((_, runner)) = &mut known {
                runner.observe(entry.at_s, entry.reading);
            }
            continue;
        };
        let is_due = readings as f64 >= REFIT_GROWTH * identified_at as f64;
        if readings > 0 && (known.is_none() || (is_due && readings > identified_at)) {
            let past = log.entries().iter().take(index).copied().collect();
            known = Some(best_plant(&WallLog::new(past), range_sigma_m));
            identified_at = readings;
        }
        if let Some((plant, runner)) = &mut known {
            let foretold = runner.distance_m(entry.at_s);
            let record = runner.fuse(entry.at_s, range_m);
            foreseen.extend(foretold.map(|kalman_m| RangeForecast {
                at_s: entry.at_s,
                range_m,
                kalman_m,
                line_m: line.estimate(entry.at_s).map(|estimate| estimate.distance_m).filter(|_| readings >= 2),
                plant: *plant,
                gate_m: innovation_sigma(&record).map(|s_m2| least_gate_m.max(GATE_SIGMAS * s_m2.sqrt())),
                is_gated: record.outcome == FusionOutcome::Gated,
            }));
        }
        line.observe_range(entry.at_s, range_m);
        readings += 1;
    }
    foreseen
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GateStatistics {
    pub readings: usize,
    pub gated: usize,
    pub mean_m: f64,
}

pub fn gate_statistics(foreseen: &[RangeForecast]) -> Option<GateStatistics> {
    let gates: Vec<f64> = foreseen.iter().filter_map(|one| one.gate_m).collect();
    let mean_m = mean(gates.iter().copied())?;
    Some(GateStatistics { readings: gates.len(), gated: foreseen.iter().filter(|one| one.is_gated).count(), mean_m })
}

/// Root mean square prediction errors, over the readings that both methods predicted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForecastScore {
    pub readings: usize,
    pub kalman_rms_m: f64,
    pub other_rms_m: f64,
}

/// Scores the filter against another method; `other` returns that method's prediction. `None` without a common reading.
pub fn score_forecasts(
    foreseen: &[RangeForecast],
    other: impl Fn(&RangeForecast) -> Option<f64>,
) -> Option<ForecastScore> {
    let common: Vec<(&RangeForecast, f64)> =
        foreseen.iter().filter_map(|foreseen| Some((foreseen, other(foreseen)?))).collect();
    let kalman = mean(common.iter().map(|(foreseen, _)| (foreseen.range_m - foreseen.kalman_m).powi(2)))?;
    let other = mean(common.iter().map(|(foreseen, other_m)| (foreseen.range_m - other_m).powi(2)))?;
    Some(ForecastScore { readings: common.len(), kalman_rms_m: kalman.sqrt(), other_rms_m: other.sqrt() })
}

// The drive and the noise of an unmeasured car, from its run so far.
//
// A bank of candidates: time constants, process noises, reading noises. For each the steady speed per input follows by least
// squares from the steps between the readings; the filter then runs over all that is known, and the candidate that foresaw the
// readings best is taken. Only the past is used. Before a car has shown that its motors move it, the input is assumed to do
// nothing: the steady speed has a prior about zero.
//
// # Model
// ```text
// v_ss = argmin  sum (dz_i + v_ss dphi_i)^2 / (2 sigma_z^2 + q dt_i)  +  (v_ss / sigma_v)^2        q = sigma_u^2 / 7.6 ms
// candidate = argmin  1/2 sum (min(nis_i, 25) + ln S_i)  +  1/2 (v_ss / sigma_v)^2  +  doublings away from what is usual
// ```
// # Assumptions
// One drive for the whole log. A reading five sigmas off says no more against a candidate than one of just that.

/// The time constant of the paper's car, and others: faster and slower ones.
const TIME_CONSTANTS_S: [f64; 4] = [0.2, USUAL_TIME_CONSTANT_S, 0.9, 1.8];
const USUAL_TIME_CONSTANT_S: f64 = 0.433;
/// Shares of the paper's process noise.
const PROCESS_SHARES: [f64; 5] = [1.0, 0.4, 0.2, 0.1, 0.04];
/// Multiples of the configured reading noise: the effect of a bad target or daylight.
const RANGE_FACTORS: [f64; 4] = [1.0, 2.0, 4.0, 10.0];
/// Log-prior of each doubling away from the usual value: half a nat, so that a handful of readings decides.
const PER_DOUBLING: f64 = 0.5;
/// Prior of the steady speed of small cars.
const STEADY_SIGMA_M_PER_S: f64 = 2.0;
/// Five sigmas, squared.
const MAX_NIS: f64 = 25.0;
/// The control period of the paper, for which its process noise is given.
const PAPER_STEP_S: f64 = 0.0076;

/// The first-order model of a car before a wall, and its noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Per unit of input; negative where a positive input drives away from the wall.
    pub steady_m_per_s: f64,
    pub time_constant_s: f64,
    pub noise: KalmanNoise,
}

/// The candidate with the highest likelihood, with its filter at the log's end; `range_sigma_m` is the configured noise of a reading. An
/// empty log gives the usual one.
fn best_plant(log: &WallLog, range_sigma_m: f64) -> (Plant, PlantFilter) {
    let mut best: Option<(f64, Plant, PlantFilter)> = None;
    for time_constant_s in TIME_CONSTANTS_S {
        let steps = steps(log, 1.0 / time_constant_s);
        for share in PROCESS_SHARES {
            for factor in RANGE_FACTORS {
                let noise =
                    KalmanNoise { process_m: share * KalmanNoise::PAPER.process_m, range_m: factor * range_sigma_m };
                let plant = Plant { steady_m_per_s: estimate_steady_speed(&steps, noise), time_constant_s, noise };
                let unusual =
                    (time_constant_s / USUAL_TIME_CONSTANT_S).log2().abs() + share.log2().abs() + factor.log2();
                let (cost, runner) = run_plant(log, plant);
                let prior = 0.5 * (plant.steady_m_per_s / STEADY_SIGMA_M_PER_S).powi(2);
                let cost = cost + prior + PER_DOUBLING * unusual;
                if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
                    best = Some((cost, plant, runner));
                }
            }
        }
    }
    best.map_or_else(
        || {
            let noise = KalmanNoise { range_m: range_sigma_m, ..KalmanNoise::PAPER };
            let usual = Plant { steady_m_per_s: 0.0, time_constant_s: USUAL_TIME_CONSTANT_S, noise };
            (usual, PlantFilter::new(usual))
        },
        |(_, plant, runner)| (plant, runner),
    )
}

struct PlantFilter {
    kalman: WallKalman,
    steady_m_per_s: f64,
}

impl PlantFilter {
    fn new(plant: Plant) -> Self {
        // The filter wants to know the ratio d/m only: commands come as speeds. So d = 1 serves every steady speed, zero included.
        let model = WallApproachModel { drag_s_per_m: 1.0, mass_s2_per_m: plant.time_constant_s };
        Self {
            kalman: WallKalman::new(model, plant.noise, RangeFilterVariant::Corrected),
            steady_m_per_s: plant.steady_m_per_s,
        }
    }

    fn observe(&mut self, at_s: f64, reading: WallReading) -> f64 {
        match reading {
            WallReading::Input(input) => {
                self.kalman.observe_input(at_s, input * self.steady_m_per_s);
                0.0
            }
            WallReading::Range(range_m) => {
                let record = self.fuse(at_s, range_m);
                innovation_sigma(&record).map_or(0.0, |s_m2| 0.5 * (record.nis.min(MAX_NIS) + s_m2.ln()))
            }
        }
    }

    fn fuse(&mut self, at_s: f64, range_m: f64) -> FusionRecord {
        self.kalman.fuse(at_s, range_m)
    }

    fn distance_m(&self, at_s: f64) -> Option<f64> {
        self.kalman.estimate(at_s).map(|estimate| estimate.distance_m)
    }
}

fn run_plant(log: &WallLog, plant: Plant) -> (f64, PlantFilter) {
    let mut runner = PlantFilter::new(plant);
    let costs = log.entries().iter();
    let cost = costs.map(|entry| runner.observe(entry.at_s, entry.reading)).sum();
    (cost, runner)
}

/// Between readings: time, change of the distance, and travel per unit of steady speed.
fn steps(log: &WallLog, rate_per_s: f64) -> Vec<(f64, f64, f64)> {
    let readings = responses(log, rate_per_s);
    let pairs = readings.windows(2);
    pairs
        .map(|pair| {
            let (from, to) = (pair[0], pair[1]);
            (to.at_s - from.at_s, to.range_m - from.range_m, to.distance_m - from.distance_m)
        })
        .collect()
}

fn estimate_steady_speed(steps: &[(f64, f64, f64)], noise: KalmanNoise) -> f64 {
    let density = noise.process_m.powi(2) / PAPER_STEP_S;
    let mut across = 0.0;
    let mut along = STEADY_SIGMA_M_PER_S.powi(-2);
    for (dt_s, change_m, distance_m) in steps {
        let weight = 1.0 / (2.0 * noise.range_m.powi(2) + density * dt_s);
        across -= weight * change_m * distance_m;
        along += weight * distance_m * distance_m;
    }
    across / along
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::wall::log::test_logs::log_of;

    fn log(ranges: &[f64]) -> WallLog {
        let ranges = ranges.iter().enumerate().map(|(index, range_m)| (0.1 * index as f64, *range_m));
        log_of([], ranges).with_assumed_drive()
    }

    const SIGMA_M: f64 = 0.01;

    #[test]
    fn what_is_foretold_does_not_depend_on_what_comes_later() {
        let ranges = [3.0, 2.98, 2.93, 2.86, 2.77, 2.66, 2.52, 2.39, 2.21, 2.04];
        let mut changed = ranges;
        changed[8..].fill(9.0);
        let (before, after) = (forecast(&log(&ranges), SIGMA_M), forecast(&log(&changed), SIGMA_M));
        assert_eq!(before.len(), 9);
        for (before, after) in before.iter().zip(&after).take(7) {
            assert_eq!(before, after);
        }
        assert_eq!(before[7].kalman_m, after[7].kalman_m);
        assert_ne!(before[8].kalman_m, after[8].kalman_m);
        assert_eq!(before[0].line_m, None);
        assert!((before[1].line_m.unwrap() - 2.96).abs() < 1e-9);
    }

    #[test]
    fn a_reading_beyond_the_gate_is_refused_and_counted() {
        // 0.5 m/s; the reading at 1.6 s is a passer-by.
        let mut ranges: Vec<f64> = (0..24).map(|index| 3.0 - 0.05 * f64::from(index)).collect();
        ranges[16] = 0.1;
        let foreseen = forecast(&log(&ranges), SIGMA_M);
        let refused: Vec<usize> = (0..23).filter(|index| foreseen[*index].is_gated).collect();
        // There is no prediction of the first reading.
        assert_eq!(refused, [15]);
        let off_m = (foreseen[15].range_m - foreseen[15].kalman_m).abs();
        assert!(off_m > foreseen[15].gate_m.unwrap());
        let used = gate_statistics(&foreseen).unwrap();
        assert_eq!((used.readings, used.gated), (23, 1));
        assert!(used.mean_m > 0.03 && used.mean_m < off_m, "{used:?}");
        assert_eq!(gate_statistics(&[]), None);
    }

    #[test]
    fn scores_are_over_common_readings_alone() {
        let foreseen = forecast(&log(&[3.0, 2.9, 2.7]), SIGMA_M);
        let by_line = score_forecasts(&foreseen, |foreseen| foreseen.line_m).unwrap();
        assert_eq!(by_line.readings, 1);
        assert!((by_line.other_rms_m - 0.1).abs() < 1e-9);
        let expected = (foreseen[1].range_m - foreseen[1].kalman_m).abs();
        assert!((by_line.kalman_rms_m - expected).abs() < 1e-12);
        assert_eq!(score_forecasts(&foreseen, |_| None), None);
    }

    /// A car of 2 m/s and 0.9 s under full drive, read ten times a second with 10 mm of noise.
    fn driven(input: f64, readings: u32) -> WallLog {
        let mut normals = Pcg64::seed_from_u64(7);
        let ranges = (0..readings).map(|index| {
            let t = 0.1 * f64::from(index);
            let distance_m = 2.0 * (t - 0.9 * (1.0 - (-t / 0.9).exp()));
            let noise: f64 = normals.sample(StandardNormal);
            (t, 5.0 - distance_m + 0.01 * noise)
        });
        log_of([(0.0, input)], ranges)
    }

    #[test]
    fn a_car_is_recognised_by_what_it_has_done_whatever_the_sign_of_its_input() {
        for input in [1.0, -0.5] {
            let (plant, _) = best_plant(&driven(input, 25), SIGMA_M);
            assert!((plant.steady_m_per_s * input / 2.0 - 1.0).abs() < 0.15, "{plant:?}");
            assert_eq!(plant.time_constant_s, 0.9, "{plant:?}");
            assert!(plant.noise.process_m <= 0.01 && plant.noise.range_m <= 0.02);
        }
    }

    #[test]
    fn a_car_that_has_done_nothing_is_not_believed_to_move() {
        for readings in [0, 1] {
            let (plant, _) = best_plant(&driven(1.0, readings), SIGMA_M);
            assert_eq!(plant.steady_m_per_s, 0.0);
            assert_eq!(plant.time_constant_s, USUAL_TIME_CONSTANT_S);
        }
    }
}

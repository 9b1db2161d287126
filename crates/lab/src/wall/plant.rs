//! The drive and the noise of an unmeasured car, from its run so far.
//!
//! A bank of candidates: time constants, process noises, reading noises. For each the steady speed per input follows by least
//! squares from the steps between the readings; the filter then runs over all that is known, and the candidate that foresaw the
//! readings best is taken. Only the past is used. Before a car has shown that its motors move it, the input is assumed to do
//! nothing: the steady speed has a prior about zero.
//!
//! # Model
//! ```text
//! v_ss = argmin  sum (dz_i + v_ss dphi_i)^2 / (2 sigma_z^2 + q dt_i)  +  (v_ss / sigma_v)^2        q = sigma_u^2 / 7.6 ms
//! candidate = argmin  1/2 sum (min(nis_i, 25) + ln S_i)  +  1/2 (v_ss / sigma_v)^2  +  doublings away from what is usual
//! ```
//! # Assumptions
//! One drive for the whole log. A reading five sigmas off says no more against a candidate than one of just that.

use posebridge_estimator::models::wall_approach::WallApproachModel;
use posebridge_estimator::papers::range_kf::RangeFilterVariant;
use posebridge_telemetry::FusionRecord;

use super::log::{WallLog, WallReading};
use super::replay_filter::{ApproachEstimator, KalmanNoise, WallKalman};
use super::response::responses;
use super::validate::innovation_sigma;

/// The time constant of the paper's car, s, and others: nimble and heavy ones.
const TIME_CONSTANTS_S: [f64; 4] = [0.2, USUAL_TIME_CONSTANT_S, 0.9, 1.8];
const USUAL_TIME_CONSTANT_S: f64 = 0.433;
/// Shares of the paper's process noise.
const PROCESS_SHARES: [f64; 5] = [1.0, 0.4, 0.2, 0.1, 0.04];
/// Multiples of the reading's noise that the robot's file gives: what a bad target or daylight makes of it.
const RANGE_FACTORS: [f64; 4] = [1.0, 2.0, 4.0, 10.0];
/// Each doubling away from what is usual counts like this much log-likelihood: half a nat, so that a handful of readings decides.
const PER_DOUBLING: f64 = 0.5;
/// One standard deviation of the speed of small cars under full drive, m/s.
const STEADY_SIGMA_M_PER_S: f64 = 2.0;
/// Five sigmas, squared.
const MAX_NIS: f64 = 25.0;
/// The step of the paper's loop, for which its process noise is given, s.
const PAPER_STEP_S: f64 = 0.0076;

/// The model of a car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Steady speed per unit of input, m/s; negative where a positive input drives away from the wall.
    pub steady_m_per_s: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
    /// The configured noise of the filter.
    pub noise: KalmanNoise,
}

/// What is known before the first reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantSearch {
    /// Noise of a reading by the robot's file, m.
    pub range_sigma_m: f64,
}

impl PlantSearch {
    /// The candidate that explains a log best, with its filter at the log's end. An empty log gives the usual one.
    pub(super) fn best(self, log: &WallLog) -> (Plant, PlantFilter) {
        let mut best: Option<(f64, Plant, PlantFilter)> = None;
        for time_constant_s in TIME_CONSTANTS_S {
            let steps = steps(log, 1.0 / time_constant_s);
            for share in PROCESS_SHARES {
                for factor in RANGE_FACTORS {
                    let noise = KalmanNoise {
                        process_m: share * KalmanNoise::PAPER.process_m,
                        range_m: factor * self.range_sigma_m,
                    };
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
        best.map_or_else(|| self.usual(), |(_, plant, runner)| (plant, runner))
    }

    /// Every cost was no number.
    fn usual(self) -> (Plant, PlantFilter) {
        let plant = Plant {
            steady_m_per_s: 0.0,
            time_constant_s: USUAL_TIME_CONSTANT_S,
            noise: KalmanNoise { range_m: self.range_sigma_m, ..KalmanNoise::PAPER },
        };
        (plant, PlantFilter::new(plant))
    }
}

/// The filter with a plant.
pub(super) struct PlantFilter {
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

    /// Takes an entry; gives what it costs.
    pub(super) fn observe(&mut self, at_s: f64, reading: WallReading) -> f64 {
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

    /// Processes a reading and returns its outcome.
    pub(super) fn fuse(&mut self, at_s: f64, range_m: f64) -> FusionRecord {
        self.kalman.fuse(at_s, range_m)
    }

    /// Its estimated distance, m.
    pub(super) fn distance_m(&self, at_s: f64) -> Option<f64> {
        self.kalman.estimate(at_s).map(|belief| belief.distance_m)
    }
}

fn run_plant(log: &WallLog, plant: Plant) -> (f64, PlantFilter) {
    let mut runner = PlantFilter::new(plant);
    let costs = log.entries().iter();
    let cost = costs.map(|entry| runner.observe(entry.at_s, entry.reading)).sum();
    (cost, runner)
}

/// From reading to reading: time, change of the distance, and way of a unit of steady speed.
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
    for (dt_s, change_m, way_m) in steps {
        let weight = 1.0 / (2.0 * noise.range_m.powi(2) + density * dt_s);
        across -= weight * change_m * way_m;
        along += weight * way_m * way_m;
    }
    across / along
}

#[cfg(test)]
mod tests {
    use super::super::log::WallEntry;
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64;

    const SEARCH: PlantSearch = PlantSearch { range_sigma_m: 0.01 };

    /// A car of 2 m/s and 0.9 s under full drive, read ten times a second with 10 mm of noise.
    fn driven(input: f64, readings: u32) -> WallLog {
        let mut normals = Pcg64::seed_from_u64(7);
        let ranges = (0..readings).map(|index| {
            let t = 0.1 * f64::from(index);
            let way_m = 2.0 * (t - 0.9 * (1.0 - (-t / 0.9).exp()));
            let noise: f64 = normals.sample(StandardNormal);
            WallEntry { at_s: t, reading: WallReading::Range(5.0 - way_m + 0.01 * noise) }
        });
        let drive = WallEntry { at_s: 0.0, reading: WallReading::Input(input) };
        WallLog::new([drive].into_iter().chain(ranges).collect())
    }

    #[test]
    fn a_car_is_recognised_by_what_it_has_done_whatever_the_sign_of_its_input() {
        for input in [1.0, -0.5] {
            let (plant, _) = SEARCH.best(&driven(input, 25));
            assert!((plant.steady_m_per_s * input / 2.0 - 1.0).abs() < 0.15, "{plant:?}");
            assert_eq!(plant.time_constant_s, 0.9, "{plant:?}");
            assert!(plant.noise.process_m <= 0.01 && plant.noise.range_m <= 0.02);
        }
    }

    #[test]
    fn a_car_that_has_done_nothing_is_not_believed_to_move() {
        for readings in [0, 1] {
            let (plant, _) = SEARCH.best(&driven(1.0, readings));
            assert_eq!(plant.steady_m_per_s, 0.0);
            assert_eq!(plant.time_constant_s, USUAL_TIME_CONSTANT_S);
        }
    }
}

//! Matrices of the paper's filters that its innovations make most likely, instead of tuned by hand.
//!
//! # Model
//! ```text
//! L(Q, R) = sum of ln N(nu; 0, S) over the readings while a wheel turns        nu and S of the filter itself
//! each standard deviation of Q and R = the printed one times exp(u)        u by a search that needs no derivative
//! ```
//! At rest a counter repeats itself: there nu is zero, and the most likely R is zero, too. No truth and no camera enters. What no innovation depends on stays as printed: Q of x and y, and P0.
//!
//! # Assumptions
//! Innovations are taken as white. The errors of th_enc and th_gyro are not, so these two R are those of the sample-to-sample part.
//!
//! # Sources
//! Mehra (1970), identification of variances from innovations; Bar-Shalom, Li and Kirubarajan (2001), section 5.4.

use posebridge_estimator::papers::ekf5::{self, FixUsage};
use posebridge_estimator::papers::paper1::{FiveStateMatrices, SAMPLING_INTERVAL_S, SpeedMatrices, WheelMatrices};
use posebridge_estimator::papers::velocity_kf;
use posebridge_estimator::papers::wheel_kf::{self, WheelOdometry};
use posebridge_estimator::{Filter, FilterConfig, Params};
use posebridge_telemetry::FusionOutcome;

use super::noise::rounding_variances;
use super::prepare_config;
use super::table::{SensorTable, TableSensor};
use crate::tuning::{SearchOptions, maximise};

/// R of a gyro that does not round, degrees²: as the corrected EKF.
const MIN_GYRO_HEADING_DEG2: f64 = 1e-4;
const SENSORS: [TableSensor; 3] = [TableSensor::Wheels, TableSensor::Accelerometers, TableSensor::Gyro];

/// The matrices of the three filters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChainMatrices {
    pub wheels: WheelMatrices,
    pub speeds: SpeedMatrices,
    pub five: FiveStateMatrices,
}

impl ChainMatrices {
    /// Equations 19, 23 and 26.
    pub const AS_PRINTED: Self = Self {
        wheels: WheelMatrices::AS_PRINTED,
        speeds: SpeedMatrices::AS_PRINTED,
        five: FiveStateMatrices::AS_PRINTED,
    };

    /// The most likely ones by the innovations over these drives.
    pub fn most_likely(tables: &[SensorTable], base: &FilterConfig) -> Self {
        let printed = Self::AS_PRINTED;
        let least = SmallestVariances::of(base);
        let drives: Vec<Drive<'_>> = tables.iter().map(|table| Drive::new(table, base)).collect();
        let wheels = |u: &[f64]| WheelMatrices {
            process: scaled(printed.wheels.process, &u[..2]),
            variances: at_least(scaled(printed.wheels.variances, &u[2..]), [least.counter; 2]),
            ..printed.wheels
        };
        let speeds = |u: &[f64]| SpeedMatrices {
            process: scaled(printed.speeds.process, &u[..2]),
            variances: at_least(scaled(printed.speeds.variances, &u[2..]), [least.forward, least.turn]),
            ..printed.speeds
        };
        let five = |u: &[f64]| {
            let [x, y, rest @ ..] = printed.five.process;
            let [heading, forward, turn] = scaled(rest, &u[..3]);
            FiveStateMatrices {
                process: [x, y, heading, forward, turn],
                variances: at_least(scaled(printed.five.variances, &u[3..]), least.five_states()),
                ..printed.five
            }
        };
        Self {
            wheels: wheels(&search(4, &drives, |u, config| wheel_kf::build(config, &wheels(u), WheelOdometry::Angles))),
            speeds: speeds(&search(4, &drives, |u, config| velocity_kf::build(config, &speeds(u)))),
            five: five(&search(6, &drives, |u, config| ekf5::build(config, &five(u), FixUsage::Unused))),
        }
    }
}

/// Variances whose standard deviations are exp(u) times as large.
fn scaled<const K: usize>(variances: [f64; K], u: &[f64]) -> [f64; K] {
    std::array::from_fn(|i| variances[i] * u.get(i).map_or(1.0, |u| (2.0 * u).exp()))
}

fn at_least<const K: usize>(variances: [f64; K], least: [f64; K]) -> [f64; K] {
    std::array::from_fn(|i| variances[i].max(least[i]))
}

/// R by the resolution of the sensors, cm and degrees.
struct SmallestVariances {
    counter: f64,
    forward: f64,
    turn: f64,
    wheel_heading: f64,
    gyro_heading: f64,
}

impl SmallestVariances {
    fn of(config: &FilterConfig) -> Self {
        let rounding = rounding_variances(&config.geometry);
        let gyro_deg = config.noise.gyro_resolution_rad_per_s.to_degrees() * SAMPLING_INTERVAL_S;
        Self {
            counter: rounding.counter,
            forward: rounding.forward,
            turn: rounding.turn,
            // w is a difference of two roundings over T, th_enc has one.
            wheel_heading: 0.5 * rounding.turn * SAMPLING_INTERVAL_S * SAMPLING_INTERVAL_S,
            gyro_heading: (gyro_deg * gyro_deg / 12.0).max(MIN_GYRO_HEADING_DEG2),
        }
    }

    const fn five_states(&self) -> [f64; 3] {
        [self.forward, self.wheel_heading, self.gyro_heading]
    }
}

struct Drive<'a> {
    table: &'a SensorTable,
    config: FilterConfig,
}

impl<'a> Drive<'a> {
    fn new(table: &'a SensorTable, base: &FilterConfig) -> Self {
        let config = prepare_config(table, base);
        // Nothing asks for the past.
        let params = Params { history_s: 0.0, ..config.params };
        Self { table, config: FilterConfig { params, ..config } }
    }

    fn log_likelihood(&self, filter: &mut dyn Filter) -> f64 {
        let unit_rad = self.table.unit.rad_per_unit(&self.config.geometry);
        let mut sum = 0.0;
        let mut before = None;
        for row in &self.table.rows {
            let turns = before.replace(row.encoders).is_some_and(|before| before != row.encoders);
            for observation in row.observations(unit_rad, &SENSORS) {
                let record = filter.observe(&observation);
                if turns && record.outcome == FusionOutcome::Accepted && record.degrees_of_freedom > 0 {
                    sum += record.log_likelihood;
                }
            }
        }
        sum
    }
}

fn search(
    variables: usize,
    drives: &[Drive<'_>],
    build: impl Fn(&[f64], &FilterConfig) -> Box<dyn Filter>,
) -> Vec<f64> {
    // 15 %: finer differences are lost in the scatter between drives.
    let options = SearchOptions { last_step: 0.15, ..SearchOptions::default() };
    let value =
        |u: &Vec<f64>| drives.iter().map(|drive| drive.log_likelihood(build(u, &drive.config).as_mut())).sum::<f64>();
    maximise(variables, &options, |points| points.iter().map(value).collect()).at
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{SensorNoise, Timestamp};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use crate::square::table::{EncoderUnit, SensorRow};
    use crate::statistics::normal_pair;
    use crate::test_support;

    /// Counters of wheels whose rates walk at random, with white noise on each reading.
    #[test]
    fn the_most_likely_matrices_are_those_by_which_the_counts_were_made() {
        let (rate_variance, counter_variances) = (40.0_f64, [1.5_f64, 6.0]);
        let mut random = Pcg64::seed_from_u64(7);
        let (mut angles, mut rates) = ([0.0; 2], [0.0; 2]);
        let rows = (0..1_500).map(|index| {
            let encoders = [0, 1].map(|side: usize| {
                let [walk, noise] = normal_pair(random.random(), random.random());
                angles[side] += SAMPLING_INTERVAL_S * rates[side];
                rates[side] += rate_variance.sqrt() * walk;
                angles[side] + counter_variances[side].sqrt() * noise
            });
            SensorRow { encoders, ..SensorRow::empty(Timestamp::from_millis(50 * index)) }
        });
        let table = SensorTable { unit: EncoderUnit::Degrees, rows: rows.collect() };
        let config = test_support::config([0.028; 2], 0.112, 1.0_f64.to_radians(), SensorNoise::EXACT);
        let found = ChainMatrices::most_likely(&[table], &config).wheels;
        for (found, made) in
            found.variances.into_iter().zip(counter_variances).chain([(found.process[1], rate_variance)])
        {
            assert!((0.67..1.5).contains(&(found / made)), "{found} instead of {made}");
        }
    }
}

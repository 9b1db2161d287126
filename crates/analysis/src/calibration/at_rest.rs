//! What gyro and accelerometers say while a robot stands: bias, noise, step, and how the bias walks.
//!
//! # Model
//! ```text
//! reading = bias + white noise + rounding
//! white noise   sigma = sqrt(mean (z_k+1 - z_k)^2 / 2): a bias that walks slowly takes no part in it
//! step          the smallest distance of two different readings, if all distances are multiples of it
//! walk          the means of stretches of T seconds differ by sigma^2_walk T more than the white noise explains
//! ```
//! # Source
//! Allan (1966), Proceedings of the IEEE 54(2): variance of neighbouring means; docs/lab/calibrate.md section 5.

use posebridge_telemetry::{Known, Observation, Observed};

use super::CalibrationError;

/// A robot counts as standing when its counters have not moved for this long, in seconds.
pub const STANDING_S: f64 = 0.4;
/// Fewest readings that make a mean worth saving.
const FEWEST: usize = 20;
/// Length of the stretches whose means tell how a bias walks, in seconds.
const STRETCH_S: f64 = 5.0;
/// A remainder of the step below this share of it is rounding of the file.
const SAME_STEP: f64 = 0.05;

/// One channel of a sensor, with its stamps in seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestingChannel {
    /// Stretches of rest in the order of time: (stamp in s, reading in SI).
    pub stretches: Vec<Vec<(f64, f64)>>,
}

/// What a channel says at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtRest {
    /// The mean, with its standard deviation; in the channel's own unit.
    pub bias: Known,
    /// White noise of a reading.
    pub noise: f64,
    /// Distance between neighbouring readings that the sensor can give; zero if it is fine.
    pub step: f64,
    /// Random walk of the bias, per root second; `None` if there was too little rest to see it.
    pub walk_per_sqrt_s: Option<f64>,
    /// How many readings.
    pub readings: usize,
    /// For how long, in seconds.
    pub rest_s: f64,
}

/// The channels of a robot that stands now and then.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Resting {
    /// Turn rate, in rad/s.
    pub gyro: RestingChannel,
    /// Forward acceleration at the left wheel, in m/s².
    pub left_accelerometer: RestingChannel,
    /// At the right wheel.
    pub right_accelerometer: RestingChannel,
}

impl Resting {
    /// Picks the readings made while no wheel had moved for [`STANDING_S`] and would not move before the next wheel reading.
    ///
    /// Takes observations in the order of their stamps. Without wheel readings nothing counts as rest.
    #[must_use]
    pub fn of(observations: &[Observation]) -> Self {
        let mut resting = Self::default();
        for (from_s, until_s) in rests(observations) {
            let within = |s: f64| s > from_s && s <= until_s;
            let mut stretch = [const { Vec::new() }; 3];
            for observation in observations {
                let at_s = observation.stamp.as_nanos() as f64 / 1e9;
                if !within(at_s) {
                    continue;
                }
                for (channel, value) in stretch.iter_mut().zip(readings(&observation.observed)) {
                    channel.extend(value.filter(|v| v.is_finite()).map(|v| (at_s, v)));
                }
            }
            let [gyro, left, right] = stretch;
            resting.gyro.add(gyro);
            resting.left_accelerometer.add(left);
            resting.right_accelerometer.add(right);
        }
        resting
    }
}

/// Gyro, left and right accelerometer.
const fn readings(observed: &Observed) -> [Option<f64>; 3] {
    match observed {
        Observed::TurnRate(rate) => [Some(rate.0), None, None],
        Observed::WheelAccelerations { left, right } => [None, Some(left.0), Some(right.0)],
        Observed::WheelAngles { .. }
        | Observed::OdometerPose(_)
        | Observed::BodyVelocity { .. }
        | Observed::Fix(_)
        | Observed::Landmark { .. }
        | Observed::BeaconRange { .. }
        | Observed::WallRange(_)
        | Observed::CompassHeading(_)
        | Observed::Temperature(_) => [None; 3],
    }
}

/// From when to when the robot certainly stood, in seconds.
fn rests(observations: &[Observation]) -> Vec<(f64, f64)> {
    let mut rests = Vec::new();
    let mut last: Option<([f64; 2], f64, f64)> = None;
    for observation in observations {
        let Observed::WheelAngles { left, right } = observation.observed else {
            continue;
        };
        let at_s = observation.stamp.as_nanos() as f64 / 1e9;
        let angles = [left.0, right.0];
        last = match last {
            Some((before, since_s, _)) if before == angles => Some((angles, since_s, at_s)),
            Some((_, since_s, until_s)) => {
                rests.push((since_s, until_s));
                Some((angles, at_s, at_s))
            }
            None => Some((angles, at_s, at_s)),
        };
    }
    rests.extend(last.map(|(_, since_s, until_s)| (since_s, until_s)));
    rests
        .into_iter()
        .filter(|(since_s, until_s)| until_s - since_s > STANDING_S)
        .map(|(since_s, until_s)| (since_s + STANDING_S, until_s))
        .collect()
}

impl RestingChannel {
    fn add(&mut self, stretch: Vec<(f64, f64)>) {
        if !stretch.is_empty() {
            self.stretches.push(stretch);
        }
    }

    /// What the channel says.
    ///
    /// # Errors
    /// [`CalibrationError::TooLittle`]: fewer than 20 readings at rest.
    pub fn at_rest(&self) -> Result<AtRest, CalibrationError> {
        let all: Vec<f64> = self.stretches.iter().flatten().map(|(_, v)| *v).collect();
        if all.len() < FEWEST {
            return Err(CalibrationError::TooLittle {
                what: "readings at rest",
                found: all.len(),
                needed: FEWEST,
            });
        }
        let count = all.len() as f64;
        let mean = all.iter().sum::<f64>() / count;
        let noise = self.white_noise();
        let step = step_of(&all);
        let rest_s = self
            .stretches
            .iter()
            .filter_map(|stretch| Some(stretch.last()?.0 - stretch.first()?.0))
            .sum();
        Ok(AtRest {
            bias: Known {
                value: mean,
                // Readings that never change hide the bias within a step.
                sigma: (noise * noise / count + step * step / (12.0 * count)).sqrt(),
            },
            noise,
            step,
            walk_per_sqrt_s: self.walk(noise),
            readings: all.len(),
            rest_s,
        })
    }

    fn white_noise(&self) -> f64 {
        let pairs = || self.stretches.iter().flat_map(|stretch| stretch.windows(2));
        let squares: f64 = pairs().map(|pair| (pair[1].1 - pair[0].1).powi(2)).sum();
        let count = pairs().count();
        if count == 0 {
            return 0.0;
        }
        (squares / (2.0 * count as f64)).sqrt()
    }

    fn walk(&self, noise: f64) -> Option<f64> {
        let mut excess = Vec::new();
        for stretch in &self.stretches {
            let first_s = stretch.first()?.0;
            let mut means: Vec<(f64, f64)> = Vec::new();
            for (at_s, value) in stretch {
                let index = ((at_s - first_s) / STRETCH_S) as usize;
                means.resize(means.len().max(index + 1), (0.0, 0.0));
                means[index].0 += value;
                means[index].1 += 1.0;
            }
            // The last one is seldom whole.
            means.pop();
            for pair in means.windows(2) {
                let [(sum_a, n_a), (sum_b, n_b)] = [pair[0], pair[1]];
                if n_a > 0.0 && n_b > 0.0 {
                    let apart = sum_b / n_b - sum_a / n_a;
                    excess.push(apart * apart - noise * noise * (1.0 / n_a + 1.0 / n_b));
                }
            }
        }
        if excess.len() < 3 {
            return None;
        }
        // The means of two neighbouring stretches of a random walk differ by 2/3 of its variance over one of them.
        let mean = excess.iter().sum::<f64>() / excess.len() as f64;
        Some((mean.max(0.0) / (STRETCH_S * 2.0 / 3.0)).sqrt())
    }
}

/// The step between readings, zero if there is none that all distances share.
///
/// A link that carries a coarse sensor in finer units of its own smears each step a little: what lies close together beside the whole
/// span counts as one value, if at least three such values are left and their distances share a step.
fn step_of(readings: &[f64]) -> f64 {
    let mut sorted = readings.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else {
        return 0.0;
    };
    let smeared = shared_distance(&sorted, SMEARED * (last - first));
    if let Some((step, values)) = smeared
        && values >= FEWEST_SMEARED
    {
        return step;
    }
    // Decimal fractions differ in their last digits.
    let largest = last.abs().max(f64::MIN_POSITIVE);
    shared_distance(&sorted, 1e-9 * largest).map_or(0.0, |(step, _)| step)
}

/// Readings within this share of the span of all of them may be one value.
const SMEARED: f64 = 0.01;
/// Fewer values than these may be two biases.
const FEWEST_SMEARED: usize = 3;

/// The step if all distances of two values are multiples of one, and how many values there are; readings no further apart than `same`
/// are one value, which must be narrow beside the step.
fn shared_distance(sorted: &[f64], same: f64) -> Option<(f64, usize)> {
    let values = sorted.chunk_by(|before, after| after - before <= same);
    let values: Vec<&[f64]> = values.collect();
    let ends = |value: &[f64]| Some((*value.first()?, *value.last()?));
    let ends: Vec<(f64, f64)> = values.iter().filter_map(|value| ends(value)).collect();
    let distances: Vec<f64> = ends
        .windows(2)
        .filter_map(|pair| Some(pair.last()?.0 - pair.first()?.1))
        .collect();
    let smallest = distances.iter().copied().min_by(f64::total_cmp)?;
    let widest = ends
        .iter()
        .map(|(low, high)| high - low)
        .fold(0.0, f64::max);
    let is_whole = |distance: &f64| {
        let steps = distance / smallest;
        (steps - steps.round()).abs() <= SAME_STEP * steps.max(1.0)
    };
    // Few different values among many readings: the sensor rounds. Many: it does not.
    let is_coarse = distances.len() * 4 < sorted.len() && widest <= SAME_STEP * smallest;
    if !is_coarse || !distances.iter().all(is_whole) {
        return None;
    }
    let mut counts = 0.0;
    let counted = std::iter::once(0.0).chain(distances.iter().map(|distance| {
        counts += (distance / smallest).round();
        counts
    }));
    let counted: Vec<f64> = counted.collect();
    Some((slope_through(&counted, &values)?, values.len()))
}

/// The slope of the line through all readings over the counts of their values.
fn slope_through(counts: &[f64], values: &[&[f64]]) -> Option<f64> {
    let all = || counts.iter().zip(values);
    let readings: f64 = values.iter().map(|value| value.len() as f64).sum();
    let mean = |of: &dyn Fn(f64, &[f64]) -> f64| {
        all().map(|(count, value)| of(*count, value)).sum::<f64>() / readings
    };
    let count = mean(&|count, value| count * value.len() as f64);
    let reading = mean(&|_, value| value.iter().sum());
    let along = mean(&|at, value| (at - count).powi(2) * value.len() as f64);
    let across = mean(&|at, value| {
        let off = value.iter().map(|one| one - reading);
        (at - count) * off.sum::<f64>()
    });
    (along > 0.0).then(|| across / along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Radians, RadiansPerSecond, SensorId, Span, Stamp};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    fn seen(millis: i64, observed: Observed) -> Observation {
        Observation {
            sensor: SensorId::GYRO,
            stamp: Stamp::from_millis(millis),
            stamp_sigma: Span::ZERO,
            observed,
        }
    }

    #[test]
    fn only_what_was_read_while_the_counters_stood_counts() {
        let mut observations = Vec::new();
        for i in 0..200 {
            let angle = Radians(if i < 100 { 0.0 } else { f64::from(i) });
            let wheels = Observed::WheelAngles {
                left: angle,
                right: angle,
            };
            observations.push(seen(i64::from(i) * 50, wheels));
            let rate = if i < 100 { 0.01 } else { 5.0 };
            let rate = Observed::TurnRate(RadiansPerSecond(rate));
            observations.push(seen(i64::from(i) * 50 + 1, rate));
        }
        observations.push(seen(20, Observed::TurnRate(RadiansPerSecond(f64::NAN))));
        let rest = Resting::of(&observations).gyro.at_rest().unwrap();
        assert!((rest.bias.value - 0.01).abs() < 1e-15);
        // 4.95 s of standing less the first 0.4 s, one reading each 50 ms.
        assert_eq!(rest.readings, 91);
    }

    #[test]
    fn noise_step_and_bias_of_a_rounding_gyro_are_found() {
        let mut random = Pcg64::seed_from_u64(3);
        let mut draw = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let step = 0.017_453_3;
        let readings = (0..4_000).map(|i| {
            let exact = 0.031 + 0.03 * draw();
            (f64::from(i) * 0.05, (exact / step).round() * step)
        });
        let channel = RestingChannel {
            stretches: vec![readings.collect()],
        };
        let rest = channel.at_rest().unwrap();
        assert!((rest.step - step).abs() < 1e-9, "{rest:?}");
        // Rounding adds step² / 12.
        let noise = (0.03_f64.powi(2) + step * step / 12.0).sqrt();
        assert!((rest.noise / noise - 1.0).abs() < 0.04, "{rest:?}");
        assert!((rest.bias.value - 0.031).abs() < 4.0 * rest.bias.sigma);
        // A bias that does not walk: less than what the noise of 5 s hides.
        assert!(rest.walk_per_sqrt_s.unwrap() < 0.002, "{rest:?}");
    }

    #[test]
    fn the_finer_units_of_a_link_do_not_hide_the_step_of_a_gyro() {
        let mut random = Pcg64::seed_from_u64(9);
        // A degree per second, in units of 0.02 mrad/s.
        let step = 873.0 * 2e-5;
        let readings: Vec<f64> = (0..1_000)
            .map(|_| {
                let counts = (random.random::<f64>() * 5.0).floor();
                let smear = (random.random::<f64>() * 3.0).floor() - 1.0;
                counts * step + smear * 2e-5
            })
            .collect();
        let found = step_of(&readings);
        assert!((found / step - 1.0).abs() < 0.01, "{found}");
        // Two values alone may be two biases: then the unit of the link is all that is known.
        let two: Vec<f64> = readings
            .iter()
            .copied()
            .filter(|reading| *reading < 1.5 * step)
            .collect();
        assert!((step_of(&two) - 2e-5).abs() < 1e-9, "{}", step_of(&two));
        // What is fine all over has no step.
        let fine: Vec<f64> = (0..500).map(|_| random.random::<f64>()).collect();
        assert_eq!(step_of(&fine), 0.0);
        assert_eq!(step_of(&[0.5; 30]), 0.0);
    }

    #[test]
    fn a_walking_bias_is_told_from_noise() {
        let mut random = Pcg64::seed_from_u64(5);
        let mut draw = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let (walk, dt_s) = (0.004, 0.05_f64);
        let mut bias = 0.0;
        let readings = (0..40_000).map(|i| {
            bias += walk * dt_s.sqrt() * draw();
            (f64::from(i) * dt_s, bias + 0.01 * draw())
        });
        let channel = RestingChannel {
            stretches: vec![readings.collect()],
        };
        let found = channel.at_rest().unwrap().walk_per_sqrt_s.unwrap();
        assert!((found / walk - 1.0).abs() < 0.1, "{found}");
    }

    #[test]
    fn too_little_rest_is_said() {
        let found = RestingChannel::default().at_rest();
        assert!(matches!(
            found,
            Err(CalibrationError::TooLittle { found: 0, .. })
        ));
    }
}

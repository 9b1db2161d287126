//! The noise of a sensor with no configured noise, from how its samples scatter about their neighbours.
//!
//! ```text
//! d_k = y_(k+1) - 2 y_k + y_(k-1)      sigma = median |d_k| / (0.6745 sqrt(6)), at least q / sqrt(12)                   (16)
//! ```
//! A second difference is blind to slopes, and the median to the few samples in which the step itself bends. q is the smallest
//! difference of two neighbours that differ: what a sensor that rounds cannot do without.
//!
//! # Assumptions
//! Errors of neighbours are independent. Where they are not, the residuals of the fit have the last word
//! ([`super::parameter_uncertainty`]).
//!
//! # Sources
//! The 75 % quantile of a Gaussian, and the variance 6 sigma^2 of the weights 1, -2, 1; docs/lab/calibration.md, section 7.

use super::{TimedSample, sorted_finite};

/// The 75 % quantile of a standard normal: half of all draws are nearer to zero.
const MEDIAN_OF_NORMAL: f64 = 0.674_49;
/// Fewer samples than these say nothing.
const MIN_SAMPLES: usize = 8;

/// Equation (16), in the sensor's unit; `None` for too few samples, or for samples that are all the same.
pub fn estimate_noise(samples: &[TimedSample]) -> Option<f64> {
    let samples = sorted_finite(samples);
    if samples.len() < MIN_SAMPLES {
        return None;
    }
    let quantum = samples
        .windows(2)
        .filter_map(|pair| match pair {
            [a, b] => Some((b.value - a.value).abs()),
            _ => None,
        })
        .filter(|difference| *difference > 0.0)
        .fold(f64::INFINITY, f64::min);
    if quantum.is_infinite() {
        return None;
    }
    let mut bends: Vec<f64> = samples
        .windows(3)
        .filter_map(|three| match three {
            [a, b, c] => Some((c.value - 2.0 * b.value + a.value).abs()),
            _ => None,
        })
        .collect();
    bends.sort_by(f64::total_cmp);
    let median = bends.get(bends.len() / 2)?;
    let scatter = median / (MEDIAN_OF_NORMAL * 6.0_f64.sqrt());
    Some(scatter.max(quantum / 12.0_f64.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::super::simulated::{SimulatedSensor, step_input};
    use super::*;

    #[test]
    fn it_is_found_in_spite_of_the_step() {
        let sensor = SimulatedSensor::first_order(5.0, 0.1, 0.1);
        let found = estimate_noise(&sensor.run(1, 800, step_input(20.0, 4.0, 10.0))).unwrap();
        // A median of 800 is known to 4 %.
        assert!((found / 0.1 - 1.0).abs() < 0.12, "{found}");
    }

    #[test]
    fn a_sensor_that_rounds_has_its_last_digit_over_the_root_of_twelve_at_least() {
        let mut sensor = SimulatedSensor::first_order(5.0, 1e-6, 0.5);
        sensor.resolution = 0.0625;
        let found = estimate_noise(&sensor.run(1, 800, step_input(20.0, 4.0, 10.0))).unwrap();
        assert!((found - 0.0625 / 12.0_f64.sqrt()).abs() < 1e-9, "{found}");
    }

    #[test]
    fn samples_that_say_nothing_say_nothing() {
        let still = |count: u32| -> Vec<TimedSample> {
            (0..count).map(|k| TimedSample { at_s: f64::from(k), value: 3.0 }).collect()
        };
        assert_eq!(estimate_noise(&still(100)), None);
        let mut few = still(7);
        few[3].value = 4.0;
        assert_eq!(estimate_noise(&few), None);
    }
}

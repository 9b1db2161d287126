//! What the readings of a step tell: their noise, their largest descent, and which values are known well enough to be reported.

use posebridge_telemetry::UncertainValue;

use super::step_error::{Guess, UndeterminedReason};
use crate::statistics::median;

/// A value whose sigma is a larger share of it is a guess.
pub(super) const LARGEST_SHARE: f64 = 0.25;
pub(super) struct Evidence {
    /// v_ss, t90, d and m.
    pub(super) known: [UncertainValue; 4],
    pub(super) log_rate_sigma: f64,
    /// From the onset to the last reading.
    pub(super) driven_s: f64,
    pub(super) begins_on_the_way: bool,
    pub(super) rate_per_s: f64,
    pub(super) period_s: f64,
    pub(super) last_m_per_s: f64,
    pub(super) noise_m: f64,
}

/// Why d or m is a guess; `None` if both are known.
pub(super) fn undetermined(evidence: &Evidence) -> Option<UndeterminedReason> {
    let [steady, _, drag, mass] = evidence.known;
    let is_sure = |known: UncertainValue| known.sigma <= LARGEST_SHARE * known.value;
    let time_constants = evidence.rate_per_s * evidence.driven_s;
    if !is_sure(drag) {
        let guess = Guess { name: "v_ss", value: steady };
        // At two time constants a car has 86 % of its speed.
        return Some(if time_constants < 2.0 {
            UndeterminedReason::StillSpeedingUp { last_m_per_s: evidence.last_m_per_s, guess }
        } else {
            UndeterminedReason::TooNoisy { noise_m: evidence.noise_m, guess }
        });
    }
    if is_sure(mass) && evidence.log_rate_sigma <= LARGEST_SHARE {
        return None;
    }
    let guess = Guess { name: "m", value: mass };
    Some(if evidence.begins_on_the_way {
        UndeterminedReason::BeginsOnTheWay { guess }
    } else if evidence.rate_per_s * evidence.period_s > 0.7 {
        UndeterminedReason::RisesBetweenReadings { period_s: evidence.period_s, guess }
    } else {
        UndeterminedReason::TooNoisy { noise_m: evidence.noise_m, guess }
    })
}

/// The middle one of each reading and its neighbours.
pub(super) fn medians_of_three(readings: &[(f64, f64)]) -> Vec<f64> {
    let middle = |index: usize| {
        let (low, high) = (index.saturating_sub(1), (index + 1).min(readings.len() - 1));
        let mut three = [readings[low].1, readings[index].1, readings[high].1];
        three.sort_by(f64::total_cmp);
        three[1]
    };
    (0..readings.len()).map(middle).collect()
}

/// The two places between which the values fall most.
pub(super) fn largest_descent(values: &[f64]) -> (usize, usize) {
    let (mut highest, mut best) = (0, (0, 0));
    for (index, value) in values.iter().enumerate() {
        if *value > values[highest] {
            highest = index;
        }
        if values[highest] - value > values[best.0] - values[best.1] {
            best = (highest, index);
        }
    }
    best
}

/// Sigma of a reading from third differences, m: z_k-2/2 - 3/2 z_k-1 + 3/2 z_k - z_k+1/2 has sqrt 5 of it.
pub(super) fn noise(readings: &[(f64, f64)]) -> f64 {
    /// Median of the absolute value of a standard normal number.
    const MEDIAN: f64 = 0.6745;
    let differences =
        readings.windows(4).map(|four| (0.5 * four[0].1 - 1.5 * four[1].1 + 1.5 * four[2].1 - 0.5 * four[3].1).abs());
    median(differences).map_or(0.0, |middle| middle / (MEDIAN * 5.0_f64.sqrt()))
}

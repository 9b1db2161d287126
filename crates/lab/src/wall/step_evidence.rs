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
    pub(super) begins_on_the_way: bool,
    /// The readings do not exclude a car that is far from its steady speed at the last one.
    pub(super) may_still_speed_up: bool,
    /// The rise is shorter than the interval of two readings.
    pub(super) rises_between_readings: bool,
    pub(super) period_s: f64,
    pub(super) last_m_per_s: f64,
    pub(super) noise_m: f64,
}

/// Why d or m is a guess; `None` if both are known.
pub(super) fn undetermined(evidence: &Evidence) -> Option<UndeterminedReason> {
    let [steady, rise, drag, mass] = evidence.known;
    let is_sure = |known: UncertainValue| known.sigma <= LARGEST_SHARE * known.value;
    if !is_sure(drag) {
        let guess = Guess { name: "v_ss", value: steady };
        return Some(if evidence.may_still_speed_up {
            UndeterminedReason::NoSteadySpeed { last_m_per_s: evidence.last_m_per_s, guess }
        } else {
            UndeterminedReason::TooNoisy { noise_m: evidence.noise_m, guess }
        });
    }
    if is_sure(mass) && evidence.log_rate_sigma <= LARGEST_SHARE {
        return None;
    }
    let guess = if is_sure(mass) { Guess { name: "t90", value: rise } } else { Guess { name: "m", value: mass } };
    Some(if evidence.begins_on_the_way {
        UndeterminedReason::BeginsOnTheWay { guess }
    } else if evidence.rises_between_readings {
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

/// Sigma of a reading from third divided differences, m: these do not see a constant acceleration, at whatever intervals it is read.
pub(super) fn noise(readings: &[(f64, f64)]) -> f64 {
    /// Median of the absolute value of a standard normal number.
    const MEDIAN: f64 = 0.6745;
    // A coarse clock gives several readings one stamp: the first of them.
    let mut distinct = readings.to_vec();
    distinct.dedup_by_key(|(at_s, _)| *at_s);
    let differences = distinct.windows(4).filter_map(|four| {
        let (mut difference, mut squares) = (0.0, 0.0);
        for (index, (at_s, range_m)) in four.iter().enumerate() {
            let others = four.iter().enumerate().filter(|(other, _)| *other != index);
            let weight = 1.0 / others.map(|(_, (other_s, _))| at_s - other_s).product::<f64>();
            difference += weight * range_m;
            squares += weight * weight;
        }
        Some((difference / squares.sqrt()).abs()).filter(|value| value.is_finite())
    });
    median(differences).map_or(0.0, |middle| middle / MEDIAN)
}

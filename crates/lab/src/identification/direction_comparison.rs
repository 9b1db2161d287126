//! Steps up against steps down: heat goes into a body through another film than out of it.
//!
//! ```text
//! m = sum of x_i / s_i^2 / sum of 1 / s_i^2        s = 1 / sqrt(sum of 1 / s_i^2), times the larger one of 1 and the scatter
//! scatter^2 = sum of ((x_i - m) / s_i)^2 / (n - 1)        z = (m_up - m_down) / sqrt(s_up^2 + s_down^2)
//! ```
//!
//! # Sources
//! The weighted mean with Birge's ratio (1932), as for physical constants; docs/lab/calibration.md, section 7.

use posebridge_telemetry::UncertainValue;

use super::prior::StepDirection;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionComparison {
    pub up: UncertainValue,
    pub down: UncertainValue,
    /// z of the module's formula.
    pub z: f64,
}

impl DirectionComparison {
    /// Whether they differ, at a level of 1 %.
    pub fn differ(&self) -> bool {
        self.z.abs() > TWO_SIDED_SIGMAS
    }
}

/// 99.5 % quantile of the normal distribution.
const TWO_SIDED_SIGMAS: f64 = 2.575_829;

/// Compares one parameter of several steps; `None` unless there are steps in both directions, each with a positive sigma.
pub fn compare_directions(steps: &[(StepDirection, UncertainValue)]) -> Option<DirectionComparison> {
    let of = |direction: StepDirection| {
        let own = steps.iter().filter(|(which, _)| *which == direction);
        mean(&own.map(|(_, known)| *known).collect::<Vec<_>>())
    };
    let (up, down) = (of(StepDirection::Up)?, of(StepDirection::Down)?);
    Some(DirectionComparison { z: (up.value - down.value) / up.sigma.hypot(down.sigma), up, down })
}

fn mean(all: &[UncertainValue]) -> Option<UncertainValue> {
    let weights: f64 = all.iter().map(|known| known.sigma.powi(-2)).sum();
    let sum: f64 = all.iter().map(|known| known.value * known.sigma.powi(-2)).sum();
    let value = sum / weights;
    let off = all.iter().map(|known| ((known.value - value) / known.sigma).powi(2));
    let scatter = off.sum::<f64>() / (all.len().max(2) - 1) as f64;
    let sigma = weights.sqrt().recip() * scatter.max(1.0).sqrt();
    (value.is_finite() && sigma > 0.0 && sigma.is_finite()).then_some(UncertainValue { value, sigma })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(value: f64, sigma: f64) -> UncertainValue {
        UncertainValue { value, sigma }
    }

    #[test]
    fn ways_that_differ_are_told_apart_and_others_are_not() {
        let found = compare_directions(&[
            (StepDirection::Up, known(2.0, 0.1)),
            (StepDirection::Down, known(2.5, 0.1)),
            (StepDirection::Up, known(2.1, 0.1)),
        ])
        .unwrap();
        assert!((found.up.value - 2.05).abs() < 1e-12);
        assert!((found.up.sigma - 0.1 / 2.0_f64.sqrt()).abs() < 1e-12);
        assert!((found.z + 0.45 / 0.015_f64.sqrt()).abs() < 1e-9);
        assert!(found.differ());
        let alike = compare_directions(&[(StepDirection::Up, known(2.0, 0.1)), (StepDirection::Down, known(2.2, 0.1))]);
        assert!(!alike.unwrap().differ());
    }

    #[test]
    fn runs_that_scatter_make_their_mean_as_uncertain() {
        let up = [(StepDirection::Up, known(1.0, 0.1)), (StepDirection::Up, known(3.0, 0.1))];
        let found = compare_directions(&[&up[..], &[(StepDirection::Down, known(2.5, 0.1))]].concat()).unwrap();
        assert!((found.up.value - 2.0).abs() < 1e-12);
        // Off by ten sigma each: 0.1 / sqrt(2) times sqrt(200).
        assert!((found.up.sigma - 1.0).abs() < 1e-9, "{found:?}");
        assert!(!found.differ());
    }

    #[test]
    fn one_way_alone_or_a_sigma_of_zero_is_no_comparison() {
        assert_eq!(compare_directions(&[(StepDirection::Up, known(1.0, 0.1))]), None);
        assert_eq!(compare_directions(&[]), None);
        let exact = [(StepDirection::Up, known(1.0, 0.0)), (StepDirection::Down, known(1.0, 0.1))];
        assert_eq!(compare_directions(&exact), None);
    }
}

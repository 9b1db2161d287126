//! Filling in a record: what the sequential scalar updates of one observation come to together.

use posebridge_telemetry::{FusionRecord, Verdict};

use super::{StartPose, intake};
use crate::update::{ScalarOutcome, Usage};

/// Enters one more innovation with its S; beyond three there is no room.
///
/// Each is taken after the ones before it have been used, so they are independent: their NIS and log-likelihoods add up.
pub(super) fn add_innovation(record: &mut FusionRecord, innovation: f64, outcome: &ScalarOutcome) {
    let i = usize::from(record.degrees_of_freedom);
    if outcome.usage == Usage::Indefinite || i >= record.innovation.len() {
        return;
    }
    record.innovation[i] = innovation;
    record.innovation_covariance[i][i] = outcome.innovation_variance;
    record.nis += outcome.nis;
    record.degrees_of_freedom += 1;
    record.log_likelihood -=
        0.5 * (outcome.nis + (std::f64::consts::TAU * outcome.innovation_variance).ln());
}

/// What a filter of one quantity says to a pose: it has none to set.
pub(super) fn verdict_without_pose(start: &StartPose) -> Verdict {
    if intake::is_usable(start) {
        Verdict::Unused
    } else {
        Verdict::Malformed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Celsius, Observation, Observed, SensorId, Span, Stamp};

    #[test]
    fn two_innovations_in_a_row_are_as_likely_as_both_at_once() {
        let observation = Observation {
            sensor: SensorId::THERMOMETER,
            stamp: Stamp::ZERO,
            stamp_sigma: Span::ZERO,
            observed: Observed::Temperature(Celsius(1.0)),
        };
        let mut record = intake::bare_record(&observation, Span::ZERO, Verdict::Accepted);
        for (innovation, s) in [(0.5_f64, 4.0), (-2.0, 1.0)] {
            let outcome = ScalarOutcome {
                innovation_variance: s,
                nis: innovation * innovation / s,
                usage: Usage::Used,
            };
            add_innovation(&mut record, innovation, &outcome);
        }
        let s = nalgebra::Matrix2::new(4.0, 0.0, 0.0, 1.0);
        let together = crate::update::consistency(&nalgebra::Vector2::new(0.5, -2.0), &s).unwrap();
        assert!((record.nis - together.0).abs() < 1e-12);
        assert!((record.log_likelihood - together.1).abs() < 1e-12);
        assert_eq!(record.degrees_of_freedom, 2);
    }
}

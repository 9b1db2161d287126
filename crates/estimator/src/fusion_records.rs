//! Filling in a record: an innovation at once, or what the sequential scalar updates of one observation come to together.

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{FusionOutcome, FusionRecord};

use crate::filter::StartPose;
use crate::update::{ScalarOutcome, UpdateOutcome, nis_and_log_likelihood};
use crate::validation;

/// Writes an innovation with its covariance into a record; `false`, and nothing written, when the covariance is none.
pub(crate) fn write_innovation<const M: usize>(
    record: &mut FusionRecord,
    innovation: &SVector<f64, M>,
    s: &SMatrix<f64, M, M>,
) -> bool {
    let Some((nis, log_likelihood)) = nis_and_log_likelihood(innovation, s) else {
        return false;
    };
    for row in 0..M {
        record.innovation[row] = innovation[row];
        for column in 0..M {
            record.innovation_covariance[row][column] = s[(row, column)];
        }
    }
    record.nis = nis;
    record.degrees_of_freedom = M as u8;
    record.log_likelihood = log_likelihood;
    true
}

/// Enters one more innovation with its S; beyond three there is no room.
///
/// Each is taken after the ones before it have been used, so they are independent: their NIS and log-likelihoods add up.
pub(crate) fn add_innovation(record: &mut FusionRecord, innovation: f64, outcome: &ScalarOutcome) {
    let i = usize::from(record.degrees_of_freedom);
    if outcome.outcome == UpdateOutcome::Indefinite || i >= record.innovation.len() {
        return;
    }
    record.innovation[i] = innovation;
    record.innovation_covariance[i][i] = outcome.innovation_variance;
    record.nis += outcome.nis;
    record.degrees_of_freedom += 1;
    record.log_likelihood -= 0.5 * (outcome.nis + (std::f64::consts::TAU * outcome.innovation_variance).ln());
}

/// What a filter of one quantity says to a pose: it has none to set.
pub(crate) fn outcome_without_pose(start: &StartPose) -> FusionOutcome {
    if validation::is_valid_start(start) { FusionOutcome::Unused } else { FusionOutcome::Malformed }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{Celsius, Observation, ObservationKind, SensorId, TimeDelta, Timestamp};

    #[test]
    fn two_innovations_in_a_row_are_as_likely_as_both_at_once() {
        let observation = Observation {
            sensor: SensorId::THERMOMETER,
            stamp: Timestamp::ZERO,
            stamp_sigma: TimeDelta::ZERO,
            measurement: ObservationKind::Temperature(Celsius(1.0)),
        };
        let mut record = validation::record_without_prediction(&observation, TimeDelta::ZERO, FusionOutcome::Accepted);
        for (innovation, s) in [(0.5_f64, 4.0), (-2.0, 1.0)] {
            let outcome = ScalarOutcome {
                innovation_variance: s,
                nis: innovation * innovation / s,
                outcome: UpdateOutcome::Used,
            };
            add_innovation(&mut record, innovation, &outcome);
        }
        let s = nalgebra::Matrix2::new(4.0, 0.0, 0.0, 1.0);
        let together = nis_and_log_likelihood(&nalgebra::Vector2::new(0.5, -2.0), &s).unwrap();
        assert!((record.nis - together.0).abs() < 1e-12);
        assert!((record.log_likelihood - together.1).abs() < 1e-12);
        assert_eq!(record.degrees_of_freedom, 2);
    }
}

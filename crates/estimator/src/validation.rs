//! Validation of observations, independent of a filter's state, and common parts of fusion records.

use std::cmp::Reverse;

use nalgebra::{SMatrix, SVector};
use posebridge_telemetry::{
    BrickClock, Fix, FusionOutcome, FusionRecord, Observation, ObservationKind, StartPose, TimeDelta, Timestamp,
};

use crate::motion::{InsertOutcome, MotionReading};
use crate::update::{ScalarOutcome, UpdateOutcome, nis_and_log_likelihood};

/// A stamp further ahead is damaged.
pub(crate) const MAX_AHEAD: TimeDelta = TimeDelta::from_millis(3_600_000);
/// Larger numbers are damage: no arena, wheel or rate comes near, and their squares must stay finite.
const MAX_MAGNITUDE: f64 = 1e9;
/// Smaller variances are damage, a nanometre or a nanoradian squared: they would divide by almost zero.
const MIN_VARIANCE: f64 = 1e-18;
/// A tag further from mid-axle is not on the robot, m.
const MAX_LEVER_M: f64 = 1e3;

/// Sigma of the position after a restart of the brick's clock, in which the robot may have been carried, m.
pub(crate) const RESTART_POSITION_SIGMA_M: f64 = 0.1;
/// The same for its heading, rad.
pub(crate) const RESTART_HEADING_SIGMA_RAD: f64 = 0.3;

/// Why an observation is rejected whatever the state, with the latest stamp so far.
fn reject_invalid(
    observation: &Observation,
    latest: Option<Timestamp<BrickClock>>,
    history_s: f64,
) -> Option<FusionOutcome> {
    if !is_finite(&observation.measurement) || observation.stamp_sigma < TimeDelta::ZERO {
        return Some(FusionOutcome::Malformed);
    }
    let latest = latest?;
    if observation.stamp - latest > MAX_AHEAD {
        return Some(FusionOutcome::Malformed);
    }
    let horizon = latest - TimeDelta::from_secs_f64(history_s);
    (observation.stamp < horizon).then_some(FusionOutcome::TooOld)
}

/// The valid observations of a run in time order; at one instant the better source of motion comes first, so that the
/// result does not depend on the order of arrival.
pub(crate) fn valid_in_time_order(observations: &[Observation]) -> Vec<&Observation> {
    let mut latest = None;
    let mut sound = Vec::with_capacity(observations.len());
    for observation in observations {
        if reject_invalid(observation, latest, f64::INFINITY).is_none() {
            latest = latest.max(Some(observation.stamp));
            sound.push(observation);
        }
    }
    sound.sort_by_key(|observation| {
        let source = MotionReading::from_observation(&observation.measurement).map(|reading| reading.source());
        (observation.stamp, Reverse(source), observation.sensor)
    });
    sound
}

/// Rejects a reading that repeats the timestamp of the previous one of its kind, or is older.
pub(crate) fn reject_repeated(
    before: Option<Timestamp<BrickClock>>,
    stamp: Timestamp<BrickClock>,
) -> Option<FusionOutcome> {
    let before = before?;
    if stamp == before {
        return Some(FusionOutcome::Malformed);
    }
    (stamp < before).then_some(FusionOutcome::TooOld)
}

/// Whether all numbers are finite and no sigma is negative.
pub(crate) fn is_valid_start(start: &StartPose) -> bool {
    let sigmas = [start.position_sigma_m, start.heading_sigma_rad];
    are_within_limits(&[start.pose.x.0, start.pose.y.0, start.pose.heading.rad()])
        && are_within_limits(&sigmas)
        && sigmas.iter().all(|sigma| *sigma >= 0.0)
}

fn are_within_limits(values: &[f64]) -> bool {
    values.iter().all(|value| value.abs() <= MAX_MAGNITUDE)
}

/// Whether the numbers of an observation are such that a filter may use it.
pub(crate) fn is_finite(observed: &ObservationKind) -> bool {
    match *observed {
        ObservationKind::WheelAngles { left, right } => are_within_limits(&[left.0, right.0]),
        ObservationKind::OdometerPose(pose) => are_within_limits(&[pose.x.0, pose.y.0, pose.heading.rad()]),
        ObservationKind::BodyVelocity { forward, turn } => are_within_limits(&[forward.0, turn.0]),
        ObservationKind::TurnRate(rate) => are_within_limits(&[rate.0]),
        ObservationKind::WheelAccelerations { left, right } => are_within_limits(&[left.0, right.0]),
        ObservationKind::Fix(fix) => is_finite_fix(&fix),
        ObservationKind::Landmark { range, bearing, .. } => are_within_limits(&[range.0, bearing.0]) && range.0 >= 0.0,
        ObservationKind::BeaconRange { range, .. } | ObservationKind::WallRange(range) => {
            are_within_limits(&[range.0]) && range.0 >= 0.0
        }
        ObservationKind::CompassHeading(heading) => are_within_limits(&[heading.rad()]),
        ObservationKind::Temperature(temperature) => are_within_limits(&[temperature.0]),
    }
}

fn is_finite_fix(fix: &Fix) -> bool {
    let heading_rad = fix.heading.map_or(0.0, posebridge_telemetry::Heading::rad);
    let lever = [fix.tag_in_body.x.0, fix.tag_in_body.y.0];
    let covariance = fix.covariance.is_none_or(|own| {
        let determinant = own.xx_m2 * own.yy_m2 - own.xy_m2 * own.xy_m2;
        let is_heading_unknown = own.heading_rad2 == f64::INFINITY;
        are_within_limits(&[own.xx_m2, own.xy_m2, own.yy_m2])
            && own.xx_m2 >= MIN_VARIANCE
            && own.yy_m2 >= MIN_VARIANCE
            && determinant > 0.0
            && (is_heading_unknown || (MIN_VARIANCE..=MAX_MAGNITUDE).contains(&own.heading_rad2))
    });
    are_within_limits(&[fix.position.x.0, fix.position.y.0, heading_rad])
        && lever.iter().all(|value| value.abs() <= MAX_LEVER_M)
        && covariance
}

/// Applies a valid observation to a record with the outcome `Unused`, and returns it.
pub(crate) fn observe_if_valid(
    observation: &Observation,
    latest: Option<Timestamp<BrickClock>>,
    history_s: f64,
    apply: impl FnOnce(&mut FusionRecord),
) -> FusionRecord {
    let Observation { sensor, stamp, .. } = *observation;
    let mut record = FusionRecord::new(sensor, observation.measurement.kind(), stamp, FusionOutcome::Unused);
    record.lag = latest.map_or(TimeDelta::ZERO, |latest| (latest - stamp).max(TimeDelta::ZERO));
    match reject_invalid(observation, latest, history_s) {
        Some(rejected) => record.outcome = rejected,
        None => apply(&mut record),
    }
    record
}

pub(crate) const fn fusion_outcome(added: InsertOutcome) -> FusionOutcome {
    match added {
        InsertOutcome::Inserted(_) => FusionOutcome::Accepted,
        InsertOutcome::Rebased(_) => FusionOutcome::Rebased,
        InsertOutcome::Superseded => FusionOutcome::Unused,
        InsertOutcome::Duplicate => FusionOutcome::Malformed,
        InsertOutcome::TooOld => FusionOutcome::TooOld,
    }
}

// Filling in a record: an innovation at once, or what the sequential scalar updates of one observation come to together.

/// Writes an innovation with its covariance into a record; `false`, and nothing written, when the covariance is not
/// positive definite.
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

/// Adds one more innovation with its S; at most three fit. Each is computed after those before it have been used, so
/// they are independent: their NIS and log-likelihoods add up.
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

#[cfg(test)]
mod tests {
    use posebridge_telemetry::SensorId;

    use super::*;

    #[test]
    fn two_innovations_in_a_row_are_as_likely_as_both_at_once() {
        let mut record = FusionRecord::new(SensorId::THERMOMETER, "", Timestamp::ZERO, FusionOutcome::Accepted);
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

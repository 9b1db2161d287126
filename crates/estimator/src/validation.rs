//! What every filter asks of an observation before it looks at its own state: whether its values are numbers, whether its time is
//! current, and whether it observes motion.

use std::cmp::Reverse;

use posebridge_telemetry::{
    Arena, BrickClock, Fix, FusionOutcome, FusionRecord, Observation, ObservationKind, Pose, PoseCorrection, Radians,
    SensorId, TimeDelta, Timestamp, quantities::wrap_rad,
};

use crate::filter::StartPose;
use crate::motion::{InsertOutcome, MotionReading};

/// A stamp further ahead than this is damage, not the future.
const MAX_AHEAD: TimeDelta = TimeDelta::from_millis(3_600_000);
/// Larger numbers than this are damage: no arena, wheel or rate of ours comes near, and their squares must stay finite.
const MAX_MAGNITUDE: f64 = 1e9;
/// No sensor is better than a nanometre or a nanoradian: a smaller claim is damage, and would divide by next to nothing.
const MIN_VARIANCE: f64 = 1e-18;
/// A tag further from mid-axle than this is not on the robot, m.
const MAX_LEVER_M: f64 = 1e3;

/// After the brick's clock restarted the robot may have been carried: sigma of its position, m.
pub(crate) const RESTART_POSITION_SIGMA_M: f64 = 0.1;
/// The same for its heading, rad.
pub(crate) const RESTART_HEADING_SIGMA_RAD: f64 = 0.3;

/// Why an observation cannot be used whatever the state, if so. `latest` is the latest instant that was observed.
pub(crate) fn reject_invalid(
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

/// The observations of a whole run whose numbers can be borne, in the order of time; of one instant the better source of motion
/// comes first, so that the estimate does not depend on the order of arrival.
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

/// Why a reading cannot follow the one before it, if so: readings of one kind are used in their order and once, and the interval
/// between two of them must be more than zero.
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

/// How far an observation is behind the latest one.
pub(crate) fn lag_of(observation: &Observation, latest: Option<Timestamp<BrickClock>>) -> TimeDelta {
    latest.map_or(TimeDelta::ZERO, |latest| (latest - observation.stamp).max(TimeDelta::ZERO))
}

/// The change from one pose to another.
pub(crate) fn correction_between(before: Pose<Arena>, after: Pose<Arena>) -> PoseCorrection {
    PoseCorrection {
        dx_m: after.x.0 - before.x.0,
        dy_m: after.y.0 - before.y.0,
        turn: Radians(wrap_rad(after.heading.rad() - before.heading.rad())),
    }
}

/// Whether a robot can be put there: finite, and no negative standard deviation.
pub(crate) fn is_valid_start(start: &StartPose) -> bool {
    let sigmas = [start.position_sigma_m, start.heading_sigma_rad];
    are_within_limits(&[start.pose.x.0, start.pose.y.0, start.pose.heading.rad()])
        && are_within_limits(&sigmas)
        && sigmas.iter().all(|sigma| *sigma >= 0.0)
}

fn are_within_limits(values: &[f64]) -> bool {
    values.iter().all(|value| value.abs() <= MAX_MAGNITUDE)
}

/// Whether every number of an observation is one that arithmetic can bear.
fn is_finite(observed: &ObservationKind) -> bool {
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

/// A record of an observation for which nothing was predicted.
pub(crate) fn record_without_prediction(
    observation: &Observation,
    lag: TimeDelta,
    verdict: FusionOutcome,
) -> FusionRecord {
    FusionRecord {
        kind: observation.measurement.kind(),
        lag,
        outcome: verdict,
        ..blank_record(observation.sensor, observation.stamp)
    }
}

/// A record of no kind, for an input that is not reported.
pub(crate) const fn blank_record(sensor: SensorId, stamp: Timestamp<BrickClock>) -> FusionRecord {
    FusionRecord {
        sensor,
        kind: "",
        stamp,
        lag: TimeDelta::ZERO,
        outcome: FusionOutcome::Accepted,
        innovation: [0.0; 3],
        innovation_covariance: [[0.0; 3]; 3],
        nis: 0.0,
        degrees_of_freedom: 0,
        log_likelihood: 0.0,
    }
}

/// The verdict on a reading that a track did or did not take.
pub(crate) const fn fusion_outcome(added: InsertOutcome) -> FusionOutcome {
    match added {
        InsertOutcome::Inserted(_) => FusionOutcome::Accepted,
        InsertOutcome::Rebased(_) => FusionOutcome::Rebased,
        InsertOutcome::Superseded => FusionOutcome::Unused,
        InsertOutcome::Duplicate => FusionOutcome::Malformed,
        InsertOutcome::TooOld => FusionOutcome::TooOld,
    }
}

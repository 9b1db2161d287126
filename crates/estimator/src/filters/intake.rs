//! What every filter asks of an observation before it looks at its own state: are these numbers, is it of this time, does it
//! tell of motion.

use std::cmp::Reverse;

use posebridge_telemetry::{
    Arena, BrickClock, Fix, FusionRecord, Observation, Observed, Pose, PoseJump, Radians, SensorId, Span, Stamp,
    Verdict, quantities::wrap_rad,
};

use super::StartPose;
use crate::motion::{Added, MotionReading};

/// A stamp further ahead than this is damage, not the future.
const FURTHEST_AHEAD: Span = Span::from_millis(3_600_000);
/// Larger numbers than this are damage: no arena, wheel or rate of ours comes near, and their squares must stay finite.
const LARGEST: f64 = 1e9;
/// Nobody measures better than a nanometre or a nanoradian: a smaller claim is damage, and would divide by next to nothing.
const SMALLEST_VARIANCE: f64 = 1e-18;
/// A tag further from mid-axle than this is not on the robot, m.
const LONGEST_LEVER_M: f64 = 1e3;

/// After the brick's clock restarted the robot may have been carried: sigma of its position, m.
pub(super) const RESTART_POSITION_M: f64 = 0.1;
/// The same for its heading, rad.
pub(super) const RESTART_HEADING_RAD: f64 = 0.3;

/// Why an observation cannot be used whatever the state, if so. `latest` is the latest instant that was observed.
pub(crate) fn refuse_outright(
    observation: &Observation,
    latest: Option<Stamp<BrickClock>>,
    history_s: f64,
) -> Option<Verdict> {
    if !is_finite(&observation.observed) || observation.stamp_sigma < Span::ZERO {
        return Some(Verdict::Malformed);
    }
    let latest = latest?;
    if observation.stamp - latest > FURTHEST_AHEAD {
        return Some(Verdict::Malformed);
    }
    let horizon = latest - Span::from_secs_f64(history_s);
    (observation.stamp < horizon).then_some(Verdict::TooOld)
}

/// The observations of a whole run whose numbers can be borne, in the order of time; of one instant the better source of motion
/// comes first, so that what can be told of it does not depend on the order of arrival.
pub(crate) fn sound_in_time(observations: &[Observation]) -> Vec<&Observation> {
    let mut latest = None;
    let mut sound = Vec::with_capacity(observations.len());
    for observation in observations {
        if refuse_outright(observation, latest, f64::INFINITY).is_none() {
            latest = latest.max(Some(observation.stamp));
            sound.push(observation);
        }
    }
    sound.sort_by_key(|observation| {
        let source = MotionReading::of(&observation.observed).map(|reading| reading.source());
        (observation.stamp, Reverse(source), observation.sensor)
    });
    sound
}

/// Why a reading cannot follow the one before it, if so: readings of one kind are used in their order and once, and the interval
/// between two of them must be more than zero.
pub(super) fn refuse_repeated(before: Option<Stamp<BrickClock>>, stamp: Stamp<BrickClock>) -> Option<Verdict> {
    let before = before?;
    if stamp == before {
        return Some(Verdict::Malformed);
    }
    (stamp < before).then_some(Verdict::TooOld)
}

/// How far an observation is behind the latest one.
pub(super) fn lag_of(observation: &Observation, latest: Option<Stamp<BrickClock>>) -> Span {
    latest.map_or(Span::ZERO, |latest| (latest - observation.stamp).max(Span::ZERO))
}

/// The change from one pose to another.
pub(super) fn jump_between(before: Pose<Arena>, after: Pose<Arena>) -> PoseJump {
    PoseJump {
        dx_m: after.x.0 - before.x.0,
        dy_m: after.y.0 - before.y.0,
        turn: Radians(wrap_rad(after.heading.rad() - before.heading.rad())),
    }
}

/// Whether a robot can be put there: finite, and no negative standard deviation.
pub(crate) fn is_usable(start: &StartPose) -> bool {
    let sigmas = [start.position_sigma_m, start.heading_sigma_rad];
    bearable(&[start.pose.x.0, start.pose.y.0, start.pose.heading.rad()])
        && bearable(&sigmas)
        && sigmas.iter().all(|sigma| *sigma >= 0.0)
}

fn bearable(values: &[f64]) -> bool {
    values.iter().all(|value| value.abs() <= LARGEST)
}

/// Whether every number of an observation is one that arithmetic can bear.
fn is_finite(observed: &Observed) -> bool {
    match *observed {
        Observed::WheelAngles { left, right } => bearable(&[left.0, right.0]),
        Observed::OdometerPose(pose) => bearable(&[pose.x.0, pose.y.0, pose.heading.rad()]),
        Observed::BodyVelocity { forward, turn } => bearable(&[forward.0, turn.0]),
        Observed::TurnRate(rate) => bearable(&[rate.0]),
        Observed::WheelAccelerations { left, right } => bearable(&[left.0, right.0]),
        Observed::Fix(fix) => is_finite_fix(&fix),
        Observed::Landmark { range, bearing, .. } => bearable(&[range.0, bearing.0]) && range.0 >= 0.0,
        Observed::BeaconRange { range, .. } | Observed::WallRange(range) => bearable(&[range.0]) && range.0 >= 0.0,
        Observed::CompassHeading(heading) => bearable(&[heading.rad()]),
        Observed::Temperature(temperature) => bearable(&[temperature.0]),
    }
}

fn is_finite_fix(fix: &Fix) -> bool {
    let heading_rad = fix.heading.map_or(0.0, posebridge_telemetry::Heading::rad);
    let lever = [fix.tag_in_body.x.0, fix.tag_in_body.y.0];
    let covariance = fix.covariance.is_none_or(|own| {
        let determinant = own.xx_m2 * own.yy_m2 - own.xy_m2 * own.xy_m2;
        let is_heading_unknown = own.heading_rad2 == f64::INFINITY;
        bearable(&[own.xx_m2, own.xy_m2, own.yy_m2])
            && own.xx_m2 >= SMALLEST_VARIANCE
            && own.yy_m2 >= SMALLEST_VARIANCE
            && determinant > 0.0
            && (is_heading_unknown || (SMALLEST_VARIANCE..=LARGEST).contains(&own.heading_rad2))
    });
    bearable(&[fix.position.x.0, fix.position.y.0, heading_rad])
        && lever.iter().all(|value| value.abs() <= LONGEST_LEVER_M)
        && covariance
}

/// A record of an observation for which nothing was predicted.
pub(super) fn bare_record(observation: &Observation, lag: Span, verdict: Verdict) -> FusionRecord {
    FusionRecord {
        kind: observation.observed.kind(),
        lag,
        verdict,
        ..blank_record(observation.sensor, observation.stamp)
    }
}

/// A record of no kind, for what is not told to anybody.
pub(super) const fn blank_record(sensor: SensorId, stamp: Stamp<BrickClock>) -> FusionRecord {
    FusionRecord {
        sensor,
        kind: "",
        stamp,
        lag: Span::ZERO,
        verdict: Verdict::Accepted,
        innovation: [0.0; 3],
        innovation_covariance: [[0.0; 3]; 3],
        nis: 0.0,
        degrees_of_freedom: 0,
        log_likelihood: 0.0,
    }
}

/// The verdict on a reading that a track did or did not take.
pub(super) const fn verdict_of(added: Added) -> Verdict {
    match added {
        Added::After(_) => Verdict::Accepted,
        Added::Rebased(_) => Verdict::Rebased,
        Added::Outranked => Verdict::Unused,
        Added::Duplicate => Verdict::Malformed,
        Added::TooOld => Verdict::TooOld,
    }
}

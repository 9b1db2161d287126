//! What a drive's observations say one by one: where a fix saw the robot, how far the wheels turned.

use posebridge_estimator::models::differential_drive::{WheelTravel, body_step};
use posebridge_estimator::models::se2::BodyStep;
use posebridge_telemetry::{
    Arena, BrickClock, DriveGeometry, Fix, Meters, Observation, ObservationKind, Point2, Pose, Timestamp,
};

/// Where a fix saw mid-axle; the tag itself where the fix has no heading.
pub(crate) fn mid_axle_position(fix: &Fix) -> Point2<Arena> {
    let Some(heading) = fix.heading else {
        return fix.position;
    };
    let turned = Pose::<Arena>::new(Meters(0.0), Meters(0.0), heading) * fix.tag_in_body;
    Point2::new(Meters(fix.position.x.0 - turned.x.0), Meters(fix.position.y.0 - turned.y.0))
}

/// The fixes, with their stamps.
pub(crate) fn fixes(observations: &[Observation]) -> impl Iterator<Item = (Timestamp<BrickClock>, &Fix)> {
    observations.iter().filter_map(|observation| {
        let ObservationKind::Fix(fix) = &observation.measurement else {
            return None;
        };
        Some((observation.stamp, fix))
    })
}

/// The wheels' rotations, left and right, with their stamps, in rad.
pub(crate) fn wheels(observations: &[Observation]) -> impl Iterator<Item = (Timestamp<BrickClock>, [f64; 2])> {
    observations.iter().filter_map(|observation| {
        let ObservationKind::WheelAngles { left, right } = observation.measurement else {
            return None;
        };
        Some((observation.stamp, [left.0, right.0]))
    })
}

/// How the body moved while the wheels turned from one reading to another.
pub(crate) fn moved(from: [f64; 2], to: [f64; 2], geometry: &DriveGeometry) -> BodyStep {
    let travel = WheelTravel {
        left_m: geometry.left_wheel_radius.0 * (to[0] - from[0]),
        right_m: geometry.right_wheel_radius.0 * (to[1] - from[1]),
    };
    body_step(travel, geometry)
}

/// What came through a wire may be anything; the filters would refuse it one by one, the mean of a start could not.
pub(super) fn is_finite(observation: &Observation) -> bool {
    match &observation.measurement {
        ObservationKind::WheelAngles { left, right } => left.0.is_finite() && right.0.is_finite(),
        ObservationKind::Fix(fix) => {
            let place = fix.position.x.0.is_finite() && fix.position.y.0.is_finite();
            let tag = fix.tag_in_body.x.0.is_finite() && fix.tag_in_body.y.0.is_finite();
            place && tag && fix.heading.is_none_or(|heading| heading.rad().is_finite())
        }
        ObservationKind::TurnRate(rate) => rate.0.is_finite(),
        ObservationKind::WheelAccelerations { left, right } => left.0.is_finite() && right.0.is_finite(),
        ObservationKind::WallRange(range) => range.0.is_finite(),
        ObservationKind::OdometerPose(_)
        | ObservationKind::BodyVelocity { .. }
        | ObservationKind::Landmark { .. }
        | ObservationKind::BeaconRange { .. }
        | ObservationKind::CompassHeading(_)
        | ObservationKind::Temperature(_) => true,
    }
}

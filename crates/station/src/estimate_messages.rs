//! From estimates to messages.

use posebridge_protocol::message::{
    EstimatorStatus, Message, Odometry, OdometryPose, PlanarPose, PoseFlags, WireStamp,
};
use posebridge_telemetry::{
    BrickClock, Estimate, HostClock, Meters, MetersPerSecond, Pose, TimeDelta, Timestamp, estimate::row,
};

use crate::config::{AnnouncedAs, OutputKind};

/// Whether an estimate was predicted ahead of the last observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PredictionStatus {
    None,
    Ahead,
}

/// What a message contains besides the estimate itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PublishContext {
    /// Whether the estimate was predicted ahead.
    pub(crate) prediction: PredictionStatus,
    /// When it holds on the host's clock, for messages whose stamps are those of the sender's own clock.
    pub(crate) host: Timestamp<HostClock>,
    /// Normalised innovation squared of the last fix over its gate: above 1 it was refused.
    pub(crate) fix_ratio: f64,
    /// For whom it is: to a ground station the arena is a floor like any other.
    pub(crate) announced_as: AnnouncedAs,
}

/// The message of an estimate.
pub(crate) fn message(kind: OutputKind, estimate: &Estimate, circumstances: &PublishContext) -> Option<Message> {
    let PublishContext { prediction, host, fix_ratio, announced_as: voices } = *circumstances;
    match kind {
        OutputKind::PlanarPose => Some(Message::PlanarPose(planar_pose(estimate, prediction))),
        OutputKind::Odometry => Some(Message::Odometry(odometry(estimate, host, voices))),
        OutputKind::LocalPosition => {
            let (sin, cos) = estimate.pose.heading.rad().sin_cos();
            Some(Message::LocalPosition {
                stamp: host_stamp(host),
                x: estimate.pose.x,
                y: estimate.pose.y,
                x_speed: MetersPerSecond(estimate.forward_speed.0 * cos),
                y_speed: MetersPerSecond(estimate.forward_speed.0 * sin),
            })
        }
        OutputKind::Attitude => Some(Message::Attitude {
            stamp: host_stamp(host),
            heading: estimate.pose.heading,
            turn_rate: estimate.turn_rate,
        }),
        OutputKind::EstimatorStatus => Some(Message::EstimatorStatus(EstimatorStatus {
            stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
            flags: flags(estimate, prediction),
            position_ratio: fix_ratio,
            position_sigma: Meters(estimate.x_sigma_m().hypot(estimate.y_sigma_m())),
        })),
        OutputKind::FusionHealth | OutputKind::DistanceSensor | OutputKind::NamedValue | OutputKind::FloatArray => None,
    }
}

fn planar_pose(estimate: &Estimate, prediction: PredictionStatus) -> PlanarPose {
    PlanarPose {
        stamp: brick_stamp(estimate.stamp),
        pose: estimate.pose,
        forward_speed: estimate.forward_speed,
        turn_rate: estimate.turn_rate,
        covariance: upper_triangle(estimate),
        fix_age: estimate.fix_age,
        reset_counter: estimate.reset_counter,
        flags: flags(estimate, prediction),
    }
}

/// To a brick the pose is one in the arena, which it must distinguish from a drifting one. To a ground station, which knows the arena's
/// place on the globe no better, it is one on a floor whose heading is arbitrary: MAV_FRAME_LOCAL_FRD.
fn odometry(estimate: &Estimate, host: Timestamp<HostClock>, voices: AnnouncedAs) -> Odometry {
    let Pose { x, y, heading, .. } = estimate.pose;
    Odometry {
        stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
        pose: match voices {
            AnnouncedAs::Station => OdometryPose::Arena(estimate.pose),
            AnnouncedAs::StationAndVehicle => OdometryPose::Odom(Pose::new(x, y, heading)),
        },
        forward_speed: estimate.forward_speed,
        turn_rate: estimate.turn_rate,
        covariance: Some(upper_triangle(estimate)),
        reset_counter: estimate.reset_counter,
        // Only the standard's meaning: unset while all is well, failed when there is no pose.
        quality: if estimate.validity.position && estimate.validity.heading { 0 } else { -1 },
    }
}

fn upper_triangle(estimate: &Estimate) -> [f64; 6] {
    let p = &estimate.covariance;
    [
        p[row::X][row::X],
        p[row::X][row::Y],
        p[row::X][row::HEADING],
        p[row::Y][row::Y],
        p[row::Y][row::HEADING],
        p[row::HEADING][row::HEADING],
    ]
}

fn flags(estimate: &Estimate, prediction: PredictionStatus) -> PoseFlags {
    PoseFlags {
        position_valid: estimate.validity.position,
        heading_valid: estimate.validity.heading,
        speeds_valid: estimate.validity.speeds,
        dead_reckoning: estimate.is_dead_reckoning,
        predicted: prediction == PredictionStatus::Ahead,
    }
}

/// An instant of the host as milliseconds since the station began.
pub(crate) fn host_stamp(host: Timestamp<HostClock>) -> WireStamp {
    WireStamp::Millis32(host.as_micros().div_euclid(1_000) as u32)
}

/// A brick instant as the brick's own 32-bit microsecond counter shows it.
pub(crate) fn brick_stamp(stamp: Timestamp<BrickClock>) -> WireStamp {
    WireStamp::Micros32(stamp.as_micros().rem_euclid(1 << 32) as u32)
}

/// Half of a round trip: the best guess of how long an estimate travels.
pub(crate) fn travel_time(round_trip: Option<TimeDelta>) -> TimeDelta {
    round_trip.map_or(TimeDelta::ZERO, |whole| TimeDelta::from_nanos(whole.as_nanos() / 2))
}

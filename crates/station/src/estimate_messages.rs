//! Converts estimates and fusion records to messages.
//!
//! Of a record, innovations and NIS are sent, for plots:
//! ```text
//! NAMED_VALUE_FLOAT    nis_<sensor>        NIS over its degrees of freedom: 1 in the mean when all is well
//! DEBUG_FLOAT_ARRAY    <sensor>, its id    NIS, degrees of freedom, verdict as in PB_FUSION_HEALTH, lag in s,
//!                                          innovation (3), standard deviations that were expected of it (3)
//! ```

use posebridge_protocol::message::{
    AttitudeQuaternion, EstimatorStatus, FloatArray, FusionHealth, GlobalPosition, HeadUpDisplay, Message, NamedValue,
    Odometry, OdometryPose, PlanarPose, PoseFlags, WireStamp,
};
use posebridge_telemetry::{
    BrickClock, ChannelName, Estimate, FusionOutcome, FusionRecord, GeodeticOrigin, HostClock, Meters, MetersPerSecond,
    Pose, SensorId, TimeDelta, Timestamp, estimate::row,
};
use serde::{Deserialize, Serialize};

use crate::config::{AnnouncedAs, OutputKind};

/// The context of a message besides the estimate itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PublishContext {
    /// The estimate was predicted ahead of the last observation.
    pub(crate) is_predicted: bool,
    /// Its instant on the host's clock, for messages stamped by the sender's own clock.
    pub(crate) host: Timestamp<HostClock>,
    /// Normalised innovation squared of the last fix over its gate: above 1 it was rejected.
    pub(crate) fix_ratio: f64,
    /// Of the robot's owner in a fleet of stations, 0 without one.
    pub(crate) epoch: u64,
    /// Where the arena lies on the Earth.
    pub(crate) origin: Option<GeodeticOrigin>,
    /// The recipient: for a ground station the arena's frame is an arbitrary local one.
    pub(crate) announced_as: AnnouncedAs,
}

pub(crate) fn estimate_message(kind: OutputKind, estimate: &Estimate, context: &PublishContext) -> Option<Message> {
    let PublishContext { is_predicted, host, fix_ratio, epoch, origin, announced_as } = *context;
    let flags = PoseFlags {
        position_valid: estimate.validity.position,
        heading_valid: estimate.validity.heading,
        speeds_valid: estimate.validity.speeds,
        dead_reckoning: estimate.is_dead_reckoning,
        predicted: is_predicted,
    };
    match kind {
        OutputKind::PlanarPose => Some(Message::PlanarPose(planar_pose(estimate, flags, epoch))),
        OutputKind::Odometry => Some(Message::Odometry(odometry(estimate, host, announced_as))),
        OutputKind::LocalPosition => {
            let [x_speed, y_speed] = velocity(estimate);
            Some(Message::LocalPosition {
                stamp: host_stamp(host),
                x: estimate.pose.x,
                y: estimate.pose.y,
                x_speed,
                y_speed,
            })
        }
        // A relative pose is nowhere on the Earth.
        OutputKind::GlobalPosition => origin.filter(|_| !estimate.is_relative()).map(|origin| {
            let [east_speed, north_speed] = velocity(estimate);
            Message::GlobalPosition(GlobalPosition {
                stamp: host_stamp(host),
                position: origin.to_geodetic(estimate.pose.origin()),
                altitude: origin.altitude(),
                east_speed,
                north_speed,
                heading: estimate.validity.heading.then_some(estimate.pose.heading),
            })
        }),
        OutputKind::HeadUpDisplay => Some(Message::HeadUpDisplay(HeadUpDisplay {
            ground_speed: MetersPerSecond(estimate.forward_speed.0.abs()),
            heading: estimate.pose.heading,
            altitude: origin.map_or(Meters(0.0), |origin| origin.altitude()),
        })),
        OutputKind::AttitudeQuaternion => Some(Message::AttitudeQuaternion(AttitudeQuaternion {
            stamp: host_stamp(host),
            heading: estimate.pose.heading,
            turn_rate: estimate.turn_rate,
        })),
        OutputKind::Attitude => Some(Message::Attitude {
            stamp: host_stamp(host),
            heading: estimate.pose.heading,
            turn_rate: estimate.turn_rate,
        }),
        OutputKind::EstimatorStatus => Some(Message::EstimatorStatus(EstimatorStatus {
            stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
            // Here a position may be relative, and then so is the heading.
            flags: PoseFlags {
                position_valid: true,
                heading_valid: flags.heading_valid || estimate.is_relative(),
                ..flags
            },
            position_ratio: fix_ratio,
            position_sigma: Meters(estimate.x_sigma_m().hypot(estimate.y_sigma_m())),
        })),
        OutputKind::FusionHealth | OutputKind::DistanceSensor | OutputKind::NamedValue | OutputKind::FloatArray => None,
    }
}

/// Along the arena's x and y.
fn velocity(estimate: &Estimate) -> [MetersPerSecond; 2] {
    let (sin, cos) = estimate.pose.heading.rad().sin_cos();
    [cos, sin].map(|share| MetersPerSecond(estimate.forward_speed.0 * share))
}

fn planar_pose(estimate: &Estimate, flags: PoseFlags, epoch: u64) -> PlanarPose {
    PlanarPose {
        stamp: brick_stamp(estimate.stamp),
        pose: estimate.pose,
        forward_speed: estimate.forward_speed,
        turn_rate: estimate.turn_rate,
        covariance: upper_triangle(estimate),
        fix_age: estimate.fix_age,
        reset_counter: estimate.reset_counter,
        flags,
        // Saturates: one that is too large for the wire must not look like an old one.
        epoch: u32::try_from(epoch).unwrap_or(u32::MAX),
    }
}

/// For a brick the pose is in the arena frame, which it must distinguish from a relative one. For a ground station,
/// which does not know the arena's position on the globe, it is in a local frame with an arbitrary heading:
/// MAV_FRAME_LOCAL_FRD. So is a relative pose for everybody.
fn odometry(estimate: &Estimate, host: Timestamp<HostClock>, announced_as: AnnouncedAs) -> Odometry {
    let Pose { x, y, heading, .. } = estimate.pose;
    Odometry {
        stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
        pose: match announced_as {
            AnnouncedAs::Station if !estimate.is_relative() => OdometryPose::Arena(estimate.pose),
            AnnouncedAs::Station | AnnouncedAs::StationAndVehicle => OdometryPose::Odom(Pose::new(x, y, heading)),
        },
        forward_speed: estimate.forward_speed,
        turn_rate: estimate.turn_rate,
        covariance: Some(upper_triangle(estimate)),
        reset_counter: estimate.reset_counter,
        // Only the standard's meaning: unset while all is well, failed without a heading.
        quality: if estimate.is_relative() || estimate.validity.heading { 0 } else { -1 },
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

/// An instant of the host as milliseconds since the start of the session.
pub(crate) fn host_stamp(host: Timestamp<HostClock>) -> WireStamp {
    WireStamp::Millis32(host.as_micros().div_euclid(1_000) as u32)
}

/// A brick instant as the brick's own 32-bit microsecond counter shows it.
pub(crate) fn brick_stamp(stamp: Timestamp<BrickClock>) -> WireStamp {
    WireStamp::Micros32(stamp.as_micros().rem_euclid(1 << 32) as u32)
}

/// Half of a round trip: the best guess of an estimate's travel time.
pub(crate) fn travel_time(round_trip: Option<TimeDelta>) -> TimeDelta {
    round_trip.map_or(TimeDelta::ZERO, |round_trip| TimeDelta::from_nanos(round_trip.as_nanos() / 2))
}

/// Used and rejected observations of one sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct FusionCounts {
    pub(crate) accepted: u16,
    pub(crate) rejected: u16,
}

impl FusionCounts {
    pub(crate) const fn add(&mut self, outcome: FusionOutcome) {
        match outcome {
            FusionOutcome::Accepted | FusionOutcome::Slip | FusionOutcome::PoseReset | FusionOutcome::Rebased => {
                self.accepted = self.accepted.wrapping_add(1);
            }
            FusionOutcome::Gated | FusionOutcome::TooOld | FusionOutcome::Malformed => {
                self.rejected = self.rejected.wrapping_add(1);
            }
            FusionOutcome::Unused => {}
        }
    }
}

/// The message of an output about a record; `None` if it does not depend on records. `host` is when the observation was
/// made.
pub(crate) fn record_message(
    kind: OutputKind,
    record: &FusionRecord,
    host: Timestamp<HostClock>,
    counts: FusionCounts,
) -> Option<Message> {
    match kind {
        OutputKind::FusionHealth => Some(Message::FusionHealth(FusionHealth {
            stamp: brick_stamp(record.stamp),
            sensor: record.sensor,
            verdict: outcome_code(record.outcome),
            nis_per_dof: nis_per_dof(record),
            innovation: record.innovation,
            lag: record.lag,
            accepted: counts.accepted,
            refused: counts.rejected,
        })),
        OutputKind::NamedValue => Some(Message::NamedValue(NamedValue {
            stamp: host_stamp(host),
            name: nis_name(record.sensor),
            value: nis_per_dof(record) as f32,
        })),
        OutputKind::FloatArray => Some(Message::FloatArray(FloatArray {
            stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
            name: ChannelName::from_bytes(record.sensor.name().as_bytes()),
            id: u16::from(record.sensor.0),
            values: values(record),
        })),
        OutputKind::PlanarPose
        | OutputKind::Odometry
        | OutputKind::LocalPosition
        | OutputKind::Attitude
        | OutputKind::EstimatorStatus
        | OutputKind::GlobalPosition
        | OutputKind::HeadUpDisplay
        | OutputKind::AttitudeQuaternion
        | OutputKind::DistanceSensor => None,
    }
}

fn nis_per_dof(record: &FusionRecord) -> f64 {
    record.nis / f64::from(record.degrees_of_freedom.max(1))
}

/// Ten bytes hold six of the sensor's name: `nis_camera`.
fn nis_name(sensor: SensorId) -> ChannelName {
    ChannelName::from_bytes(format!("nis_{:.6}", sensor.name()).as_bytes())
}

fn values(record: &FusionRecord) -> Vec<f32> {
    let s = &record.innovation_covariance;
    let head = [
        record.nis,
        f64::from(record.degrees_of_freedom),
        f64::from(outcome_code(record.outcome)),
        record.lag.as_secs_f64(),
    ];
    let expected = [s[0][0], s[1][1], s[2][2]].map(|variance| variance.max(0.0).sqrt());
    let all = head.into_iter().chain(record.innovation).chain(expected);
    all.map(|value| value as f32).collect()
}

const fn outcome_code(verdict: FusionOutcome) -> u8 {
    match verdict {
        FusionOutcome::Accepted => 0,
        FusionOutcome::Gated => 1,
        FusionOutcome::TooOld => 2,
        FusionOutcome::Malformed => 3,
        FusionOutcome::Rebased => 4,
        FusionOutcome::PoseReset => 5,
        FusionOutcome::Unused => 6,
        FusionOutcome::Slip => 7,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::TimeDelta;

    #[test]
    fn an_estimate_travels_for_half_of_a_round_trip() {
        assert_eq!(travel_time(Some(TimeDelta::from_micros(7_000))), TimeDelta::from_micros(3_500));
        assert_eq!(travel_time(None), TimeDelta::ZERO);
    }

    #[test]
    fn an_array_holds_the_documented_values_in_order() {
        let record = FusionRecord {
            sensor: SensorId::CAMERA,
            kind: "fix",
            stamp: Timestamp::from_millis(1_000),
            lag: TimeDelta::from_millis(250),
            outcome: FusionOutcome::Gated,
            innovation: [0.5, -0.25, 0.125],
            innovation_covariance: [[4.0, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.0625]],
            nis: 12.0,
            degrees_of_freedom: 3,
            log_likelihood: 0.0,
        };
        let host = Timestamp::from_millis(7_000);
        let message = |kind| record_message(kind, &record, host, FusionCounts::default());
        let array = FloatArray {
            stamp: WireStamp::Micros64(7_000_000),
            name: ChannelName::from_bytes(b"camera"),
            id: 3,
            values: vec![12.0, 3.0, 1.0, 0.25, 0.5, -0.25, 0.125, 2.0, 0.5, 0.25],
        };
        assert_eq!(message(OutputKind::FloatArray), Some(Message::FloatArray(array)));
        let value =
            NamedValue { stamp: WireStamp::Millis32(7_000), name: ChannelName::from_bytes(b"nis_camera"), value: 4.0 };
        assert_eq!(message(OutputKind::NamedValue), Some(Message::NamedValue(value)));
        assert_eq!(message(OutputKind::Odometry), None);
    }
}

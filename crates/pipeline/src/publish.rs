//! From estimates to messages: which leave on a link, how often, and for which instant.

use posebridge_protocol::dialect::ids;
use posebridge_protocol::message::{
    EstimatorStatus, FusionHealth, Message, Odometry, OdometryPose, PlanarPose, PoseFlags,
    WireStamp,
};
use posebridge_telemetry::{
    BrickClock, Estimate, FusionRecord, HostClock, Meters, MetersPerSecond, Priority, SensorId,
    Span, Stamp, Verdict, estimate::row,
};
use std::collections::BTreeMap;

use crate::config::{OutputInstant, OutputKind, OutputStream};

/// The messages whose interval a peer may set with SET_MESSAGE_INTERVAL, for its own link.
pub(crate) const SETTABLE: [(u32, OutputKind); 6] = [
    (ids::PB_PLANAR_POSE, OutputKind::PlanarPose),
    (ids::ODOMETRY, OutputKind::Odometry),
    (ids::LOCAL_POSITION_NED, OutputKind::LocalPosition),
    (ids::ATTITUDE, OutputKind::Attitude),
    (ids::ESTIMATOR_STATUS, OutputKind::EstimatorStatus),
    (ids::PB_FUSION_HEALTH, OutputKind::FusionHealth),
];

/// What one of the outputs is worth on a slow link.
pub(crate) fn priority(kind: OutputKind) -> Priority {
    let named = SETTABLE.iter().find(|(_, known)| *known == kind);
    Priority::Estimate {
        stream: named.map_or(0, |(id, _)| *id),
    }
}

/// Keeps the intervals of one link's outputs.
#[derive(Clone, Debug)]
pub(crate) struct Publisher {
    /// What is sent unless a peer asks for something else.
    configured: Vec<OutputStream>,
    streams: Vec<(OutputStream, Option<Stamp<HostClock>>)>,
    /// Used and refused observations per sensor, for PB_FUSION_HEALTH.
    counts: BTreeMap<SensorId, (u16, u16)>,
}

impl Publisher {
    pub(crate) fn new(streams: &[OutputStream]) -> Self {
        Self {
            configured: streams.to_vec(),
            streams: streams.iter().map(|stream| (*stream, None)).collect(),
            counts: BTreeMap::new(),
        }
    }

    /// Follows a peer's request: another interval, none at all, or (zero) what is configured.
    pub(crate) fn set_interval(&mut self, message_id: u32, interval: Option<Span>) {
        let Some((_, kind)) = SETTABLE.iter().find(|(id, _)| *id == message_id) else {
            return;
        };
        let configured = self
            .configured
            .iter()
            .find(|stream| stream.kind == *kind)
            .copied();
        self.streams.retain(|(stream, _)| stream.kind != *kind);
        let asked = |interval| OutputStream {
            kind: *kind,
            interval,
            instant: configured.map_or(OutputInstant::Observed, |stream| stream.instant),
        };
        let stream = match interval {
            None => None,
            Some(Span::ZERO) => configured,
            Some(interval) => Some(asked(interval)),
        };
        self.streams.extend(stream.map(|stream| (stream, None)));
    }

    /// Which outputs are due; they count as sent.
    pub(crate) fn due(&mut self, now: Stamp<HostClock>) -> Vec<OutputStream> {
        let mut due = Vec::new();
        for (stream, last) in &mut self.streams {
            if stream.kind == OutputKind::FusionHealth {
                continue;
            }
            if last.is_none_or(|last| now - last >= stream.interval) {
                *last = Some(now);
                due.push(*stream);
            }
        }
        due
    }

    /// The health message of an observation that was held against a prediction, if this link wants it.
    pub(crate) fn fusion_health(&mut self, record: &FusionRecord) -> Option<Message> {
        let counts = self.counts.entry(record.sensor).or_default();
        match record.verdict {
            Verdict::Accepted | Verdict::ResetTo | Verdict::Rebased => {
                counts.0 = counts.0.wrapping_add(1);
            }
            Verdict::Gated | Verdict::TooOld | Verdict::Malformed => {
                counts.1 = counts.1.wrapping_add(1);
            }
            Verdict::Unused => {}
        }
        let wanted = self
            .streams
            .iter()
            .any(|(stream, _)| stream.kind == OutputKind::FusionHealth);
        if !wanted || record.degrees_of_freedom == 0 {
            return None;
        }
        let (accepted, refused) = *counts;
        Some(Message::FusionHealth(FusionHealth {
            stamp: wrapped(record.stamp),
            sensor: record.sensor,
            verdict: verdict_code(record.verdict),
            nis_per_dof: record.nis / f64::from(record.degrees_of_freedom),
            innovation: record.innovation,
            lag: record.lag,
            accepted,
            refused,
        }))
    }
}

/// Whether an estimate was predicted ahead of the last observation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Prediction {
    None,
    Ahead,
}

/// What a message says besides the estimate itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Circumstances {
    /// Whether the estimate was predicted ahead.
    pub(crate) prediction: Prediction,
    /// When it holds on the host's clock, for messages whose stamps are those of the sender's own clock.
    pub(crate) host: Stamp<HostClock>,
    /// Normalised innovation squared of the last fix over its gate: above 1 it was refused.
    pub(crate) fix_ratio: f64,
}

/// The message of an estimate.
pub(crate) fn message(
    kind: OutputKind,
    estimate: &Estimate,
    circumstances: &Circumstances,
) -> Option<Message> {
    let Circumstances {
        prediction,
        host,
        fix_ratio,
    } = *circumstances;
    let since_boot = WireStamp::Millis32(host.as_micros().div_euclid(1_000) as u32);
    match kind {
        OutputKind::PlanarPose => Some(Message::PlanarPose(planar_pose(estimate, prediction))),
        OutputKind::Odometry => Some(Message::Odometry(odometry(estimate, host))),
        OutputKind::LocalPosition => {
            let (sin, cos) = estimate.pose.heading.rad().sin_cos();
            Some(Message::LocalPosition {
                stamp: since_boot,
                x: estimate.pose.x,
                y: estimate.pose.y,
                x_speed: MetersPerSecond(estimate.forward_speed.0 * cos),
                y_speed: MetersPerSecond(estimate.forward_speed.0 * sin),
            })
        }
        OutputKind::Attitude => Some(Message::Attitude {
            stamp: since_boot,
            heading: estimate.pose.heading,
            turn_rate: estimate.turn_rate,
        }),
        OutputKind::EstimatorStatus => Some(Message::EstimatorStatus(EstimatorStatus {
            stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
            flags: flags(estimate, prediction),
            position_ratio: fix_ratio,
            position_sigma: Meters(estimate.x_sigma_m().hypot(estimate.y_sigma_m())),
        })),
        OutputKind::FusionHealth => None,
    }
}

fn planar_pose(estimate: &Estimate, prediction: Prediction) -> PlanarPose {
    PlanarPose {
        stamp: wrapped(estimate.stamp),
        pose: estimate.pose,
        forward_speed: estimate.forward_speed,
        turn_rate: estimate.turn_rate,
        covariance: upper_triangle(estimate),
        fix_age: estimate.fix_age,
        reset_counter: estimate.reset_counter,
        flags: flags(estimate, prediction),
    }
}

fn odometry(estimate: &Estimate, host: Stamp<HostClock>) -> Odometry {
    Odometry {
        stamp: WireStamp::Micros64(host.as_micros().unsigned_abs()),
        pose: OdometryPose::Arena(estimate.pose),
        forward_speed: estimate.forward_speed,
        turn_rate: estimate.turn_rate,
        covariance: Some(upper_triangle(estimate)),
        reset_counter: estimate.reset_counter,
        // Only the standard's meaning: unset while all is well, failed when there is no pose.
        quality: if estimate.validity.position && estimate.validity.heading {
            0
        } else {
            -1
        },
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

fn flags(estimate: &Estimate, prediction: Prediction) -> PoseFlags {
    PoseFlags {
        position_valid: estimate.validity.position,
        heading_valid: estimate.validity.heading,
        speeds_valid: estimate.validity.speeds,
        dead_reckoning: estimate.is_dead_reckoning,
        predicted: prediction == Prediction::Ahead,
    }
}

/// A brick instant as the brick's own 32-bit microsecond counter shows it.
fn wrapped(stamp: Stamp<BrickClock>) -> WireStamp {
    WireStamp::Micros32(stamp.as_micros().rem_euclid(1 << 32) as u32)
}

const fn verdict_code(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::Accepted => 0,
        Verdict::Gated => 1,
        Verdict::TooOld => 2,
        Verdict::Malformed => 3,
        Verdict::Rebased => 4,
        Verdict::ResetTo => 5,
        Verdict::Unused => 6,
    }
}

/// Half of a round trip: the best guess of how long an estimate travels.
pub(crate) fn travel_time(round_trip: Option<Span>) -> Span {
    round_trip.map_or(Span::ZERO, |whole| Span::from_nanos(whole.as_nanos() / 2))
}

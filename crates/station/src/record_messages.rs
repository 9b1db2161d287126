//! From the record of an observation to messages: innovations and NIS, for people who look at plots.
//!
//! # Model
//! ```text
//! NAMED_VALUE_FLOAT    nis_<sensor>        NIS over its degrees of freedom: 1 in the mean when all is well
//! DEBUG_FLOAT_ARRAY    <sensor>, its id    NIS, degrees of freedom, verdict as in PB_FUSION_HEALTH, lag in s,
//!                                          innovation (3), standard deviations that were expected of it (3)
//! ```

use posebridge_protocol::message::{FloatArray, FusionHealth, Message, NamedValue, WireStamp};
use posebridge_telemetry::{ChannelName, FusionOutcome, FusionRecord, HostClock, SensorId, Timestamp};

use crate::config::OutputKind;
use crate::estimate_messages::{brick_stamp, host_stamp};

/// Used and refused observations of one sensor so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct FusionCounts {
    pub(crate) accepted: u16,
    pub(crate) rejected: u16,
}

/// What an output says of a record; `None` if it does not depend on records. `host` is when the observation was made.
pub(crate) fn message(
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
        | OutputKind::DistanceSensor => None,
    }
}

fn nis_per_dof(record: &FusionRecord) -> f64 {
    record.nis / f64::from(record.degrees_of_freedom.max(1))
}

/// Ten bytes are room for six of the sensor's name: `nis_camera`.
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
    fn an_array_holds_what_its_page_says_in_that_order() {
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
        let said = |kind| message(kind, &record, host, FusionCounts::default());
        let array = FloatArray {
            stamp: WireStamp::Micros64(7_000_000),
            name: ChannelName::from_bytes(b"camera"),
            id: 3,
            values: vec![12.0, 3.0, 1.0, 0.25, 0.5, -0.25, 0.125, 2.0, 0.5, 0.25],
        };
        assert_eq!(said(OutputKind::FloatArray), Some(Message::FloatArray(array)));
        let value =
            NamedValue { stamp: WireStamp::Millis32(7_000), name: ChannelName::from_bytes(b"nis_camera"), value: 4.0 };
        assert_eq!(said(OutputKind::NamedValue), Some(Message::NamedValue(value)));
        assert_eq!(said(OutputKind::Odometry), None);
    }
}

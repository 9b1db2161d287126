//! Messages to frames, with the sequence numbers of one link.

use std::collections::BTreeMap;

use posebridge_telemetry::Address;

use super::catalogue::CATALOGUE;
use super::payload::Payload;
use super::{conversation, ids, own, poses, sensors};
use crate::framing::{START_V1, START_V2, WireVersion, checksum};
use crate::message::Message;
use crate::signing::{FLAG_SIGNED, Seal};

/// Writes frames for one link.
///
/// Receivers compute losses per (system, component) and link, so an encoder belongs to one link and counts for each
/// address that speaks on it.
#[derive(Clone, Debug)]
pub struct Encoder {
    version: WireVersion,
    sequences: BTreeMap<Address, u8>,
}

impl Encoder {
    /// An encoder that has sent nothing.
    #[must_use]
    pub fn new(version: WireVersion) -> Self {
        Self {
            version,
            sequences: BTreeMap::new(),
        }
    }

    /// Appends one whole frame, unsigned, to `out` and returns its length.
    ///
    /// Returns 0 and appends nothing when the message has no MAVLink 1 form: ids above 255 (ODOMETRY, WHEEL_DISTANCE and
    /// our own dialect).
    pub fn encode(&mut self, from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        self.write(from, message, None, out)
    }

    /// Appends one whole frame with its signature to `out` and returns its length, signature included.
    ///
    /// Returns 0 and appends nothing for a MAVLink 1 encoder: those frames cannot be signed.
    pub fn encode_signed(
        &mut self,
        from: Address,
        message: &Message,
        seal: &Seal<'_>,
        out: &mut Vec<u8>,
    ) -> usize {
        match self.version {
            WireVersion::V1 => 0,
            WireVersion::V2 => self.write(from, message, Some(seal), out),
        }
    }

    fn write(
        &mut self,
        from: Address,
        message: &Message,
        seal: Option<&Seal<'_>>,
        out: &mut Vec<u8>,
    ) -> usize {
        let Some((message_id, payload)) = payload_of(self.version, message) else {
            return 0;
        };
        let Some(shape) = CATALOGUE.shape(message_id) else {
            return 0;
        };
        let payload = payload.bytes();
        let [id0, id1, id2, _] = message_id.to_le_bytes();
        let start = out.len();
        match self.version {
            WireVersion::V1 if message_id > 0xFF => return 0,
            WireVersion::V1 => out.extend_from_slice(&[START_V1, payload.len() as u8]),
            WireVersion::V2 => {
                let flags = seal.map_or(0, |_| FLAG_SIGNED);
                out.extend_from_slice(&[START_V2, payload.len() as u8, flags, 0]);
            }
        }
        let sequence = self.next_sequence(from);
        out.extend_from_slice(&[sequence, from.system.0, from.component.0, id0]);
        if self.version == WireVersion::V2 {
            out.extend_from_slice(&[id1, id2]);
        }
        out.extend_from_slice(payload);
        let sum = checksum(&out[start + 1..], shape.crc_extra);
        out.extend_from_slice(&sum.to_le_bytes());
        if let Some(seal) = seal {
            seal.append(out, start);
        }
        out.len() - start
    }

    fn next_sequence(&mut self, from: Address) -> u8 {
        let next = self.sequences.entry(from).or_default();
        let sequence = *next;
        *next = next.wrapping_add(1);
        sequence
    }
}

/// The payload of any message. The match is exhaustive so that a new message cannot be forgotten here.
fn payload_of(version: WireVersion, message: &Message) -> Option<(u32, Payload)> {
    let payload = match message {
        Message::WheelTicks(ticks) => (ids::PB_WHEEL_TICKS, own::write_ticks(version, ticks)),
        Message::Inertial(inertial) => (ids::PB_INERTIAL, own::write_inertial(version, inertial)),
        Message::PlanarPose(pose) => (ids::PB_PLANAR_POSE, own::write_pose(version, pose)),
        Message::FusionHealth(health) => {
            (ids::PB_FUSION_HEALTH, own::write_health(version, health))
        }
        Message::RobotDescription(robot) => {
            (ids::PB_ROBOT_DESCRIPTION, own::write_robot(version, robot))
        }
        Message::Heartbeat(_)
        | Message::SystemTime { .. }
        | Message::TimeSync(_)
        | Message::SetMessageInterval(_)
        | Message::Command(_)
        | Message::CommandAck(_)
        | Message::StatusText { .. }
        | Message::ParamRequestList { .. }
        | Message::ParamRequestRead { .. }
        | Message::ParamSet { .. }
        | Message::ParamValue { .. } => return conversation::write(version, message),
        Message::WheelDistance { .. }
        | Message::ScaledImu(_)
        | Message::HighresImu(_)
        | Message::DistanceSensor { .. }
        | Message::Thermometer { .. } => return sensors::write(version, message),
        // The dialects have none; it comes from bricks with protocols of their own.
        Message::Compass { .. } => return None,
        Message::VisionPosition(_)
        | Message::MocapPosition(_)
        | Message::Odometry(_)
        | Message::LocalPosition { .. }
        | Message::Attitude { .. }
        | Message::EstimatorStatus(_) => return poses::write(version, message),
    };
    Some(payload)
}

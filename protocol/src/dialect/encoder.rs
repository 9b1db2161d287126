//! Encodes messages to frames, with the sequence numbers of one link.

use std::collections::BTreeMap;

use posebridge_telemetry::Address;

use super::catalogue::CATALOGUE;
use super::payload::Payload;
use super::rewrite::{RenumberError, rewrite};
use super::{component, ids, posebridge, poses, sensors, services};
use crate::framing::{START_BYTE_V1, START_BYTE_V2, WireVersion, checksum};
use crate::message::Message;
use crate::signing::{FLAG_SIGNED, FrameSigner};

/// The bytes of a frame beside its payload, at most: header, checksum and signature of MAVLink 2.
const MAX_FRAME_OVERHEAD: usize = 10 + 2 + 13;

/// Writes frames for one link.
///
/// Receivers compute losses per (system, component) and link, so an encoder belongs to one link and counts for each address that
/// sends on it.
#[derive(Clone, Debug)]
pub struct Encoder {
    version: WireVersion,
    sequences: BTreeMap<Address, u8>,
}

impl Encoder {
    /// An encoder that has sent nothing.
    pub fn new(version: WireVersion) -> Self {
        Self { version, sequences: BTreeMap::new() }
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
        seal: &FrameSigner<'_>,
        out: &mut Vec<u8>,
    ) -> usize {
        match self.version {
            WireVersion::V1 => 0,
            WireVersion::V2 => self.write(from, message, Some(seal), out),
        }
    }

    fn write(&mut self, from: Address, message: &Message, seal: Option<&FrameSigner<'_>>, out: &mut Vec<u8>) -> usize {
        let Some((message_id, payload)) = payload_of(self.version, message) else {
            return 0;
        };
        let Some(shape) = CATALOGUE.layout(message_id) else {
            return 0;
        };
        let payload = payload.bytes();
        let [id0, id1, id2, _] = message_id.to_le_bytes();
        let start = out.len();
        out.reserve(payload.len() + MAX_FRAME_OVERHEAD);
        match self.version {
            WireVersion::V1 if message_id > 0xFF => return 0,
            WireVersion::V1 => out.extend_from_slice(&[START_BYTE_V1, payload.len() as u8]),
            WireVersion::V2 => {
                let flags = seal.map_or(0, |_| FLAG_SIGNED);
                out.extend_from_slice(&[START_BYTE_V2, payload.len() as u8, flags, 0]);
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
            seal.sign(out, start);
        }
        out.len() - start
    }

    /// Gives a whole frame of somebody else a sender's address, its own or another, and the next number of that sender on this link. Its
    /// checksum follows; nothing else changes.
    ///
    /// The checksum's seed is found from the old checksum, so that messages of no dialect can be changed as well.
    ///
    /// # Errors
    /// A frame that cannot be changed stays as it is.
    pub fn readdress(&mut self, frame: &mut [u8], sender: Address) -> Result<(), RenumberError> {
        rewrite(frame, |frame, layout| {
            frame[layout.sequence_at] = self.next_sequence(sender);
            frame[layout.system_at] = sender.system.0;
            frame[layout.system_at + 1] = sender.component.0;
            Ok(())
        })
    }

    /// Records that a forwarded frame leaves under the number that it came with: the next one of its sender here is the next after that.
    pub fn note_forwarded(&mut self, from: Address, sequence: u8) {
        self.sequences.insert(from, sequence.wrapping_add(1));
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
        Message::WheelTicks(ticks) => (ids::PB_WHEEL_TICKS, posebridge::write_ticks(version, ticks)),
        Message::Inertial(inertial) => (ids::PB_INERTIAL, posebridge::write_inertial(version, inertial)),
        Message::PlanarPose(pose) => (ids::PB_PLANAR_POSE, posebridge::write_pose(version, pose)),
        Message::FusionHealth(health) => (ids::PB_FUSION_HEALTH, posebridge::write_health(version, health)),
        Message::RobotDescription(robot) => (ids::PB_ROBOT_DESCRIPTION, posebridge::write_robot(version, robot)),
        Message::AutopilotVersion(_)
        | Message::ProtocolVersion(_)
        | Message::ComponentInformation(_)
        | Message::MessageInterval(_)
        | Message::NamedValue(_)
        | Message::FloatArray(_) => return component::write(version, message),
        Message::Heartbeat(_)
        | Message::SystemTime { .. }
        | Message::TimeSync(_)
        | Message::SetMessageInterval(_)
        | Message::Command(_)
        | Message::CommandInt(_)
        | Message::CommandAck(_)
        | Message::StatusText { .. }
        | Message::ParamRequestList { .. }
        | Message::ParamRequestRead { .. }
        | Message::ParamSet { .. }
        | Message::ParamSetUnsupported { .. }
        | Message::ParamValue { .. } => return services::write(version, message),
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

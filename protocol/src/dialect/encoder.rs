//! Encodes messages to frames, with the sequence numbers of one link.

use std::collections::BTreeMap;

use posebridge_telemetry::Address;

use super::catalogue::CATALOGUE;
use super::payload::Payload;
use super::{component, ids, posebridge, poses, sensors, services};
use crate::framing::{START_BYTE_V1, START_BYTE_V2, WireVersion, checksum, crc_extra_of};
use crate::message::Message;
use crate::signing::{FLAG_SIGNED, FrameSigner};

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

    /// Gives a whole frame of somebody else the next number of its sender on this link. Its checksum follows; nothing else changes.
    ///
    /// The checksum's seed is found from the old checksum, so that messages of no dialect can be numbered as well.
    ///
    /// # Errors
    /// A frame that cannot be numbered stays as it is.
    pub fn renumber(&mut self, frame: &mut [u8]) -> Result<(), RenumberError> {
        let layout = FrameLayout::parse(frame).ok_or(RenumberError::NoFrame)?;
        if layout.is_signed {
            return Err(RenumberError::Signed);
        }
        let FrameLayout { source, sequence_at, end, .. } = layout;
        let body = frame.get(1..end).ok_or(RenumberError::NoFrame)?;
        let sum = match frame.get(end..end + 2) {
            Some(&[low, high]) => u16::from_le_bytes([low, high]),
            _ => return Err(RenumberError::NoFrame),
        };
        let crc_extra = crc_extra_of(body, sum).ok_or(RenumberError::Damaged)?;
        frame[sequence_at] = self.next_sequence(source);
        let sum = checksum(&frame[1..end], crc_extra);
        frame[end..end + 2].copy_from_slice(&sum.to_le_bytes());
        Ok(())
    }

    /// Takes note that a frame of somebody else leaves under the number that it came with: his next one here is the next after that.
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

/// Why a frame was not numbered anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RenumberError {
    /// The bytes are no whole frame.
    #[error("the bytes are no whole frame")]
    NoFrame,
    /// It is signed: only who has the key may change it.
    #[error("the frame is signed, and only its sender can sign it under another number")]
    Signed,
    /// No CRC_EXTRA makes its checksum right, so no right one can be given to it.
    #[error("the frame's checksum is right for no message")]
    Damaged,
}

/// Whether a whole frame bears a signature; false of what is no frame.
#[must_use]
pub fn is_signed(frame: &[u8]) -> bool {
    FrameLayout::parse(frame).is_some_and(|layout| layout.is_signed)
}

/// Where in a frame that is to be numbered the parts stand.
struct FrameLayout {
    source: Address,
    sequence_at: usize,
    /// Where the payload ends and the checksum begins.
    end: usize,
    is_signed: bool,
}

impl FrameLayout {
    fn parse(frame: &[u8]) -> Option<Self> {
        match *frame {
            [START_BYTE_V2, len, flags, _, _, system, component, ..] => Some(Self {
                source: Address::new(system, component),
                sequence_at: 4,
                end: 10 + usize::from(len),
                is_signed: flags & FLAG_SIGNED != 0,
            }),
            [START_BYTE_V1, len, _, system, component, ..] => Some(Self {
                source: Address::new(system, component),
                sequence_at: 2,
                end: 6 + usize::from(len),
                is_signed: false,
            }),
            _ => None,
        }
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

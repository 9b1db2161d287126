//! Encodes messages to frames with the sequence numbers of one link, and rewrites frames of others.

use std::collections::BTreeMap;

use posebridge_telemetry::Address;

use super::catalogue::CATALOGUE;
use super::payload::Payload;
use super::{ids, posebridge, poses, sensors, services};
use crate::framing::{START_BYTE_V1, START_BYTE_V2, WireVersion, checksum, crc_extra_of};
use crate::message::Message;
use crate::signing::{FLAG_SIGNED, FrameSigner};

/// The bytes of a frame beside its payload, at most: header, checksum and signature of MAVLink 2.
const MAX_FRAME_OVERHEAD: usize = 10 + 2 + 13;

/// Encodes frames for one link.
///
/// Receivers compute losses per (system, component) and link, so an encoder belongs to one link and counts for each of
/// its senders.
#[derive(Clone, Debug)]
pub struct Encoder {
    version: WireVersion,
    sequences: BTreeMap<Address, u8>,
}

impl Encoder {
    pub fn new(version: WireVersion) -> Self {
        Self { version, sequences: BTreeMap::new() }
    }

    /// Appends one complete frame, unsigned, to `out` and returns its length.
    ///
    /// Returns 0 and appends nothing when the message has no MAVLink 1 form: ids above 255 (ODOMETRY, WHEEL_DISTANCE and
    /// our own dialect).
    pub fn encode(&mut self, from: Address, message: &Message, out: &mut Vec<u8>) -> usize {
        self.write(from, message, None, out)
    }

    /// Appends one complete frame with its signature to `out` and returns its length, signature included.
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

    /// Gives a complete frame a sender's address, its own or another, and the next sequence number of that sender on this
    /// link. Updates the checksum; nothing else changes.
    ///
    /// The checksum's seed is computed from the old checksum, so that messages of unknown dialects can be changed as
    /// well. After an error the frame is unchanged.
    pub fn readdress(&mut self, frame: &mut [u8], sender: Address) -> Result<(), RenumberError> {
        rewrite(frame, |frame, layout| {
            frame[layout.sequence_at] = self.next_sequence(sender);
            frame[layout.system_at] = sender.system.0;
            frame[layout.system_at + 1] = sender.component.0;
            Ok(())
        })
    }

    /// A forwarded frame leaves with its original sequence number: the next frame of its sender here has the number
    /// after it.
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

/// Message id and payload; `None` where the dialects have no such message.
fn payload_of(version: WireVersion, message: &Message) -> Option<(u32, Payload)> {
    Some(match message {
        Message::WheelTicks(ticks) => (ids::PB_WHEEL_TICKS, posebridge::write_ticks(version, ticks)),
        Message::Inertial(inertial) => (ids::PB_INERTIAL, posebridge::write_inertial(version, inertial)),
        Message::PlanarPose(pose) => (ids::PB_PLANAR_POSE, posebridge::write_pose(version, pose)),
        Message::FusionHealth(health) => (ids::PB_FUSION_HEALTH, posebridge::write_health(version, health)),
        Message::RobotDescription(robot) => (ids::PB_ROBOT_DESCRIPTION, posebridge::write_robot(version, robot)),
        Message::Heartbeat(heartbeat) => (ids::HEARTBEAT, services::write_heartbeat(version, *heartbeat)),
        Message::SystemTime { unix_micros, since_boot } => {
            (ids::SYSTEM_TIME, services::write_system_time(version, *unix_micros, *since_boot))
        }
        Message::TimeSync(sync) => (ids::TIMESYNC, services::write_time_sync(version, sync)),
        Message::SetMessageInterval(request) => (ids::COMMAND_LONG, services::write_interval(version, request)),
        Message::Command(command) => (ids::COMMAND_LONG, services::write_command(version, command)),
        Message::CommandInt(command) => (ids::COMMAND_INT, services::write_command_int(version, command)),
        Message::CommandAck(ack) => (ids::COMMAND_ACK, services::write_ack(version, *ack)),
        Message::StatusText { severity, text, part } => {
            (ids::STATUSTEXT, services::write_status_text(version, *severity, text, *part))
        }
        Message::ParamRequestList { target } => {
            (ids::PARAM_REQUEST_LIST, services::write_param_request_list(version, *target))
        }
        Message::ParamRequestRead { target, name, index } => {
            (ids::PARAM_REQUEST_READ, services::write_param_request_read(version, *target, name, *index))
        }
        Message::ParamSet { target, name, value } => {
            (ids::PARAM_SET, services::write_param_set(version, *target, name, *value))
        }
        Message::ParamSetUnsupported { target, name, kind } => {
            (ids::PARAM_SET, services::write_param_set_unsupported(version, *target, name, *kind))
        }
        Message::ParamValue { name, value, count, index } => {
            (ids::PARAM_VALUE, services::write_param_value(version, name, *value, *count, *index))
        }
        Message::AutopilotVersion(message) => {
            (ids::AUTOPILOT_VERSION, services::write_autopilot_version(version, *message))
        }
        Message::ProtocolVersion(message) => {
            (ids::PROTOCOL_VERSION, services::write_protocol_version(version, *message))
        }
        Message::ComponentInformation(message) => {
            (ids::COMPONENT_INFORMATION_BASIC, services::write_component_information(version, message))
        }
        Message::MessageInterval(message) => {
            (ids::MESSAGE_INTERVAL, services::write_message_interval(version, *message))
        }
        Message::NamedValue(message) => (ids::NAMED_VALUE_FLOAT, services::write_named_value(version, message)),
        Message::FloatArray(message) => (ids::DEBUG_FLOAT_ARRAY, services::write_float_array(version, message)),
        Message::WheelDistance { stamp, left, right } => {
            (ids::WHEEL_DISTANCE, sensors::write_wheel_distance(version, *stamp, *left, *right))
        }
        Message::ScaledImu(imu) => (ids::SCALED_IMU, sensors::write_scaled(version, imu)),
        Message::HighresImu(imu) => (ids::HIGHRES_IMU, sensors::write_highres(version, imu)),
        Message::DistanceSensor { stamp, range, sigma } => {
            (ids::DISTANCE_SENSOR, sensors::write_distance(version, *stamp, *range, *sigma))
        }
        Message::Thermometer { stamp, channel, temperature } => {
            sensors::write_thermometer(version, *stamp, channel, *temperature)
        }
        // The dialects have none; it comes from bricks with protocols of their own.
        Message::Compass { .. } => return None,
        Message::VisionPosition(fix) => (ids::VISION_POSITION_ESTIMATE, poses::write_vision(version, fix)),
        Message::MocapPosition(fix) => (ids::ATT_POS_MOCAP, poses::write_mocap(version, fix)),
        Message::Odometry(odometry) => (ids::ODOMETRY, poses::write_odometry(version, odometry)),
        Message::LocalPosition { stamp, x, y, x_speed, y_speed } => {
            (ids::LOCAL_POSITION_NED, poses::write_local_position(version, *stamp, *x, *y, *x_speed, *y_speed))
        }
        Message::Attitude { stamp, heading, turn_rate } => {
            (ids::ATTITUDE, poses::write_attitude(version, *stamp, *heading, *turn_rate))
        }
        Message::EstimatorStatus(status) => (ids::ESTIMATOR_STATUS, poses::write_estimator_status(version, status)),
    })
}

/// Changes a complete, unsigned frame and updates its checksum. The checksum's seed is computed from the old checksum, so
/// that messages of unknown dialects can be changed as well. After an error the frame is unchanged.
pub(crate) fn rewrite(
    frame: &mut [u8],
    change: impl FnOnce(&mut [u8], &FrameLayout) -> Result<(), RenumberError>,
) -> Result<(), RenumberError> {
    let layout = FrameLayout::parse(frame).ok_or(RenumberError::NoFrame)?;
    if layout.is_signed {
        return Err(RenumberError::Signed);
    }
    let end = layout.end;
    let body = frame.get(1..end).ok_or(RenumberError::NoFrame)?;
    let sum = match frame.get(end..end + 2) {
        Some(&[low, high]) => u16::from_le_bytes([low, high]),
        _ => return Err(RenumberError::NoFrame),
    };
    let crc_extra = crc_extra_of(body, sum).ok_or(RenumberError::Damaged)?;
    change(frame, &layout)?;
    let sum = checksum(&frame[1..end], crc_extra);
    frame[end..end + 2].copy_from_slice(&sum.to_le_bytes());
    Ok(())
}

/// Why a frame was not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RenumberError {
    #[error("the bytes are no whole frame")]
    NoFrame,
    /// Only a holder of the key may change it.
    #[error("the frame is signed, and only its sender can sign it anew")]
    Signed,
    /// No CRC_EXTRA gives its checksum, so a new one cannot be computed.
    #[error("the frame's checksum is right for no message")]
    Damaged,
}

/// Whether a complete frame has a signature; false for other bytes.
pub fn is_signed(frame: &[u8]) -> bool {
    FrameLayout::parse(frame).is_some_and(|layout| layout.is_signed)
}

pub(crate) struct FrameLayout {
    pub(crate) sequence_at: usize,
    /// Offset of the sender's system; the component follows it.
    pub(crate) system_at: usize,
    pub(crate) payload_at: usize,
    /// Offset of the payload's end, where the checksum begins.
    pub(crate) end: usize,
    is_signed: bool,
}

impl FrameLayout {
    pub(crate) fn parse(frame: &[u8]) -> Option<Self> {
        match *frame {
            [START_BYTE_V2, len, flags, _, _, _, _, ..] => Some(Self {
                sequence_at: 4,
                system_at: 5,
                payload_at: 10,
                end: 10 + usize::from(len),
                is_signed: flags & FLAG_SIGNED != 0,
            }),
            [START_BYTE_V1, len, _, _, _, ..] => {
                Some(Self { sequence_at: 2, system_at: 3, payload_at: 6, end: 6 + usize::from(len), is_signed: false })
            }
            _ => None,
        }
    }
}

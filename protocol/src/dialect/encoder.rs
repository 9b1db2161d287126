//! Encodes messages to frames with the sequence numbers of one link, and rewrites frames of others.

use std::collections::BTreeMap;

use mavlink_core::utils::remove_trailing_zeroes;
use posebridge_telemetry::Address;

use super::catalogue::CATALOGUE;
use super::payload::Payload;
use super::services::PARAM_TYPE_REAL32;
use super::{posebridge, poses, sensors, services, vehicle, vehicle_state};
use crate::framing::{FrameHeader, START_BYTE_V1, START_BYTE_V2, WireVersion, checksum, crc_extra_of};
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
        let Some(payload) = payload_of(message) else {
            return 0;
        };
        let message_id = payload.message_id;
        let Some(shape) = CATALOGUE.layout(message_id) else {
            return 0;
        };
        let payload = match self.version {
            // Without extension fields, and with the zeros at its end.
            WireVersion::V1 => &payload.bytes[..usize::from(shape.max_len_v1)],
            WireVersion::V2 => {
                let len = remove_trailing_zeroes(&payload.bytes[..usize::from(shape.max_len_v2)]);
                &payload.bytes[..len]
            }
        };
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
        rewrite(frame, |frame, header| {
            let at = header.sequence_at();
            frame[at..at + 3].copy_from_slice(&[self.next_sequence(sender), sender.system.0, sender.component.0]);
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

/// `None` where the dialects have no such message.
fn payload_of(message: &Message) -> Option<Payload> {
    Some(match message {
        Message::WheelTicks(ticks) => posebridge::write_ticks(ticks),
        Message::Inertial(inertial) => posebridge::write_inertial(inertial),
        Message::PlanarPose(pose) => posebridge::write_pose(pose),
        Message::FusionHealth(health) => posebridge::write_health(health),
        Message::RobotDescription(robot) => posebridge::write_robot(robot),
        Message::Heartbeat(heartbeat) => services::write_heartbeat(*heartbeat),
        Message::SystemTime { unix_micros, since_boot } => services::write_system_time(*unix_micros, *since_boot),
        Message::TimeSync(sync) => services::write_time_sync(sync),
        Message::SetMessageInterval(request) => services::write_interval(request),
        Message::Command(command) => services::write_command(command),
        Message::CommandInt(command) => services::write_command_int(command),
        Message::CommandAck(ack) => services::write_ack(*ack),
        Message::StatusText { severity, text, part } => services::write_status_text(*severity, text, *part),
        Message::ParamRequestList { target } => services::write_param_request_list(*target),
        Message::ParamRequestRead { target, name, index } => services::write_param_request_read(*target, name, *index),
        Message::ParamSet { target, name, value } => {
            services::write_param_set(*target, name, *value, PARAM_TYPE_REAL32)
        }
        // The value has an unreadable type, so none is written.
        Message::ParamSetUnsupported { target, name, kind } => services::write_param_set(*target, name, 0.0, *kind),
        Message::ParamValue { name, value, count, index } => services::write_param_value(name, *value, *count, *index),
        Message::AutopilotVersion(message) => services::write_autopilot_version(*message),
        Message::ProtocolVersion(message) => services::write_protocol_version(*message),
        Message::ComponentInformation(message) => services::write_component_information(message),
        Message::MessageInterval(message) => services::write_message_interval(*message),
        Message::NamedValue(message) => services::write_named_value(message),
        Message::FloatArray(message) => services::write_float_array(message),
        Message::ParamHash { hash, count } => services::write_param_hash(*hash, *count),
        Message::Plan(message) => vehicle::write_plan(message),
        Message::MissionItem(item) => vehicle::write_item(item),
        Message::MissionItemReached { sequence } => vehicle::write_item_reached(*sequence),
        Message::MissionCurrent(current) => vehicle::write_mission_current(*current),
        Message::FileTransfer(message) => vehicle::write_file_transfer(message),
        Message::Log(message) => vehicle::write_log(message),
        Message::AvailableMode(mode) => vehicle::write_available_mode(mode),
        Message::ComponentMetadata(message) => vehicle::write_component_metadata(message),
        Message::WheelDistance { stamp, left, right } => sensors::write_wheel_distance(*stamp, *left, *right),
        Message::Imu(imu) => sensors::write_imu(imu),
        Message::WheelSpeeds { left, right } => sensors::write_wheel_speeds(*left, *right),
        Message::GnssFix(fix) => poses::write_gnss_fix(fix),
        Message::GlobalPosition(position) => vehicle_state::write_global_position(position),
        Message::HomePosition(home) => vehicle_state::write_home_position(home),
        Message::GlobalOrigin(origin) => vehicle_state::write_global_origin(origin),
        Message::SetGlobalOrigin(request) => vehicle_state::write_set_global_origin(request),
        Message::HeadUpDisplay(display) => vehicle_state::write_head_up_display(display),
        Message::AttitudeQuaternion(attitude) => vehicle_state::write_attitude_quaternion(attitude),
        Message::SystemStatus(status) => vehicle_state::write_system_status(status),
        Message::BatteryStatus(battery) => vehicle_state::write_battery_status(battery),
        Message::OnGround => vehicle_state::write_on_ground(),
        Message::ManualControl(control) => vehicle_state::write_manual_control(control),
        Message::PositionTarget(request) => vehicle_state::write_position_target(request),
        Message::LandmarkSighting(sighting) => poses::write_landing_target(sighting),
        Message::DistanceSensor { stamp, range, sigma } => sensors::write_distance(*stamp, *range, *sigma),
        Message::Thermometer { stamp, channel, temperature } => {
            sensors::write_thermometer(*stamp, channel, *temperature)
        }
        // The dialects have none; it comes from bricks with protocols of their own.
        Message::Compass { .. } => return None,
        Message::VisionPosition(fix) => poses::write_vision(fix),
        Message::MocapPosition(fix) => poses::write_mocap(fix),
        Message::Odometry(odometry) => poses::write_odometry(odometry),
        Message::LocalPosition { stamp, x, y, x_speed, y_speed } => {
            poses::write_local_position(*stamp, *x, *y, *x_speed, *y_speed)
        }
        Message::Attitude { stamp, heading, turn_rate } => poses::write_attitude(*stamp, *heading, *turn_rate),
        Message::EstimatorStatus(status) => poses::write_estimator_status(status),
    })
}

/// Changes a complete, unsigned frame and updates its checksum. The checksum's seed is computed from the old checksum, so
/// that messages of unknown dialects can be changed as well. After an error the frame is unchanged.
pub(crate) fn rewrite(
    frame: &mut [u8],
    change: impl FnOnce(&mut [u8], &FrameHeader) -> Result<(), RenumberError>,
) -> Result<(), RenumberError> {
    let header = FrameHeader::parse(frame).ok_or(RenumberError::NoFrame)?;
    if header.is_signed() {
        return Err(RenumberError::Signed);
    }
    if frame.len() < header.total {
        return Err(RenumberError::NoFrame);
    }
    let (body, sum) = header.covered(frame);
    let crc_extra = crc_extra_of(body, sum).ok_or(RenumberError::Damaged)?;
    change(frame, &header)?;
    let end = header.end();
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
    FrameHeader::parse(frame).is_some_and(|header| header.is_signed())
}

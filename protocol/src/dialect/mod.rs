//! Frames to messages, and back.
//!
//! Gets verified frames from [`crate::framing`], gives [`Message`]s in SI units and our spaces, and the other way round.
//! North-east-down, forward-right-down, scaled integers and NaN-for-unknown end here. It keeps no state but the sequence
//! counters of an [`Encoder`], and does not judge plausibility beyond "is a number".
//!
//! Rules that hold for every message: integers saturate when a value does not fit, totals and stamps wrap, a stamp of
//! another resolution is converted, text is cut at a character, floats keep the width of the wire.

pub(crate) mod catalogue;
pub mod commands;
mod component;
mod conversation;
mod encoder;
mod foreign;
#[expect(warnings, reason = "generated code, out of our hands; it is checked by golden bytes")]
pub(crate) mod generated;
pub mod ids;
mod own;
mod payload;
mod poses;
mod sensors;
pub(crate) mod spaces;

pub use catalogue::message_name;
pub use encoder::{Encoder, RenumberError, is_signed};
pub use ids::{MESSAGES, MessageInfo};

use crate::framing::FrameRef;
use crate::message::{Message, WireStamp};

/// Why the payload of a verified frame makes no sense.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PayloadError {
    /// A number that must be finite is not.
    #[error("message {message_id}: {field} is {value}, it must be finite")]
    NotFinite {
        /// The message's id.
        message_id: u32,
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A temperature that no matter has.
    #[error(
        "message {message_id}: a temperature of {degrees_c} degrees Celsius is below absolute zero or above the range of any sensor"
    )]
    Temperature {
        /// The message's id.
        message_id: u32,
        /// The value.
        degrees_c: f64,
    },
    /// ODOMETRY in a coordinate frame that has no counterpart here.
    #[error(
        "message {message_id}: no conversion from MAV_FRAME {frame}; send 1, 4, 14 to 17, 20 or 21 with child 8, 12 or 13"
    )]
    Space {
        /// The message's id.
        message_id: u32,
        /// MAV_FRAME of the pose or of the speeds.
        frame: u8,
    },
    /// ODOMETRY whose sender says that it has failed.
    #[error("message {message_id}: its quality is negative, the sender says that it has failed")]
    Failed {
        /// The message's id.
        message_id: u32,
    },
    /// WHEEL_DISTANCE for fewer than two wheels.
    #[error("message {message_id}: {count} wheels, at least 2 are needed")]
    TooFewWheels {
        /// The message's id.
        message_id: u32,
        /// How many wheels it has.
        count: u8,
    },
    /// The generated type cannot be read from the payload.
    #[error("message {message_id}: the payload does not fit its definition")]
    Layout {
        /// The message's id.
        message_id: u32,
        /// What the generated code says.
        source: mavlink_core::error::ParserError,
    },
}

impl PayloadError {
    /// The message's id.
    #[must_use]
    pub const fn message_id(&self) -> u32 {
        match *self {
            Self::NotFinite { message_id, .. }
            | Self::Temperature { message_id, .. }
            | Self::Space { message_id, .. }
            | Self::Failed { message_id }
            | Self::TooFewWheels { message_id, .. }
            | Self::Layout { message_id, .. } => message_id,
        }
    }
}

/// What one payload decodes to: `None` when the message is known and of no use here.
type Decoded = Result<Option<Message>, PayloadError>;

/// Decodes a verified frame.
///
/// `None` means that the message is of no use here: an id without a row in [`MESSAGES`], a range finder that looks
/// sideways, a reading that its sender marks as invalid, an integer parameter.
///
/// # Errors
/// A [`PayloadError`] when the frame is whole but its content makes no sense.
pub fn decode(frame: &FrameRef<'_>) -> Result<Option<Message>, PayloadError> {
    let payload = frame.payload;
    match frame.message_id {
        ids::HEARTBEAT => Ok(Some(conversation::heartbeat(payload))),
        ids::SYSTEM_TIME => conversation::system_time(payload),
        ids::PARAM_REQUEST_READ => conversation::param_request_read(payload),
        ids::PARAM_REQUEST_LIST => conversation::param_request_list(payload),
        ids::PARAM_VALUE => Ok(conversation::param_value(payload)),
        ids::PARAM_SET => Ok(Some(conversation::param_set(payload))),
        ids::COMMAND_INT => Ok(Some(conversation::command_int(payload))),
        ids::COMMAND_LONG => Ok(Some(conversation::command_long(payload))),
        ids::COMMAND_ACK => Ok(Some(conversation::command_ack(payload))),
        ids::TIMESYNC => conversation::time_sync(payload),
        ids::STATUSTEXT => Ok(Some(conversation::status_text(payload))),
        ids::AUTOPILOT_VERSION => Ok(Some(component::autopilot_version(payload))),
        ids::PROTOCOL_VERSION => Ok(Some(component::protocol_version(payload))),
        ids::COMPONENT_INFORMATION_BASIC => Ok(Some(component::component_information(payload))),
        ids::MESSAGE_INTERVAL => Ok(Some(component::message_interval(payload))),
        ids::DEBUG_FLOAT_ARRAY => Ok(Some(component::float_array(payload))),
        ids::SCALED_IMU => sensors::scaled_imu(payload),
        ids::SCALED_PRESSURE => sensors::scaled_pressure(payload),
        ids::NAMED_VALUE_FLOAT => sensors::named_value(payload),
        ids::HIGHRES_IMU => sensors::highres_imu(payload),
        ids::DISTANCE_SENSOR => Ok(sensors::distance_sensor(payload)),
        ids::WHEEL_DISTANCE => sensors::wheel_distance(payload),
        ids::ATTITUDE => poses::attitude(payload),
        ids::LOCAL_POSITION_NED => poses::local_position(payload),
        ids::VISION_POSITION_ESTIMATE => poses::vision_position(payload),
        ids::ATT_POS_MOCAP => poses::mocap_position(payload),
        ids::ESTIMATOR_STATUS => poses::estimator_status(payload),
        ids::ODOMETRY => poses::odometry(payload),
        ids::PB_WHEEL_TICKS => own::wheel_ticks(payload),
        ids::PB_INERTIAL => own::inertial(payload),
        ids::PB_PLANAR_POSE => own::planar_pose(payload),
        ids::PB_FUSION_HEALTH => own::fusion_health(payload),
        ids::PB_ROBOT_DESCRIPTION => own::robot_description(payload),
        _ => Ok(None),
    }
}

/// The instant of its sender's clock of which a verified frame speaks; `None` if it speaks of none or makes no sense.
#[must_use]
pub fn stamp_of(frame: &FrameRef<'_>) -> Option<WireStamp> {
    match frame.message_id {
        // The commonest without one need not be decoded for it.
        ids::HEARTBEAT | ids::TIMESYNC | ids::COMMAND_INT | ids::COMMAND_LONG | ids::COMMAND_ACK | ids::STATUSTEXT => {
            None
        }
        // Neither need what is said most often.
        ids::PB_WHEEL_TICKS => Some(own::ticks_of(frame.payload).ok().flatten()?.stamp),
        ids::PB_INERTIAL => Some(own::inertial_of(frame.payload).ok()?.stamp),
        _ => decode(frame).ok().flatten()?.stamp(),
    }
}

/// The value, if it is finite.
fn finite(message_id: u32, field: &'static str, value: f64) -> Result<f64, PayloadError> {
    if value.is_finite() { Ok(value) } else { Err(PayloadError::NotFinite { message_id, field, value }) }
}

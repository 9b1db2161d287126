//! Why a payload cannot be decoded.

use crate::message::Message;

/// Why the payload of a verified frame is invalid.
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
    UnknownFrame {
        /// The message's id.
        message_id: u32,
        /// MAV_FRAME of the pose or of the speeds.
        frame: u8,
    },
    /// ODOMETRY whose sender says that it has failed.
    #[error("message {message_id}: its quality is negative, the sender says that it has failed")]
    SenderFailed {
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
    pub const fn message_id(&self) -> u32 {
        match *self {
            Self::NotFinite { message_id, .. }
            | Self::Temperature { message_id, .. }
            | Self::UnknownFrame { message_id, .. }
            | Self::SenderFailed { message_id }
            | Self::TooFewWheels { message_id, .. }
            | Self::Layout { message_id, .. } => message_id,
        }
    }
}

/// What one payload decodes to: `None` when the message is known and of no use here.
pub(super) type Decoded = Result<Option<Message>, PayloadError>;

/// The value, if it is finite.
pub(super) fn require_finite(message_id: u32, field: &'static str, value: f64) -> Result<f64, PayloadError> {
    if value.is_finite() { Ok(value) } else { Err(PayloadError::NotFinite { message_id, field, value }) }
}

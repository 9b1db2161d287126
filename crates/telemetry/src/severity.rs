//! Severities of texts, as in MAVLink's STATUSTEXT (MAV_SEVERITY).

/// MAV_SEVERITY_ERROR.
pub const ERROR: u8 = 3;
/// MAV_SEVERITY_WARNING.
pub const WARNING: u8 = 4;
/// MAV_SEVERITY_NOTICE.
pub const NOTICE: u8 = 5;
/// MAV_SEVERITY_INFO.
pub const INFO: u8 = 6;

//! Severities of texts, as in MAVLink's STATUSTEXT (MAV_SEVERITY).

/// MAV_SEVERITY_ERROR.
pub(crate) const SEVERITY_ERROR: u8 = 3;
/// MAV_SEVERITY_WARNING.
pub(crate) const SEVERITY_WARNING: u8 = 4;
/// MAV_SEVERITY_NOTICE.
pub(crate) const SEVERITY_NOTICE: u8 = 5;
/// MAV_SEVERITY_INFO.
pub(crate) const SEVERITY_INFO: u8 = 6;

//! Severities of texts, as in MAVLink's STATUSTEXT (MAV_SEVERITY).

pub const ERROR: u8 = 3;
pub const WARNING: u8 = 4;
pub const NOTICE: u8 = 5;
pub const INFO: u8 = 6;
pub const DEBUG: u8 = 7;

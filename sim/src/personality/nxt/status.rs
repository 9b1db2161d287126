//! The status bytes of the NXT's firmware, as its protocol documents list them.

/// Done.
pub(super) const OK: u8 = 0x00;
/// The I2C transaction is still under way.
pub(super) const PENDING: u8 = 0x20;
/// The mailbox is empty.
pub(super) const MAILBOX_EMPTY: u8 = 0x40;
/// There is no such module.
pub(super) const MODULE_NOT_FOUND: u8 = 0x90;
/// The IO map has no such bytes, or more are asked for than fit into a telegram.
pub(super) const OUT_OF_BOUNDS: u8 = 0x91;
/// The request could not be followed, for instance for want of a program of that name.
pub(super) const REQUEST_FAILED: u8 = 0xBD;
/// There is no such command.
pub(super) const UNKNOWN_OPCODE: u8 = 0xBE;
/// The telegram has another length than its command.
pub(super) const INSANE_PACKET: u8 = 0xBF;
/// A number is out of its range.
pub(super) const OUT_OF_RANGE: u8 = 0xC0;
/// No device answers on the I2C bus.
pub(super) const BUS_ERROR: u8 = 0xDD;
/// The port is not set up for I2C.
pub(super) const CHANNEL_NOT_CONFIGURED: u8 = 0xE0;
/// No program is running.
pub(super) const NO_ACTIVE_PROGRAM: u8 = 0xEC;
/// The size makes no sense.
pub(super) const ILLEGAL_SIZE: u8 = 0xED;
/// There is no such mailbox.
pub(super) const ILLEGAL_MAILBOX: u8 = 0xEE;

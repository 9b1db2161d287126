//! The length of a frame, from its header.

/// Start of a MAVLink 2 frame.
const START_V2: u8 = 0xFD;
/// Start of a MAVLink 1 frame.
const START_V1: u8 = 0xFE;
/// Header and checksum of a MAVLink 2 frame.
const ENVELOPE_V2_BYTES: usize = 12;
/// Header and checksum of a MAVLink 1 frame.
const ENVELOPE_V1_BYTES: usize = 8;
/// Bytes of a signature.
const SIGNATURE_BYTES: usize = 13;
/// Incompatibility flag of MAVLink 2: a signature follows.
const FLAG_SIGNED: u8 = 0x01;

/// The longest frame that there can be.
pub(super) const MAX_FRAME_BYTES: usize = ENVELOPE_V2_BYTES + 255 + SIGNATURE_BYTES;

/// Whether a frame may begin with this byte.
pub(super) const fn is_start(byte: u8) -> bool {
    matches!(byte, START_V1 | START_V2)
}

/// The bytes of the frame that begins `bytes`; `None` if none begins there, or it is not whole.
#[inline]
pub(super) fn split_frame(bytes: &[u8]) -> Option<&[u8]> {
    let length = match *bytes {
        [START_V2, payload, flags, ..] => {
            let signature = if flags & FLAG_SIGNED == 0 { 0 } else { SIGNATURE_BYTES };
            ENVELOPE_V2_BYTES + usize::from(payload) + signature
        }
        [START_V1, payload, ..] => ENVELOPE_V1_BYTES + usize::from(payload),
        _ => return None,
    };
    bytes.get(..length)
}

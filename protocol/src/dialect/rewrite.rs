//! Changes in whole frames of others: their checksum follows.

use crate::framing::{START_BYTE_V1, START_BYTE_V2, checksum, crc_extra_of};
use crate::signing::FLAG_SIGNED;

/// Changes a whole, unsigned frame and makes its checksum right. The checksum's seed is found from the old checksum, so that messages of
/// no dialect can be changed as well.
///
/// # Errors
/// A frame that cannot be changed stays as it is.
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
    /// The bytes are no whole frame.
    #[error("the bytes are no whole frame")]
    NoFrame,
    /// It is signed: only who has the key may change it.
    #[error("the frame is signed, and only its sender can sign it anew")]
    Signed,
    /// No CRC_EXTRA makes its checksum right, so no right one can be given to it.
    #[error("the frame's checksum is right for no message")]
    Damaged,
}

/// Whether a whole frame bears a signature; false of what is no frame.
pub fn is_signed(frame: &[u8]) -> bool {
    FrameLayout::parse(frame).is_some_and(|layout| layout.is_signed)
}

/// Where in a frame that is to be changed the parts stand.
pub(crate) struct FrameLayout {
    pub(crate) sequence_at: usize,
    /// Where the sender's system stands; the component follows it.
    pub(crate) system_at: usize,
    pub(crate) payload_at: usize,
    /// Where the payload ends and the checksum begins.
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

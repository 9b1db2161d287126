//! The checksum of MAVLink: CRC-16/MCRF4XX.

use crc::{CRC_16_MCRF4XX, Crc, Table};

/// Sixteen bytes per step, because receiving spends almost all its time here.
static MCRF4XX: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_MCRF4XX);

/// The checksum of a frame: over `bytes` (everything between the start byte and the checksum), then over the message's
/// CRC_EXTRA.
pub fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    let mut digest = MCRF4XX.digest();
    digest.update(bytes);
    digest.update(&[crc_extra]);
    digest.finalize()
}

/// The CRC_EXTRA with which `bytes` have this checksum; `None` if there is none. There is never more than one, because
/// the last step of the checksum maps every byte to another remainder.
pub(crate) fn crc_extra_of(bytes: &[u8], sum: u16) -> Option<u8> {
    let mut before = MCRF4XX.digest();
    before.update(bytes);
    (0..=u8::MAX).find(|extra| {
        let mut digest = before.clone();
        digest.update(&[*extra]);
        digest.finalize() == sum
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The check value of the CRC catalogue (Greg Cook, reveng) is the sum of "123456789".
    #[test]
    fn the_sum_has_the_published_check_value_and_its_last_byte_is_found_again() {
        assert_eq!(checksum(b"12345678", b'9'), 0x6F91);
        assert_eq!(crc_extra_of(b"12345678", 0x6F91), Some(b'9'));
    }
}

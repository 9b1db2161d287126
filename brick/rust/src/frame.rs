//! Frames: the checksum, the ids, and the one way in which a payload becomes bytes.

/// Start byte of a MAVLink 2 frame.
pub(crate) const START: u8 = 0xFD;
/// Start, length, two flag bytes, sequence, system, component, three bytes of id.
pub(crate) const HEADER: usize = 10;
/// Bytes of the checksum.
pub(crate) const CHECKSUM: usize = 2;
/// Longest payload that is sent: PB_ROBOT_DESCRIPTION.
const LONGEST_SENT: usize = 40;

/// What stands for a message on the wire. `CRC_EXTRA` is a hash of its definition, computed by mavgen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Kind {
    /// 24 bits.
    pub(crate) id: u32,
    /// Ends the checksum, so that two definitions of one message do not understand each other.
    pub(crate) crc_extra: u8,
    /// Bytes of the whole payload.
    pub(crate) length: u8,
}

pub(crate) const HEARTBEAT: Kind = kind(0, 50, 9);
pub(crate) const TIMESYNC: Kind = kind(111, 34, 18);
pub(crate) const BATTERY: Kind = kind(147, 154, 36);
pub(crate) const WHEEL_TICKS: Kind = kind(42_100, 170, 13);
pub(crate) const INERTIAL: Kind = kind(42_101, 94, 15);
pub(crate) const PLANAR_POSE: Kind = kind(42_102, 53, 56);
pub(crate) const ROBOT_DESCRIPTION: Kind = kind(42_104, 5, 40);

const fn kind(id: u32, crc_extra: u8, length: u8) -> Kind {
    Kind { id, crc_extra, length }
}

/// One step of CRC-16/MCRF4XX without a table.
pub(crate) const fn crc_step(crc: u16, byte: u8) -> u16 {
    let mut x = byte ^ crc as u8;
    x ^= x << 4;
    let x = x as u16;
    (crc >> 8) ^ (x << 8) ^ (x << 3) ^ (x >> 4)
}

/// The checksum over bytes and then CRC_EXTRA.
pub(crate) fn checksum(bytes: &[u8], crc_extra: u8) -> u16 {
    let sum = bytes.iter().fold(0xFFFF, |crc, byte| crc_step(crc, *byte));
    crc_step(sum, crc_extra)
}

/// A payload under construction; fields are put in the order of the wire.
pub(crate) struct Payload {
    bytes: [u8; LONGEST_SENT],
    length: usize,
}

impl Payload {
    pub(crate) const fn new() -> Self {
        Self { bytes: [0; LONGEST_SENT], length: 0 }
    }

    /// Appends a field. What would not fit is left out; no message here is that long.
    pub(crate) fn put<const N: usize>(mut self, field: [u8; N]) -> Self {
        let end = self.length + N;
        if let Some(place) = self.bytes.get_mut(self.length..end) {
            place.copy_from_slice(&field);
            self.length = end;
        }
        self
    }

    /// Without the zeros at its end, but never empty.
    fn trimmed(&self) -> &[u8] {
        let filled = self.bytes.get(..self.length).unwrap_or_default();
        let last = filled.iter().rposition(|byte| *byte != 0);
        filled.get(..=last.unwrap_or(0)).unwrap_or_default()
    }
}

/// Who sends, and the number of the frame.
#[derive(Clone, Copy)]
pub(crate) struct Origin {
    pub(crate) sequence: u8,
    pub(crate) system: u8,
    pub(crate) component: u8,
}

/// A finished frame.
pub(crate) struct Frame {
    bytes: [u8; HEADER + LONGEST_SENT + CHECKSUM],
    length: usize,
}

impl Frame {
    pub(crate) fn new(kind: Kind, origin: Origin, payload: &Payload) -> Self {
        let payload = payload.trimmed();
        let [id0, id1, id2, _] = kind.id.to_le_bytes();
        let mut frame = Self { bytes: [0; HEADER + LONGEST_SENT + CHECKSUM], length: 0 };
        frame.append(&[START, payload.len() as u8, 0, 0, origin.sequence]);
        frame.append(&[origin.system, origin.component, id0, id1, id2]);
        frame.append(payload);
        let summed = frame.as_bytes().get(1..).unwrap_or_default();
        let sum = checksum(summed, kind.crc_extra);
        frame.append(&sum.to_le_bytes());
        frame
    }

    pub(crate) fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.length).unwrap_or_default()
    }

    fn append(&mut self, bytes: &[u8]) {
        let end = self.length + bytes.len();
        if let Some(place) = self.bytes.get_mut(self.length..end) {
            place.copy_from_slice(bytes);
            self.length = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_has_the_published_check_value() {
        // CRC-16/MCRF4XX of "123456789" (reveng catalogue), before any CRC_EXTRA.
        let sum = b"123456789".iter().fold(0xFFFF, |crc, byte| crc_step(crc, *byte));
        assert_eq!(sum, 0x6F91);
    }

    #[test]
    fn a_payload_of_zeros_keeps_one_byte_and_a_full_one_takes_no_more() {
        assert_eq!(Payload::new().put([0; 8]).trimmed(), [0]);
        assert_eq!(Payload::new().put([7, 0, 0]).trimmed(), [7]);
        let full = Payload::new().put([1; LONGEST_SENT]).put([2]);
        assert_eq!(full.trimmed(), [1; LONGEST_SENT]);
    }
}

//! The status byte of a reply, with its meaning for people.
//!
//! # Sources
//! LEGO MINDSTORMS NXT Bluetooth Developer Kit, appendix 2 (direct commands, "Error message back to the host") and
//! appendix 1 (file errors).

/// What became of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NxtStatus(pub u8);

impl NxtStatus {
    /// It was done.
    pub const OK: Self = Self(0x00);
    /// The sensor has not answered yet.
    pub const PENDING: Self = Self(0x20);
    /// Mailboxes are not read: no program runs.
    pub const NO_PROGRAM: Self = Self(0xEC);

    /// True for a byte that the firmware knows as a status.
    pub const fn is_known(self) -> bool {
        matches!(
            self.0,
            0x00 | 0x20 | 0x40 | 0x81..=0x93 | 0xBD..=0xC0 | 0xDD..=0xE0 | 0xEC..=0xF0 | 0xFB | 0xFF
        )
    }

    /// What it means, and what can be done about it; lower case, no full stop.
    pub const fn meaning(self) -> &'static str {
        match self.0 {
            0x00 => "it was done",
            0x20 => "the sensor is still busy with the last question",
            0x40 => "the mailbox is empty",
            0x81..=0x90 | 0x92..=0x93 => "the file or module is not there or in use",
            0x91 => "more bytes were asked for than this firmware has",
            0xBD => "the brick could not do it",
            0xBE => "this firmware does not know the command",
            0xBF => "the brick found no sense in the command",
            0xC0 => "a value of the command is out of range",
            0xDD => "the sensor does not answer: is it plugged in, and is it the configured one?",
            0xDE => "the brick's buffer is full",
            0xDF => "there is no such channel",
            0xE0 => "the port is not set up for such a sensor, or is busy",
            0xEC => "no program runs on the brick",
            0xED => "the size is not allowed",
            0xEE => "there is no such mailbox",
            0xEF => "there is no such field",
            0xF0 => "there is no such port",
            0xFB => "the brick has no memory left",
            0xFF => "the brick does not accept the arguments",
            _ => "the brick gives a reason that nobody knows",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_known_status_has_words_of_its_own_kind() {
        let unknown = NxtStatus(0x01).meaning();
        for byte in 0..=u8::MAX {
            let status = NxtStatus(byte);
            assert_eq!(status.is_known(), status.meaning() != unknown, "{byte:02x}");
        }
        assert!(NxtStatus::NO_PROGRAM.meaning().contains("no program"));
        assert!(NxtStatus(0xDD).meaning().contains("plugged in"));
        assert!(NxtStatus(0xBE).meaning().contains("does not know"));
    }
}

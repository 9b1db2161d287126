//! The announcement of an EV3 in the network.

/// Longest announcement; real ones have some 70 bytes.
pub(super) const MAX_ANNOUNCEMENT_BYTES: usize = 512;

/// A brick that announced itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Announcement {
    /// Twelve hexadecimal digits, required to open the brick.
    pub(super) serial_number: String,
    /// The TCP port on which it listens.
    pub(super) port: u16,
    /// The name that its user gave it; empty if it has none.
    pub(super) name: String,
}

impl Announcement {
    /// Parses a datagram; `None` if it is not from an EV3.
    pub(super) fn parse(datagram: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(datagram.get(..MAX_ANNOUNCEMENT_BYTES).unwrap_or(datagram)).ok()?;
        let value_of = |wanted: &str| {
            let pairs = text.lines().filter_map(|line| line.split_once(':'));
            let mut values = pairs.filter(|(key, _)| key.trim().eq_ignore_ascii_case(wanted));
            values.next().map(|(_, value)| value.trim())
        };
        let serial_number = value_of("Serial-Number")?;
        let is_serial_number = !serial_number.is_empty() && serial_number.bytes().all(|byte| byte.is_ascii_hexdigit());
        let is_ev3 = value_of("Protocol")? == "EV3" && is_serial_number;
        is_ev3.then_some(Self {
            serial_number: serial_number.to_owned(),
            port: value_of("Port")?.parse().ok()?,
            name: value_of("Name").unwrap_or_default().to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DATAGRAM: &[u8] = b"Serial-Number: 0016533f0c1e\r\nPort: 5555\r\nName: EV3\r\nProtocol: EV3\r\n";

    #[test]
    fn a_brick_announces_itself() {
        let expected = Announcement { serial_number: "0016533f0c1e".to_owned(), port: 5555, name: "EV3".to_owned() };
        assert_eq!(Announcement::parse(DATAGRAM), Some(expected));
    }

    #[test]
    fn what_is_no_announcement_is_none() {
        for end in 0..DATAGRAM.len() - 2 {
            assert_eq!(Announcement::parse(&DATAGRAM[..end]), None, "{end} bytes");
        }
        let text = String::from_utf8(DATAGRAM.to_vec()).unwrap();
        for (from, to) in [
            ("5555", "99999"),
            ("0016533f0c1e", "0016 53"),
            ("Protocol: EV3", "Protocol: NXT"),
            ("Serial-Number", "Serial"),
        ] {
            let other = text.replace(from, to);
            assert_eq!(Announcement::parse(other.as_bytes()), None, "{to}");
        }
        assert_eq!(Announcement::parse(&[0xFF; 70]), None);
    }
}

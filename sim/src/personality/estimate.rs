//! The estimate as it lies in the mailbox of an NXT or EV3 program.
//!
//! ```text
//! 0 u32 tick_ms    4 f32 x_m    8 f32 y_m    12 f32 heading_rad    16 f32 sigma_m    20 u8 flags    21 u8 reset_counter    22 u16 sequence
//! ```
//! Little-endian, 24 bytes. `tick_ms` is the brick's own clock; flag bit 0 says that the position is valid, bit 1 that the
//! heading is. An NXT mailbox adds a zero byte at the end, which may be there or not. NXT: inbox 0; EV3: the mailbox called
//! [`EV3_MAILBOX`].

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{Arena, Heading, Meters, Pose};

/// The NXT's inbox.
pub(super) const NXT_INBOX: u8 = 0;
/// The EV3's mailbox.
pub(super) const EV3_MAILBOX: &[u8] = b"estimate";
/// Length of the payload, in bytes.
const LENGTH: usize = 24;
/// Position and heading are valid.
const USABLE: u8 = 0b11;

/// The content of a message, if it is a usable estimate.
pub(super) fn estimate_from(message: &[u8]) -> Option<(WireStamp, Pose<Arena>)> {
    let payload = message.get(..LENGTH)?;
    let is_whole = matches!(message.get(LENGTH..), Some([] | [0]));
    let flags = *payload.get(20)?;
    if !is_whole || flags & USABLE != USABLE {
        return None;
    }
    let word = |offset: usize| Some(*payload.get(offset..)?.first_chunk::<4>()?);
    let real = |offset: usize| Some(f64::from(f32::from_le_bytes(word(offset)?)));
    let stamp = WireStamp::Millis32(u32::from_le_bytes(word(0)?));
    let (x, y, heading) = (real(4)?, real(8)?, real(12)?);
    // A heading that is no number has no place on the circle.
    let is_finite = x.is_finite() && y.is_finite() && heading.is_finite();
    is_finite.then(|| {
        let pose = Pose::new(Meters(x), Meters(y), Heading::from_rad(heading));
        (stamp, pose)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Written by hand: 1000 ms, 1.5 m, -0.5 m, 0.25 rad, sigma 0.0078125 m, flags 3, resets 7, sequence 258, and the mailbox's zero.
    const MESSAGE: [u8; 25] =
        [0xe8, 0x03, 0, 0, 0, 0, 0xc0, 0x3f, 0, 0, 0, 0xbf, 0, 0, 0x80, 0x3e, 0, 0, 0, 0x3c, 3, 7, 2, 1, 0];

    #[test]
    fn an_estimate_is_read_with_or_without_the_zero_at_its_end() {
        for message in [&MESSAGE[..], &MESSAGE[..24]] {
            let (stamp, pose) = estimate_from(message).unwrap();
            assert_eq!(stamp, WireStamp::Millis32(1_000));
            assert_eq!((pose.x.0, pose.y.0), (1.5, -0.5));
            assert_eq!(pose.heading.rad(), 0.25);
        }
    }

    #[test]
    fn what_is_short_long_invalid_or_not_finite_is_no_estimate() {
        assert_eq!(estimate_from(&MESSAGE[..23]), None);
        assert_eq!(estimate_from(&[&MESSAGE[..], &[0]].concat()), None);
        for flags in 0..3 {
            let mut message = MESSAGE;
            message[20] = flags;
            assert_eq!(estimate_from(&message), None);
        }
        let mut message = MESSAGE;
        message[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
        assert_eq!(estimate_from(&message), None);
    }
}

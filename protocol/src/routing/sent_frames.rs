//! The frames that the station sent recently, to distinguish an echo from an address conflict.
//!
//! A link may echo, and a ring of stations brings every broadcast back: that is no news. But a frame under our address that we
//! never sent comes from a sender with the same address, by default another station. Neither receives the other then, and both
//! must be warned.
//!
//! # Model
//! ```text
//! mark   checksum (16 bits), sequence number, lowest byte of the message id
//! echo   a frame from our own address whose mark is among those of our last frames, on any link
//! ```
//! A namesake's frame is taken for an echo once in 2^32 / 8192 = 524288 times.

use std::collections::VecDeque;

use crate::framing::{START_BYTE_V1, START_BYTE_V2};

/// Number of sent frames that are remembered. At a hundred frames per second on each of four links it is 20 s: longer than a frame is on
/// its way round a loop.
const MAX_SENT_FRAMES: usize = 8_192;
/// Bytes of a frame besides payload and signature: the header with its start byte, and the checksum.
const BESIDE_PAYLOAD_V1: usize = 8;
/// The same of a MAVLink 2 frame.
const BESIDE_PAYLOAD_V2: usize = 12;

/// The marks of the station's last frames.
#[derive(Clone, Debug)]
pub(super) struct SentFrameLog(VecDeque<u32>);

impl Default for SentFrameLog {
    fn default() -> Self {
        Self(VecDeque::with_capacity(MAX_SENT_FRAMES))
    }
}

impl SentFrameLog {
    /// The station says this frame.
    pub(super) fn record(&mut self, frame: &[u8]) {
        if self.0.len() == MAX_SENT_FRAMES {
            self.0.pop_front();
        }
        self.0.extend(fingerprint(frame));
    }

    /// Whether the station has said this frame.
    pub(super) fn contains(&self, frame: &[u8]) -> bool {
        fingerprint(frame).is_some_and(|mark| self.0.contains(&mark))
    }
}

/// The mark of a whole frame; `None` of what is none.
fn fingerprint(frame: &[u8]) -> Option<u32> {
    let (beside, length, sequence, id) = match *frame {
        [START_BYTE_V2, length, _, _, sequence, _, _, id, ..] => (BESIDE_PAYLOAD_V2, length, sequence, id),
        [START_BYTE_V1, length, sequence, _, _, id, ..] => (BESIDE_PAYLOAD_V1, length, sequence, id),
        _ => return None,
    };
    let (_, checksum) = frame.get(..beside + usize::from(length))?.split_last_chunk::<2>()?;
    Some(u32::from_le_bytes([checksum[0], checksum[1], sequence, id]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::Encoder;
    use crate::framing::WireVersion;
    use crate::message::{Heartbeat, Message};
    use posebridge_telemetry::Address;

    fn heartbeat(system_status: u8) -> Message {
        Message::Heartbeat(Heartbeat { vehicle_type: 18, autopilot: 8, base_mode: 0, system_status })
    }

    #[test]
    fn what_was_said_is_known_in_both_versions_and_nothing_else_is() {
        for version in [WireVersion::V1, WireVersion::V2] {
            let mut encoder = Encoder::new(version);
            let mut words = SentFrameLog::default();
            let mut next = |status| {
                let mut bytes = Vec::new();
                encoder.encode(Address::new(1, 197), &heartbeat(status), &mut bytes);
                bytes
            };
            let (first, second) = (next(4), next(4));
            words.record(&first);
            assert!(words.contains(&first), "{version:?}");
            assert!(!words.contains(&second), "{version:?}: never said");
            let other = {
                let mut bytes = Vec::new();
                let source = Address::new(1, 197);
                Encoder::new(version).encode(source, &heartbeat(3), &mut bytes);
                bytes
            };
            assert!(!words.contains(&other), "{version:?}: the same number");
        }
    }

    #[test]
    fn what_is_no_frame_is_nobody_s_word_and_the_memory_is_bounded() {
        let mut words = SentFrameLog::default();
        for torn in [&[][..], &[START_BYTE_V2; 4], &[START_BYTE_V2; 20], &[START_BYTE_V1; 7], &[0; 40]] {
            words.record(torn);
            assert!(!words.contains(torn), "{torn:?}");
        }
        let mut frame = [START_BYTE_V1, 0, 0, 1, 197, 0, 0, 0];
        for k in 0..20_000_u16 {
            [frame[6], frame[7]] = k.to_le_bytes();
            words.record(&frame);
        }
        assert!(words.contains(&frame) && words.0.len() == MAX_SENT_FRAMES);
        [frame[6], frame[7]] = [0, 0];
        assert!(!words.contains(&frame));
    }
}

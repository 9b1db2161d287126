//! Any bytes on a signed link: an accepted frame is not accepted again, nor with any of its bits flipped.

use std::collections::BTreeSet;

use posebridge_protocol::framing::{FrameRef, START_BYTE_V2};
use posebridge_protocol::signing::{
    FLAG_SIGNED, LinkSigner, RADIO_STATUS, SigningConfig, SigningState, UnsignedPolicy,
};
use posebridge_telemetry::{Address, SignatureError, Timestamp};

use super::inputs::{for_each_frame, key, start};
use crate::operands::Operands;

/// Bits of a believed frame that are turned over, spread over its length; a heartbeat has as many.
const MAX_FLIPS: usize = 264;
/// Believed frames of one input of which bits are turned over.
const MAX_FLIPPED_BITS: u32 = 3;

/// Input: key, time, one byte of options, then the bytes of a link.
pub(super) fn check(mut operands: Operands<'_>) {
    let key = key(operands.byte());
    let clock = start(operands.byte());
    let options = operands.byte();
    let unsigned = if options & 1 == 0 {
        UnsignedPolicy::RejectExcept(BTreeSet::from([RADIO_STATUS]))
    } else {
        UnsignedPolicy::Accept
    };
    let mut link = LinkSigner::new(SigningConfig {
        key,
        link_id: options >> 1,
        unsigned,
        state: SigningState { written_at: clock, clock, ..SigningState::default() },
    });
    let mut flipped = 0;
    for_each_frame(operands.remaining(), |frame| {
        if check_frame(&mut link, frame) && flipped < MAX_FLIPPED_BITS {
            flipped += 1;
            let before = link.state(Timestamp::ZERO);
            check_flips(&mut link, frame);
            assert_eq!(link.state(Timestamp::ZERO), before, "a changed frame left a trace");
        }
    });
}

/// Whether the frame was believed for its signature.
fn check_frame(link: &mut LinkSigner, frame: &FrameRef<'_>) -> bool {
    let before = link.state(Timestamp::ZERO);
    let verdict = link.verify(Timestamp::ZERO, frame);
    let after = link.state(Timestamp::ZERO);
    let is_signed =
        frame.raw.starts_with(&[START_BYTE_V2]) && frame.raw.get(2).is_some_and(|flags| flags & FLAG_SIGNED != 0);
    if verdict.is_err() || !is_signed {
        assert_eq!(before, after, "a refused or unsigned frame left a trace");
    }
    if !is_signed {
        assert!(matches!(verdict, Ok(()) | Err(SignatureError::Unsigned)));
        return false;
    }
    if verdict.is_ok() {
        assert!(after.clock >= before.clock);
        assert_eq!(link.verify(Timestamp::ZERO, frame), Err(SignatureError::Replayed));
        assert_eq!(link.state(Timestamp::ZERO), after, "a repeated frame left a trace");
    }
    verdict.is_ok()
}

/// Whoever turns bits over on the way, and mends the checksum, is not believed.
fn check_flips(link: &mut LinkSigner, frame: &FrameRef<'_>) {
    let bits = 8 * frame.raw.len();
    let mut raw = frame.raw.to_vec();
    for bit in (0..bits).step_by(bits.div_ceil(MAX_FLIPS)) {
        let (place, mask) = (bit / 8, 1 << (bit % 8));
        if place == 0 || (place == 2 && mask == FLAG_SIGNED) {
            // It is then a frame without a signature, and judged as one.
            continue;
        }
        raw[place] ^= mask;
        let changed = reread(&raw, frame);
        let verdict = link.verify(Timestamp::ZERO, &changed);
        assert_eq!(verdict, Err(SignatureError::Invalid), "bit {bit}");
        raw[place] ^= mask;
    }
}

/// The frame of changed bytes, as a framer that does not look at checksums would hand it out.
fn reread<'a>(raw: &'a [u8], whole: &FrameRef<'a>) -> FrameRef<'a> {
    let byte = |at: usize| raw.get(at).copied().unwrap_or(0);
    FrameRef {
        message_id: u32::from_le_bytes([byte(7), byte(8), byte(9), 0]),
        source: Address::new(byte(5), byte(6)),
        sequence: byte(4),
        payload: raw.get(10..10 + whole.payload.len()).unwrap_or_default(),
        raw,
        version: whole.version,
    }
}

//! Any bytes of a link: the detected protocol explains no more bytes than there are, and a known protocol has frames.

use posebridge_protocol::detect::{Protocol, recognise};

/// Input: the bytes of a link.
pub(crate) fn check(data: &[u8]) {
    let found = recognise(data);
    assert!(found.frame_bytes <= data.len(), "{found:?}");
    assert!(found.frames <= found.frame_bytes, "{found:?}");
    assert_eq!(found.protocol.is_known(), found.frames > 0, "{found:?}");
    assert_eq!(found.protocol == Protocol::NoData, data.is_empty());
}

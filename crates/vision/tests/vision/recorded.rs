//! Recorded pictures by OpenCV and ffmpeg, and what these decode from them.

use proptest::prelude::*;

pub(crate) fn worst_difference(one: &[u8], other: &[u8]) -> u8 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(one, other)| one.abs_diff(*other)).max().unwrap_or_default()
}

/// Most bytes that a decoder may hold for pictures of the largest size, those of a progressive one included.
pub(crate) const MAX_PICTURE_MEMORY: u64 = 10 * 4_928 * 4_928;

/// A file with bytes that were changed, of which a part is kept.
#[derive(Clone, Debug)]
pub(crate) struct Damage {
    changes: Vec<(usize, u8)>,
    kept: usize,
}

impl Damage {
    pub(crate) fn any() -> impl Strategy<Value = Self> {
        (prop::collection::vec((0_usize..13_000, any::<u8>()), 0..6), 0_usize..13_000)
            .prop_map(|(changes, kept)| Self { changes, kept })
    }

    pub(crate) fn apply(&self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        let length = bytes.len();
        for (at, value) in &self.changes {
            bytes[at % length] = *value;
        }
        bytes.truncate(self.kept % (2 * length));
        bytes
    }
}

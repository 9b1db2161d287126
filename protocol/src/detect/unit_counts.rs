//! Counts of whole frames, telegrams, sentences or lines.

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct UnitCounts {
    pub(super) frames: usize,
    /// Bytes of these.
    pub(super) bytes: usize,
}

impl UnitCounts {
    pub(super) const fn add(&mut self, bytes: usize) {
        self.frames += 1;
        self.bytes += bytes;
    }
}

//! Reads the operands of random operations from a fuzzer's bytes.

/// What is left of the bytes. When they are used up, numbers are zero and parts are empty: the shortest input is a program, too.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Operands<'a>(&'a [u8]);

impl<'a> Operands<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    pub(crate) const fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One byte.
    pub(crate) fn byte(&mut self) -> u8 {
        self.take_up_to(1).first().copied().unwrap_or(0)
    }

    /// Two bytes, little-endian.
    pub(crate) fn number(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// The next bytes: at most so many.
    pub(crate) fn take_up_to(&mut self, most: usize) -> &'a [u8] {
        let (part, rest) = self.0.split_at(most.min(self.0.len()));
        self.0 = rest;
        part
    }

    /// All that is left.
    pub(crate) const fn remaining(self) -> &'a [u8] {
        self.0
    }
}

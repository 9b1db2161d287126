//! The encoding of ROS 2 messages: CDR, little-endian.
//!
//! Source: OMG DDS-RTPS 2.5, 10.2 (the header: representation `CDR_LE`, no options) and CORBA 3.3, 9.3 (alignment, texts, sequences).

/// The encapsulation header: `CDR_LE`, options zero.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message under construction, field by field. Numbers are aligned to their size, counted from behind the header.
#[derive(Debug)]
pub(super) struct CdrMessage(Vec<u8>);

impl CdrMessage {
    pub(super) fn new() -> Self {
        Self(HEADER.to_vec())
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    pub(super) fn push_u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(super) fn push_i32(&mut self, value: i32) {
        self.push_aligned(value.to_le_bytes());
    }

    pub(super) fn push_u32(&mut self, value: u32) {
        self.push_aligned(value.to_le_bytes());
    }

    /// A fixed array: no count before it.
    pub(super) fn push_doubles(&mut self, values: &[f64]) {
        for value in values {
            self.push_aligned(value.to_le_bytes());
        }
    }

    /// The count before the elements of a sequence.
    pub(super) fn push_count(&mut self, count: usize) {
        // No message of ours has four thousand million elements.
        self.push_u32(count as u32);
    }

    /// The count includes the zero at the end.
    pub(super) fn push_text(&mut self, text: &str) {
        self.push_count(text.len() + 1);
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
    }

    fn push_aligned<const SIZE: usize>(&mut self, bytes: [u8; SIZE]) {
        let length = (self.0.len() - HEADER.len()).next_multiple_of(SIZE);
        self.0.resize(HEADER.len() + length, 0);
        self.0.extend_from_slice(&bytes);
    }
}

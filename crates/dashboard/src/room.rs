//! Memory that a thread has in use from its start.
//!
//! What a stall has held back comes at once, and the index of a recording's part is whole when the part ends: a station needs its most
//! memory for moments, and what the allocator takes from the system for such a moment mostly stays with the process. So threads that
//! need much for a moment take it when they begin. A station's memory is then known after its first minute, and not after its first bad hour.

use std::hint::black_box;

/// Pieces that no allocator takes from the system one by one.
const PIECE_BYTES: usize = 4_000;

/// Room that was taken; it is there for as long as this is.
#[derive(Debug)]
pub struct Room {
    /// Lies behind the room in memory, so that the room is not the end of the heap, which is given back.
    _end: Box<[u8]>,
}

impl Room {
    /// Takes about so many bytes for what the calling thread allocates later: writes to all of them, and frees them.
    #[must_use]
    pub fn take(bytes: usize) -> Self {
        let pieces = (0..bytes / PIECE_BYTES).map(|_| vec![1_u8; PIECE_BYTES]);
        let pieces = black_box(pieces.collect::<Vec<_>>());
        let end = vec![1_u8; PIECE_BYTES].into_boxed_slice();
        drop(pieces);
        Self { _end: end }
    }
}

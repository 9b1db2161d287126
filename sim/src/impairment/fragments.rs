//! Fragmentation of a stream at delivery: a reader must not treat one read as one frame.

use super::settings::{Fragment, PieceSizes};
use crate::random::RandomStream;

/// Cuts chunks.
#[derive(Clone, Debug)]
pub(super) struct Fragments {
    settings: Fragment,
    stream: RandomStream,
}

impl Fragments {
    pub(super) const fn new(settings: Fragment, stream: RandomStream) -> Self {
        Self { settings, stream }
    }

    /// The pieces of a chunk, in their order; none is empty.
    pub(super) fn split(&mut self, mut chunk: Vec<u8>) -> Vec<Vec<u8>> {
        let mut pieces = Vec::new();
        loop {
            let size = self.size();
            if chunk.len() <= size {
                break;
            }
            let rest = chunk.split_off(size);
            pieces.push(std::mem::replace(&mut chunk, rest));
        }
        pieces.push(chunk);
        pieces
    }

    fn size(&mut self) -> usize {
        let most = self.settings.most_bytes.max(1);
        match self.settings.sizes {
            PieceSizes::Fixed => most as usize,
            PieceSizes::Random => 1 + self.stream.uniform(0.0, f64::from(most)) as usize,
        }
    }
}

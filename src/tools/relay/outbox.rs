//! Chunks that have arrived and wait for a real link to take them.
//!
//! A port's own queue drops old frames when it is full, which is right for a station and wrong for a relay: what the model of the
//! link lets through must arrive. So a chunk is given to the port only when nothing waits there.

use std::collections::VecDeque;

use posebridge_link::Link;

/// Most bytes that wait; what comes beyond is dropped and counted.
const CAPACITY_BYTES: usize = 16 * 1024 * 1024;

/// What waits for one end.
#[derive(Debug, Default)]
pub(super) struct RelayQueue {
    chunks: VecDeque<Vec<u8>>,
    bytes: usize,
    /// Bytes that were not handed over: the end was not there, or too slow for too long.
    pub(super) untaken_bytes: u64,
}

impl RelayQueue {
    /// Takes a chunk for a port and gives the port what it can take.
    pub(super) fn push(&mut self, chunk: Vec<u8>, port: &mut Link) {
        if self.bytes + chunk.len() > CAPACITY_BYTES {
            self.untaken_bytes += chunk.len() as u64;
            return;
        }
        self.bytes += chunk.len();
        self.chunks.push_back(chunk);
        self.flush(port);
    }

    /// Gives the port what it can take.
    pub(super) fn flush(&mut self, port: &mut Link) {
        while port.port_counts().queued_frames == 0 {
            let Some(chunk) = self.chunks.pop_front() else {
                return;
            };
            self.bytes -= chunk.len();
            if port.is_up() {
                port.send(&chunk);
            } else {
                self.untaken_bytes += chunk.len() as u64;
            }
        }
    }

    /// Whether nothing waits, neither here nor in the port.
    pub(super) fn is_empty(&self, port: &Link) -> bool {
        self.chunks.is_empty() && port.port_counts().queued_frames == 0
    }
}

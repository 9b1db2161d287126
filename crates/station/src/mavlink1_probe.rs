//! Recognizes MAVLink 1 on a link that accepts version 2 alone, where it is garbage.

use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind, WireVersion};
use posebridge_telemetry::{HostClock, Timestamp};

/// Frames that tell: random bytes contain one in some megabytes.
const ENOUGH_FRAMES: u32 = 3;
/// Bytes that are searched at most: some seconds of a serial line.
const MAX_BYTES: usize = 65_536;

/// Searches the first bytes of a link, as long as no frame of version 2 has come.
#[derive(Debug)]
pub(crate) struct Mavlink1Probe {
    framer: Framer,
    frames: u32,
    searched: usize,
}

impl Mavlink1Probe {
    pub(crate) fn new(transport: TransportKind) -> Self {
        let config = FramerConfig { accept_v1: true, transport, ..FramerConfig::default() };
        Self { framer: Framer::new(config), frames: 0, searched: 0 }
    }

    /// Whether the bytes so far are MAVLink 1; `None` while that is open.
    pub(crate) fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) -> Option<bool> {
        let mut has_version_2 = false;
        let frames = &mut self.frames;
        self.framer.push(now, bytes, &mut |found| {
            if let FramerOutput::Frame(frame) = found {
                match frame.version {
                    WireVersion::V1 => *frames += 1,
                    WireVersion::V2 => has_version_2 = true,
                }
            }
        });
        self.searched += bytes.len();
        if has_version_2 || self.searched > MAX_BYTES {
            return Some(false);
        }
        (self.frames >= ENOUGH_FRAMES).then_some(true)
    }
}

//! Recognizes MAVLink 1 on a link that accepts version 2 alone, where it is garbage.

use std::collections::BTreeMap;

use posebridge_protocol::framing::{Framer, FramerConfig, FramerOutput, TransportKind, WireVersion};
use posebridge_telemetry::{HostClock, PeerId, Timestamp};

/// Frames of version 1 by which it is recognized: random bytes contain one in some megabytes.
const MIN_FRAMES: u32 = 3;
/// Bytes of a peer that are searched at most: some seconds of a serial line.
const MAX_BYTES: usize = 65_536;
/// Peers of a link that are searched at a time.
const MAX_PEERS: usize = 16;

/// Searches the first bytes of each peer of a link, until a frame of version 2 has come from it.
#[derive(Debug)]
pub(crate) struct Mavlink1Probe {
    transport: TransportKind,
    /// `None` for a peer whose search has ended.
    searches: BTreeMap<PeerId, Option<PeerSearch>>,
    has_found: bool,
}

#[derive(Debug)]
struct PeerSearch {
    framer: Framer,
    frames: u32,
    searched: usize,
}

impl Mavlink1Probe {
    pub(crate) const fn new(transport: TransportKind) -> Self {
        Self { transport, searches: BTreeMap::new(), has_found: false }
    }

    /// Whether the bytes of a peer turn out to be MAVLink 1; once for the link.
    pub(crate) fn push(&mut self, now: Timestamp<HostClock>, peer: PeerId, bytes: &[u8]) -> bool {
        if self.has_found || (self.searches.len() >= MAX_PEERS && !self.searches.contains_key(&peer)) {
            return false;
        }
        let search = self.searches.entry(peer).or_insert_with(|| Some(PeerSearch::new(self.transport)));
        let found = search.as_mut().and_then(|search| search.push(now, bytes));
        if found.is_some() {
            *search = None;
        }
        self.has_found = found == Some(true);
        self.has_found
    }

    pub(crate) fn forget(&mut self, peer: PeerId) {
        self.searches.remove(&peer);
    }

    /// After a reconnect another device may be there.
    pub(crate) fn handle_link_loss(&mut self) {
        self.searches.clear();
    }
}

impl PeerSearch {
    fn new(transport: TransportKind) -> Self {
        let config = FramerConfig { accept_v1: true, transport, ..FramerConfig::default() };
        Self { framer: Framer::new(config), frames: 0, searched: 0 }
    }

    /// Whether the bytes so far are MAVLink 1; `None` while that is open.
    fn push(&mut self, now: Timestamp<HostClock>, bytes: &[u8]) -> Option<bool> {
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
        (self.frames >= MIN_FRAMES).then_some(true)
    }
}

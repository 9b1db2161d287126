//! The MAVLink frames in the bytes of links, put together peer by peer.

use std::collections::BTreeMap;

use posebridge_protocol::framing::{FrameRef, Framer, FramerConfig, FramerOutput, SequenceTracker};
use posebridge_protocol::routing::MAX_PEERS;
use posebridge_station::{AcceptedVersions, LinkConfig};
use posebridge_telemetry::{HostClock, LinkId, PeerId, Timestamp};

/// A frame of a link.
pub struct LinkFrame<'f> {
    pub now: Timestamp<HostClock>,
    pub link: LinkId,
    pub frame: FrameRef<'f>,
    /// Whether its message is in a dialect, so that its checksum was verified.
    pub is_known: bool,
    /// Frames of its sender that are missing before it on this link.
    pub lost: u8,
}

/// The links that use MAVLink, with a framer for each peer. Of too many peers the one that was silent longest is forgotten.
#[derive(Default)]
pub struct LinkFrames {
    links: BTreeMap<LinkId, FramerConfig>,
    peers: BTreeMap<(LinkId, PeerId), PeerStream>,
}

/// The stream of one peer of a link, which may end within a frame.
struct PeerStream {
    last_seen: Timestamp<HostClock>,
    framer: Framer,
    sequence: SequenceTracker,
}

impl LinkFrames {
    pub fn new(links: &[LinkConfig]) -> Self {
        let links = links.iter().filter(|link| link.brick.is_none()).map(|link| {
            let config = FramerConfig {
                accept_v1: link.accepted_versions == AcceptedVersions::V1AndV2,
                transport: link.framing,
                ..FramerConfig::default()
            };
            (link.id, config)
        });
        Self { links: links.collect(), peers: BTreeMap::new() }
    }

    pub fn contains(&self, link: LinkId) -> bool {
        self.links.contains_key(&link)
    }

    /// Passes the frames that a chunk of one peer completes.
    pub fn push(
        &mut self,
        now: Timestamp<HostClock>,
        link: LinkId,
        peer: PeerId,
        bytes: &[u8],
        take: &mut dyn FnMut(&LinkFrame<'_>),
    ) {
        let Some(config) = self.links.get(&link) else {
            return;
        };
        let key = (link, peer);
        if self.peers.len() >= MAX_PEERS && !self.peers.contains_key(&key) {
            let silent = self.peers.iter().min_by_key(|(_, stream)| stream.last_seen);
            if let Some(silent) = silent.map(|(key, _)| *key) {
                self.peers.remove(&silent);
            }
        }
        let PeerStream { last_seen, framer, sequence } = self.peers.entry(key).or_insert_with(|| PeerStream {
            last_seen: now,
            framer: Framer::new(*config),
            sequence: SequenceTracker::new(),
        });
        *last_seen = now;
        framer.push(now, bytes, &mut |found| pass(now, link, found, sequence, take));
    }

    /// Passes the frames that no further bytes would change, at the time of the last bytes of their peer.
    pub fn finish(self, take: &mut dyn FnMut(&LinkFrame<'_>)) {
        for ((link, _), PeerStream { last_seen, mut framer, mut sequence }) in self.peers {
            framer.finish(&mut |found| pass(last_seen, link, found, &mut sequence, take));
        }
    }
}

fn pass(
    now: Timestamp<HostClock>,
    link: LinkId,
    found: FramerOutput<'_>,
    sequence: &mut SequenceTracker,
    take: &mut dyn FnMut(&LinkFrame<'_>),
) {
    let (frame, is_known) = match found {
        FramerOutput::Frame(frame) => (frame, true),
        FramerOutput::UnknownFrame(frame) => (frame, false),
        FramerOutput::Error(_) => return,
    };
    let lost = sequence.record_number(frame.source, frame.sequence);
    take(&LinkFrame { now, link, frame, is_known, lost });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message::Message;
    use posebridge_telemetry::Address;

    /// A program that connects anew for each request is another peer each time.
    #[test]
    fn of_many_peers_the_most_silent_are_forgotten_and_no_whole_frame_is_lost() {
        let request = Message::ParamRequestList { target: Address::new(1, 197) };
        let mut frame = Vec::new();
        Encoder::new(WireVersion::V2).encode(Address::new(7, 1), &request, &mut frame);
        let (begun, rest) = frame.split_at(5);
        let links = Config::default().station_config().unwrap().links;
        let link = links[0].id;
        let mut frames = LinkFrames::new(&links);
        let mut passed = 0;
        let mut push = |frames: &mut LinkFrames, millis: u32, peer: u32, bytes: &[u8]| {
            frames.push(Timestamp::from_millis(millis.into()), link, PeerId(peer), bytes, &mut |_| passed += 1);
        };
        let peers = 3 * MAX_PEERS as u32;
        for number in 0..peers {
            push(&mut frames, number, number, &frame);
            push(&mut frames, number, number, begun);
            // One that goes on is not forgotten, however long ago it came.
            push(&mut frames, number, 0, &frame);
            assert!(frames.peers.len() <= MAX_PEERS);
        }
        push(&mut frames, peers, peers - 1, rest);
        assert_eq!(passed, 2 * peers + 1);
    }
}

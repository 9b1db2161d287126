//! The framers of one link: the bytes of each peer are a stream of their own.
//!
//! A peer that has been silent for long is forgotten; its counts are kept.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::framing::{Framer, FramerConfig, FramerCounters, FramerOutput};
use posebridge_protocol::routing::{MAX_PEERS, ROUTE_LIFETIME};
use posebridge_telemetry::{HostClock, PeerId, TimeDelta, Timestamp};

/// Silence after which a peer is forgotten; no route leads to it any more.
const IDLE_TIMEOUT: TimeDelta = ROUTE_LIFETIME;
/// Where the link reports its number of peers, another peer must have been received since its last report but one: it
/// reports each second.
const PEER_COUNT_TIMEOUT: TimeDelta = TimeDelta::from_millis(2_000);

#[derive(Clone, Copy, Debug)]
pub(crate) enum FramerInput<'a> {
    Bytes(&'a [u8]),
    /// The time-out of an incomplete frame: complete frames after a truncated beginning are found then.
    Timeout,
    /// The end of the link: an incomplete frame is never completed.
    Closed,
}

#[derive(Debug)]
pub(crate) struct PeerFramers {
    config: FramerConfig,
    present: BTreeMap<PeerId, PeerFramer>,
    /// Peers with an incomplete frame, by its time-out.
    deadlines: BTreeSet<(Timestamp<HostClock>, PeerId)>,
    /// Totals of forgotten peers.
    closed_counters: FramerCounters,
}

#[derive(Debug)]
struct PeerFramer {
    framer: Framer,
    last_seen: Timestamp<HostClock>,
}

impl PeerFramers {
    pub(crate) fn new(config: FramerConfig) -> Self {
        Self {
            config,
            present: BTreeMap::new(),
            deadlines: BTreeSet::new(),
            closed_counters: FramerCounters::default(),
        }
    }

    /// Makes room for a new peer. Returns the peers that were dropped: a quarter at a time, so that a flood of invented
    /// peers does not cost a search for each.
    pub(crate) fn admit(&mut self, peer: PeerId) -> Vec<PeerId> {
        if self.present.len() < MAX_PEERS || self.present.contains_key(&peer) {
            return Vec::new();
        }
        let mut by_silence: Vec<_> = self.present.iter().map(|(id, peer)| (peer.last_seen, *id)).collect();
        by_silence.sort_unstable();
        by_silence.truncate(MAX_PEERS / 4);
        let silent: Vec<PeerId> = by_silence.into_iter().map(|(_, id)| id).collect();
        self.evict(&silent);
        silent
    }

    /// Passes input to a peer's framer; its output goes to `sink`.
    pub(crate) fn push(
        &mut self,
        now: Timestamp<HostClock>,
        id: PeerId,
        input: FramerInput<'_>,
        sink: &mut dyn FnMut(FramerOutput<'_>),
    ) {
        if let FramerInput::Bytes(_) = input {
            let config = self.config;
            let new = || PeerFramer { framer: Framer::new(config), last_seen: now };
            self.present.entry(id).or_insert_with(new).last_seen = now;
        }
        let Some(PeerFramer { framer, .. }) = self.present.get_mut(&id) else {
            return;
        };
        let before = framer.deadline();
        match input {
            FramerInput::Bytes(bytes) => framer.push(now, bytes, sink),
            FramerInput::Timeout => framer.tick(now, sink),
            FramerInput::Closed => framer.handle_link_loss(sink),
        }
        let after = framer.deadline();
        self.update_deadline(id, before, after);
    }

    /// Whether another peer is present, by recent input. `reported_peers` is the number of peers that the link has
    /// reported; zero if it has not.
    pub(crate) fn has_other_than(&self, id: PeerId, now: Timestamp<HostClock>, reported_peers: u32) -> bool {
        // The link knows of a peer that only listens, and of one that replaced another.
        let recent = match reported_peers {
            0 => IDLE_TIMEOUT,
            1 => PEER_COUNT_TIMEOUT,
            _ => return true,
        };
        let mut others = self.present.iter().filter(|(other, _)| **other != id);
        others.any(|(_, peer)| now - peer.last_seen <= recent)
    }

    pub(crate) fn timed_out(&self, now: Timestamp<HostClock>) -> Vec<PeerId> {
        let due = self.deadlines.iter().take_while(|(due, _)| *due <= now);
        due.map(|(_, id)| *id).collect()
    }

    /// When [`Self::timed_out`] next returns a peer.
    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        self.deadlines.first().map(|(due, _)| *due)
    }

    pub(crate) fn count(&self) -> usize {
        self.present.len()
    }

    pub(crate) fn present(&self) -> Vec<PeerId> {
        self.present.keys().copied().collect()
    }

    pub(crate) fn evict_idle(&mut self, now: Timestamp<HostClock>) -> Vec<PeerId> {
        let silent = self.present.iter().filter(|(_, peer)| now - peer.last_seen > IDLE_TIMEOUT);
        let silent: Vec<PeerId> = silent.map(|(id, _)| *id).collect();
        self.evict(&silent);
        silent
    }

    /// The link was lost: incomplete frames are dropped.
    pub(crate) fn handle_link_loss(&mut self) {
        self.deadlines.clear();
        for peer in std::mem::take(&mut self.present).into_values() {
            self.closed_counters = self.closed_counters.merged(peer.framer.counters());
        }
    }

    /// Of all peers, including the forgotten ones.
    pub(crate) fn counters(&self) -> FramerCounters {
        let present = self.present.values().map(|peer| peer.framer.counters());
        present.fold(self.closed_counters, FramerCounters::merged)
    }

    fn update_deadline(
        &mut self,
        id: PeerId,
        before: Option<Timestamp<HostClock>>,
        after: Option<Timestamp<HostClock>>,
    ) {
        if before != after {
            if let Some(due) = before {
                self.deadlines.remove(&(due, id));
            }
            self.deadlines.extend(after.map(|due| (due, id)));
        }
    }

    fn evict(&mut self, ids: &[PeerId]) {
        for id in ids {
            let Some(mut peer) = self.present.remove(id) else {
                continue;
            };
            let deadline = peer.framer.deadline();
            self.update_deadline(*id, deadline, None);
            if deadline.is_none() {
                // A frame that stopped in its middle is not completed any more, and nothing hides behind it.
                peer.framer.finish(&mut |_| {});
            }
            self.closed_counters = self.closed_counters.merged(peer.framer.counters());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_config::at;
    use posebridge_protocol::dialect::Encoder;
    use posebridge_protocol::framing::WireVersion;
    use posebridge_protocol::message::{Heartbeat, Message};
    use posebridge_telemetry::Address;

    const BEAT: Message =
        Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 8, base_mode: 0, system_status: 4 });

    fn frame() -> Vec<u8> {
        let mut bytes = Vec::new();
        Encoder::new(WireVersion::V2).encode(Address::new(1, 1), &BEAT, &mut bytes);
        bytes
    }

    fn frames(framers: &mut PeerFramers, now: Timestamp<HostClock>, peer: u32, input: FramerInput<'_>) -> usize {
        let mut found = 0;
        framers.push(now, PeerId(peer), input, &mut |output| {
            found += usize::from(matches!(output, FramerOutput::Frame(_)));
        });
        found
    }

    #[test]
    fn the_bytes_of_two_peers_do_not_mix() {
        let mut framers = PeerFramers::new(FramerConfig::default());
        let frame = frame();
        let (first, second) = frame.split_at(5);
        assert_eq!(frames(&mut framers, at(0), 0, FramerInput::Bytes(first)), 0);
        assert_eq!(frames(&mut framers, at(0), 1, FramerInput::Bytes(&frame)), 1);
        assert_eq!(frames(&mut framers, at(0), 0, FramerInput::Bytes(second)), 1);
        assert_eq!(framers.counters().frames, 2);
    }

    #[test]
    fn an_incomplete_frame_is_dropped_at_its_deadline_and_hides_nothing() {
        let mut framers = PeerFramers::new(FramerConfig::default());
        // The beginning of an ODOMETRY announces 232 bytes, which would swallow the frame behind it.
        let mut bytes = vec![0xFD, 232, 0, 0, 0, 1, 1, 0x4B, 0x01, 0, 7, 7];
        bytes.extend(frame());
        let before = frames(&mut framers, at(0), 0, FramerInput::Bytes(&bytes));
        let due = framers.deadline().expect("an incomplete frame waits");
        assert!(framers.timed_out(at(0)).is_empty());
        assert_eq!(framers.timed_out(due), [PeerId(0)]);
        let after = frames(&mut framers, due, 0, FramerInput::Timeout);
        assert_eq!((before, after), (0, 1));
        assert_eq!(framers.deadline(), None);
    }

    #[test]
    fn a_silent_peer_is_forgotten_and_what_it_counted_is_not() {
        let mut framers = PeerFramers::new(FramerConfig::default());
        frames(&mut framers, at(0), 4, FramerInput::Bytes(&frame()));
        assert!(framers.evict_idle(at(0) + IDLE_TIMEOUT).is_empty());
        assert_eq!(framers.evict_idle(at(1) + IDLE_TIMEOUT), [PeerId(4)]);
        assert_eq!(framers.counters().frames, 1);
        assert!(framers.present().is_empty());
    }
}

//! Speakers with sequence numbers of their own, and lines with delays between stations: several links in virtual time.

use std::collections::BTreeMap;

use posebridge_protocol::dialect::Encoder;
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::Message;
use posebridge_telemetry::{Address, HostClock, LinkId, PeerId, Priority, Recipients, Timestamp};

use super::TestStation;

/// Somebody at the other end of a link.
pub(crate) struct RemotePeer {
    address: Address,
    encoder: Encoder,
    link: LinkId,
    peer: PeerId,
}

impl RemotePeer {
    pub(crate) fn new(address: Address, link: LinkId, peer: u32) -> Self {
        Self { address, encoder: Encoder::new(WireVersion::V2), link, peer: PeerId(peer) }
    }

    /// The next frame.
    pub(crate) fn frame(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(self.address, message, &mut bytes);
        bytes
    }

    /// Says something to a station, and returns whom the station passed it on to.
    pub(crate) fn send(
        &mut self,
        station: &mut TestStation,
        now: Timestamp<HostClock>,
        message: &Message,
    ) -> Vec<(LinkId, Recipients, Priority)> {
        let bytes = self.frame(message);
        self.send_bytes(station, now, &bytes)
    }

    /// Gives bytes to a station as if this speaker had sent them, and returns whom the station passed them on to.
    pub(crate) fn send_bytes(
        &self,
        station: &mut TestStation,
        now: Timestamp<HostClock>,
        bytes: &[u8],
    ) -> Vec<(LinkId, Recipients, Priority)> {
        let seen = station.outputs.len();
        station.bytes_from(now, self.link, self.peer, bytes);
        forwarded_since(station, seen, bytes)
    }
}

/// To whom exactly these bytes were sent, among the outputs after the first `seen`.
pub(crate) fn forwarded_since(station: &TestStation, seen: usize, frame: &[u8]) -> Vec<(LinkId, Recipients, Priority)> {
    let sent = station.sent_since(seen).filter(|sent| sent.bytes == frame);
    sent.map(|sent| (sent.link, sent.to, sent.priority)).collect()
}

/// Bytes with their instants of arrival and the place where they arrive, first come first.
#[derive(Default)]
pub(crate) struct BytesInTransit<P> {
    queue: BTreeMap<(Timestamp<HostClock>, u64), (P, Vec<u8>)>,
    sent: u64,
}

impl<P> BytesInTransit<P> {
    pub(crate) fn send(&mut self, arrival: Timestamp<HostClock>, place: P, bytes: Vec<u8>) {
        self.sent += 1;
        self.queue.insert((arrival, self.sent), (place, bytes));
    }

    /// The next that arrives until `now`.
    pub(crate) fn take_due(&mut self, now: Timestamp<HostClock>) -> Option<(P, Vec<u8>)> {
        let entry = self.queue.first_entry()?;
        (entry.key().0 <= now).then(|| entry.remove())
    }

    /// Everything that is on its way to some place is lost.
    pub(crate) fn lose(&mut self, is_lost: impl Fn(&P) -> bool) {
        self.queue.retain(|_, (place, _)| !is_lost(place));
    }
}

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

    /// Sends a message to a station, and returns where the station forwarded it.
    pub(crate) fn send(
        &mut self,
        station: &mut TestStation,
        now: Timestamp<HostClock>,
        message: &Message,
    ) -> Vec<(LinkId, Recipients, Priority)> {
        let bytes = self.frame(message);
        self.send_bytes(station, now, &bytes)
    }

    /// Gives bytes to a station as if this peer had sent them, and returns where the station forwarded them.
    pub(crate) fn send_bytes(
        &self,
        station: &mut TestStation,
        now: Timestamp<HostClock>,
        bytes: &[u8],
    ) -> Vec<(LinkId, Recipients, Priority)> {
        let first_output = station.outputs.len();
        station.bytes_from(now, self.link, self.peer, bytes);
        forwarded_since(station, first_output, bytes)
    }
}

/// The recipients of exactly these bytes, among the outputs after the first `first_output`.
pub(crate) fn forwarded_since(
    station: &TestStation,
    first_output: usize,
    frame: &[u8],
) -> Vec<(LinkId, Recipients, Priority)> {
    let sent = station.sent_since(first_output).filter(|sent| sent.bytes == frame);
    sent.map(|sent| (sent.link, sent.to, sent.priority)).collect()
}

/// Bytes with their instants of arrival and their destination, first come first.
#[derive(Default)]
pub(crate) struct BytesInTransit<P> {
    queue: BTreeMap<(Timestamp<HostClock>, u64), (P, Vec<u8>)>,
    sent: u64,
}

impl<P> BytesInTransit<P> {
    pub(crate) fn send(&mut self, arrival: Timestamp<HostClock>, destination: P, bytes: Vec<u8>) {
        self.sent += 1;
        self.queue.insert((arrival, self.sent), (destination, bytes));
    }

    pub(crate) fn last_arrival(&self) -> Option<Timestamp<HostClock>> {
        self.queue.last_key_value().map(|((arrival, _), _)| *arrival)
    }

    /// The next that arrives until `now`.
    pub(crate) fn take_due(&mut self, now: Timestamp<HostClock>) -> Option<(P, Vec<u8>)> {
        let entry = self.queue.first_entry()?;
        (entry.key().0 <= now).then(|| entry.remove())
    }

    /// Everything in transit to some destinations is lost.
    pub(crate) fn lose(&mut self, is_lost: impl Fn(&P) -> bool) {
        self.queue.retain(|_, (destination, _)| !is_lost(destination));
    }
}

//! Message signing of MAVLink 2: only a holder of the key may send, and a frame cannot be replayed.
//!
//! ```text
//! signature = link id (1)  timestamp (6, little-endian; units of 10 µs since 2015-01-01 00:00 UTC)  mac (6)
//! mac       = first 6 bytes of SHA-256(key (32), header, payload, CRC, link id, timestamp)
//! ```
//! A stream is a (system, component, link id). A frame is refused, in this order, when it has no signature and its id is not
//! excepted; its mac is another one; its timestamp is not later than its stream's last; its stream is new and over a minute
//! behind us. So only a holder of the key can change the remembered state. What must survive a restart is a value
//! ([`SigningState`]). Source: MAVLink guide, "Message Signing".

mod key;
mod signature;
mod state;

use std::collections::BTreeSet;

use posebridge_telemetry::{HostClock, SignatureError, TimeDelta, Timestamp};

pub use crate::framing::FLAG_SIGNED;
pub use key::{Key, KeyError};
pub use signature::{FrameSigner, SigningTime};
pub use state::{ShutdownKind, SignedStreamState, SigningState, StreamId};

use self::signature::Signature;
use crate::framing::FrameRef;

/// RADIO_STATUS: telemetry radios inject it and hold no key.
pub const RADIO_STATUS: u32 = 109;
/// Most remembered streams. Only holders of the key make streams; a class of robots has a few hundred.
const MAX_STREAMS: usize = 1_024;
/// A new stream may be this far behind: 6 million units, MAVLink guide, "Timestamp Handling".
const MAX_LAG: TimeDelta = TimeDelta::from_millis(60_000);

/// Whether frames without a signature are accepted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UnsignedPolicy {
    /// A signature, if there is one, must still be valid.
    Accept,
    /// Rejected, except these message ids.
    RejectExcept(BTreeSet<u32>),
}

/// The configuration of a link's signing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SigningConfig {
    pub key: Key,
    /// The number of the link in our signatures.
    pub link_id: u8,
    pub unsigned: UnsignedPolicy,
    /// The state at the host clock's zero.
    pub state: SigningState,
}

/// Signs the outgoing frames of one link and verifies the received ones.
///
/// Signature time starts at the computer's date and continues with the host clock. A verified frame that is ahead sets
/// it forward, so that a station without a correct date learns it from its peers.
#[derive(Clone, Debug)]
pub struct LinkSigner {
    key: Key,
    link_id: u8,
    unsigned: UnsignedPolicy,
    /// At the host clock's zero.
    state: SigningState,
    streams_seen: u64,
}

impl LinkSigner {
    pub fn new(config: SigningConfig) -> Self {
        let SigningConfig { key, link_id, unsigned, state } = config;
        Self { key, link_id, unsigned, state, streams_seen: 0 }
    }

    /// Signs the next frame of our own, with the timestamp of `now` or later, after every one before. `None` when there
    /// is no later one.
    pub fn next_signer(&mut self, now: Timestamp<HostClock>) -> Option<FrameSigner<'_>> {
        self.state.last_sent = self.clock(now).max(self.state.last_sent.next()?);
        Some(FrameSigner { key: &self.key, link_id: self.link_id, timestamp: self.state.last_sent })
    }

    /// Verifies a frame that arrived at `now`. The error is why it must be rejected; it changes no state.
    pub fn verify(&mut self, now: Timestamp<HostClock>, frame: &FrameRef<'_>) -> Result<(), SignatureError> {
        let Some(signature) = Signature::parse(frame) else {
            return match &self.unsigned {
                UnsignedPolicy::RejectExcept(ids) if !ids.contains(&frame.message_id) => Err(SignatureError::Unsigned),
                UnsignedPolicy::Accept | UnsignedPolicy::RejectExcept(_) => Ok(()),
            };
        };
        if !signature.is_valid(&self.key) {
            return Err(SignatureError::Invalid);
        }
        let (clock, timestamp) = (self.clock(now), signature.timestamp);
        let accepted = SignedStreamState { timestamp, date: self.date(now) };
        let stream = StreamId { source: frame.source, link_id: signature.link_id };
        if let Some(last) = self.state.streams.get_mut(&stream) {
            if timestamp <= last.timestamp {
                return Err(SignatureError::Replayed);
            }
            *last = accepted;
        } else {
            // A stream that is not remembered may have used this timestamp.
            let may_be_replayed = self.state.min_timestamp.is_some_and(|floor| timestamp <= floor);
            if may_be_replayed || timestamp.saturating_add(MAX_LAG) < clock {
                return Err(SignatureError::Stale);
            }
            self.add_stream(stream, accepted);
        }
        // Zero when we are ahead.
        self.state.clock = self.state.clock.saturating_add(timestamp.since(clock));
        Ok(())
    }

    fn add_stream(&mut self, stream: StreamId, accepted: SignedStreamState) {
        let streams = &mut self.state.streams;
        if streams.len() >= MAX_STREAMS {
            let oldest = streams.iter().min_by_key(|(_, last)| last.timestamp);
            if let Some((oldest, last)) = oldest.map(|(oldest, last)| (*oldest, last.timestamp)) {
                streams.remove(&oldest);
                // Its frames cannot be replayed: a stream that is not in the table must be later.
                self.state.min_timestamp = self.state.min_timestamp.max(Some(last));
            }
        }
        streams.insert(stream, accepted);
        self.streams_seen += 1;
    }

    /// Whether the sender of an accepted frame is authenticated. A frame without a signature that was accepted only
    /// because of its message id is not: anyone can send it, under any address.
    pub fn is_authenticated(&self, frame: &FrameRef<'_>) -> bool {
        self.unsigned == UnsignedPolicy::Accept || Signature::parse(frame).is_some()
    }

    /// The state to keep for a restart, as of `now`.
    pub fn state(&self, now: Timestamp<HostClock>) -> SigningState {
        SigningState { written_at: self.date(now), clock: self.clock(now), ..self.state.clone() }
    }

    /// Number of new streams. When it has grown, the state should be written at once: after a restart nothing is known
    /// of a stream that is not in it.
    pub const fn streams_seen(&self) -> u64 {
        self.streams_seen
    }

    fn clock(&self, now: Timestamp<HostClock>) -> SigningTime {
        self.state.clock.saturating_add(now - Timestamp::ZERO)
    }

    /// The computer's.
    fn date(&self, now: Timestamp<HostClock>) -> SigningTime {
        self.state.written_at.saturating_add(now - Timestamp::ZERO)
    }
}

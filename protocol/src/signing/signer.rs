//! Signing of one link in both directions, with the clock that they share.

use posebridge_telemetry::{HostClock, SignatureError, Timestamp};

use super::key::Key;
use super::signature::{FrameSigner, Signature, SigningTime};
use super::state::SigningState;
use super::verifier::{SignatureVerifier, UnsignedPolicy};
use crate::framing::FrameRef;

/// The configuration of a link's signing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SigningConfig {
    /// The secret that both ends share.
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
    /// The computer's date at the host clock's zero.
    start_date: SigningTime,
    /// Signature time at the host clock's zero.
    start: SigningTime,
    last_sent: SigningTime,
    verifier: SignatureVerifier,
}

impl LinkSigner {
    pub fn new(config: SigningConfig) -> Self {
        let memory = config.state;
        Self {
            key: config.key,
            link_id: config.link_id,
            start_date: memory.written_at,
            start: memory.clock,
            last_sent: memory.last_sent,
            verifier: SignatureVerifier::new(config.unsigned, memory.streams, memory.min_timestamp),
        }
    }

    /// Signs the next frame of our own, with the timestamp of `now` or later, after every one before. `None` when there
    /// is no later one.
    pub fn next_signer(&mut self, now: Timestamp<HostClock>) -> Option<FrameSigner<'_>> {
        self.last_sent = self.clock(now).max(self.last_sent.next()?);
        Some(FrameSigner { key: &self.key, link_id: self.link_id, timestamp: self.last_sent })
    }

    /// Verifies a frame that arrived at `now`. The error is why it must be rejected; it changes no state.
    pub fn verify(&mut self, now: Timestamp<HostClock>, frame: &FrameRef<'_>) -> Result<(), SignatureError> {
        let clock = self.clock(now);
        let date = self.date(now);
        let timestamp = self.verifier.verify((clock, date), &self.key, frame)?;
        if let Some(timestamp) = timestamp {
            // Zero when we are ahead.
            self.start = self.start.saturating_add(timestamp.since(clock));
        }
        Ok(())
    }

    /// Whether the sender of an accepted frame is authenticated. A frame without a signature that was accepted only
    /// because of its message id is not: anyone can send it, under any address.
    pub fn is_authenticated(&self, frame: &FrameRef<'_>) -> bool {
        self.verifier.accepts_unsigned() || Signature::parse(frame).is_some()
    }

    /// The state to keep for a restart, as of `now`.
    pub fn state(&self, now: Timestamp<HostClock>) -> SigningState {
        SigningState {
            written_at: self.date(now),
            clock: self.clock(now),
            last_sent: self.last_sent,
            min_timestamp: self.verifier.min_timestamp(),
            streams: self.verifier.streams().clone(),
        }
    }

    /// Number of new streams. When it has grown, the state should be written at once: after a restart nothing is known
    /// of a stream that is not in it.
    pub const fn streams_seen(&self) -> u64 {
        self.verifier.streams_seen()
    }

    fn clock(&self, now: Timestamp<HostClock>) -> SigningTime {
        self.start.saturating_add(now - Timestamp::ZERO)
    }

    fn date(&self, now: Timestamp<HostClock>) -> SigningTime {
        self.start_date.saturating_add(now - Timestamp::ZERO)
    }
}

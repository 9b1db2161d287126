//! Signing of one link, both ways, with the clock that both ways share.

use posebridge_telemetry::{HostClock, Refusal, Stamp};

use super::clock::Timestamp;
use super::key::Key;
use super::memory::Memory;
use super::signature::{Seal, Signature};
use super::verifier::{Unsigned, Verifier};
use crate::framing::FrameRef;

/// Everything that decides how a link signs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SigningConfig {
    /// The secret that both ends share.
    pub key: Key,
    /// What we call the link in our signatures.
    pub link_id: u8,
    /// What becomes of frames without a signature.
    pub unsigned: Unsigned,
    /// What the link begins with, as of the host clock's zero.
    pub memory: Memory,
}

/// Signs what leaves on one link and judges what comes there.
///
/// The time of signatures is the calendar's at the start and goes on with the host clock. A believed frame that is ahead
/// sets it forward, so that a station without a right date learns it from its peers.
#[derive(Clone, Debug)]
pub struct LinkSigning {
    key: Key,
    link_id: u8,
    /// The computer's date at the host clock's zero.
    first_date: Timestamp,
    /// The time of signatures at the host clock's zero.
    start: Timestamp,
    /// The last timestamp that was used.
    own: Timestamp,
    verifier: Verifier,
}

impl LinkSigning {
    /// A link that goes on from its memory.
    #[must_use]
    pub fn new(config: SigningConfig) -> Self {
        let memory = config.memory;
        Self {
            key: config.key,
            link_id: config.link_id,
            first_date: memory.written,
            start: memory.clock,
            own: memory.own,
            verifier: Verifier::new(config.unsigned, memory.streams, memory.floor),
        }
    }

    /// What the next frame of our own is signed with: a timestamp of `now`, and later than every one before. `None` when there
    /// is no later one.
    pub fn next_seal(&mut self, now: Stamp<HostClock>) -> Option<Seal<'_>> {
        self.own = self.clock(now).max(self.own.next()?);
        Some(Seal { key: &self.key, link_id: self.link_id, timestamp: self.own })
    }

    /// Judges a frame that came at `now`.
    ///
    /// # Errors
    /// Why it must not be believed; it has changed nothing.
    pub fn judge(&mut self, now: Stamp<HostClock>, frame: &FrameRef<'_>) -> Result<(), Refusal> {
        let clock = self.clock(now);
        let date = self.date(now);
        let timestamp = self.verifier.judge((clock, date), &self.key, frame)?;
        if let Some(timestamp) = timestamp {
            // Zero when we are ahead.
            self.start = self.start.later(timestamp.since(clock));
        }
        Ok(())
    }

    /// Whether the sender of a frame that is believed is vouched for. Nobody vouches for a frame without a signature that came in
    /// only because of its message id: everybody can send it, in anybody's name.
    #[must_use]
    pub fn vouches_for(&self, frame: &FrameRef<'_>) -> bool {
        self.verifier.believes_everybody() || Signature::of(frame).is_some()
    }

    /// What must be known after a restart, as of `now`.
    #[must_use]
    pub fn memory(&self, now: Stamp<HostClock>) -> Memory {
        Memory {
            written: self.date(now),
            clock: self.clock(now),
            own: self.own,
            floor: self.verifier.floor(),
            streams: self.verifier.streams().clone(),
        }
    }

    /// How many streams were heard for the first time. When it has grown, the memory should be written down at once: of a
    /// stream that is not in it nothing is known after a restart.
    #[must_use]
    pub const fn streams_met(&self) -> u64 {
        self.verifier.met()
    }

    fn clock(&self, now: Stamp<HostClock>) -> Timestamp {
        self.start.later(now - Stamp::ZERO)
    }

    fn date(&self, now: Stamp<HostClock>) -> Timestamp {
        self.first_date.later(now - Stamp::ZERO)
    }
}

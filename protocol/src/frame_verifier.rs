//! Authenticates frames by their signatures, and counts missing frames by their senders' sequence numbers.
//!
//! One verifier serves one link. All peers of a link share its key and its signing streams; each peer has sequence numbers of its own,
//! because two robots behind one socket may have the same address.
//!
//! A frame whose signature is rejected changes no sequence number: its sender is unknown. The same holds for a frame that may come
//! unsigned on a link with a key.

use std::collections::BTreeMap;

use posebridge_telemetry::{Address, HostClock, PeerId, SignatureError, SourceHealth, Timestamp};

use crate::framing::{FramerOutput, SequenceTracker};
use crate::routing::SenderCheck;
use crate::signing::{FrameSigner, LinkSigner, SigningConfig, SigningState};

/// Most senders in [`FrameVerifier::source_health`], those with the most frames. A class of robots has a few hundred.
const MAX_SENDERS: usize = 1_024;
/// Most peers whose sequence numbers are kept after a loss of the link, those with the highest ids: the peer of a link
/// with one peer is always 0, and a link with several gives a returning peer a new id.
const MAX_SUSPENDED: usize = 16;

/// The authentication and the loss count of an accepted frame.
#[derive(Clone, Copy, Debug)]
pub struct VerifiedSender {
    pub check: SenderCheck,
    /// Increase in the number of the sender's missing frames.
    pub missing: u32,
}

impl VerifiedSender {
    const UNKNOWN: Self = Self { check: SenderCheck::Unverifiable, missing: 0 };
}

/// Signatures and sequence numbers of one link.
#[derive(Debug)]
pub struct FrameVerifier {
    signer: Option<LinkSigner>,
    present: BTreeMap<PeerId, SequenceTracker>,
    /// Peers that were present when the link was lost; one that returns under its id continues its sequence.
    suspended: BTreeMap<PeerId, SequenceTracker>,
    /// Totals of forgotten peers.
    closed_sources: BTreeMap<Address, SourceHealth>,
}

impl FrameVerifier {
    /// `signing` is the link's key; without one every sender is taken to be authentic.
    pub fn new(signing: Option<SigningConfig>) -> Self {
        Self {
            signer: signing.map(LinkSigner::new),
            present: BTreeMap::new(),
            suspended: BTreeMap::new(),
            closed_sources: BTreeMap::new(),
        }
    }

    /// Verifies a framer's frame. A framer's error has no sender. Fails if the link has a key and the frame's signature
    /// is invalid.
    pub fn verify(
        &mut self,
        now: Timestamp<HostClock>,
        peer: PeerId,
        found: &FramerOutput<'_>,
    ) -> Result<VerifiedSender, SignatureError> {
        let (FramerOutput::Frame(frame) | FramerOutput::UnknownFrame(frame)) = found else {
            return Ok(VerifiedSender::UNKNOWN);
        };
        let is_authentic = match &mut self.signer {
            Some(signer) => {
                signer.verify(now, frame)?;
                signer.is_authenticated(frame)
            }
            None => true,
        };
        if matches!(found, FramerOutput::UnknownFrame(_)) || !is_authentic {
            return Ok(VerifiedSender::UNKNOWN);
        }
        let suspended = &mut self.suspended;
        let sequences = self.present.entry(peer).or_insert_with(|| suspended.remove(&peer).unwrap_or_default());
        Ok(VerifiedSender { check: SenderCheck::Verified, missing: sequences.record(frame, now) })
    }

    /// Whether a known, authentic frame came from a peer.
    pub fn has_accepted(&self, peer: PeerId) -> bool {
        self.present.contains_key(&peer)
    }

    /// Forgets a peer that will not return; its counts are kept.
    pub fn forget(&mut self, peer: PeerId) {
        if let Some(sequences) = self.present.remove(&peer) {
            add_sources(&mut self.closed_sources, &sequences);
            retain_most_active(&mut self.closed_sources);
        }
    }

    /// The link was lost. The next frame of each sender still continues its sequence, so that frames sent in the
    /// meantime count as missing.
    pub fn handle_link_loss(&mut self) {
        for (peer, mut sequences) in std::mem::take(&mut self.present) {
            sequences.handle_link_loss();
            self.suspended.insert(peer, sequences);
        }
        while self.suspended.len() > MAX_SUSPENDED
            && let Some((_, sequences)) = self.suspended.pop_first()
        {
            add_sources(&mut self.closed_sources, &sequences);
        }
    }

    pub fn source_health(&self) -> Vec<SourceHealth> {
        let mut sources = self.closed_sources.clone();
        for sequences in self.present.values().chain(self.suspended.values()) {
            add_sources(&mut sources, sequences);
        }
        retain_most_active(&mut sources);
        sources.into_values().collect()
    }

    pub const fn is_signed(&self) -> bool {
        self.signer.is_some()
    }

    /// Signs the next outgoing frame; `None` without a key, or when there is no later signing time.
    pub fn next_signer(&mut self, now: Timestamp<HostClock>) -> Option<FrameSigner<'_>> {
        self.signer.as_mut()?.next_signer(now)
    }

    /// The state to keep for a restart; `None` without a key.
    pub fn signing_state(&self, now: Timestamp<HostClock>) -> Option<SigningState> {
        self.signer.as_ref().map(|signer| signer.state(now))
    }

    pub fn signing_stream_count(&self) -> u64 {
        self.signer.as_ref().map_or(0, LinkSigner::streams_seen)
    }
}

/// Keeps the senders with the most frames, up to the limit: the others are invented, or damage.
fn retain_most_active(sources: &mut BTreeMap<Address, SourceHealth>) {
    if sources.len() <= MAX_SENDERS {
        return;
    }
    let mut by_frames: Vec<_> = sources.values().map(|source| (source.frames, source.source)).collect();
    by_frames.sort_unstable();
    for (_, source) in &by_frames[..by_frames.len() - MAX_SENDERS] {
        sources.remove(source);
    }
}

fn add_sources(sums: &mut BTreeMap<Address, SourceHealth>, sequences: &SequenceTracker) {
    for added in sequences.source_health() {
        let sum = sums.entry(added.source).or_insert(SourceHealth { source: added.source, frames: 0, lost: 0 });
        sum.frames += added.frames;
        sum.lost += added.lost;
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::dialect::Encoder;
    use crate::framing::{Framer, FramerConfig, WireVersion};
    use crate::message::{Heartbeat, Message};
    use crate::signing::{Key, UnsignedPolicy};

    const ROBOT: Address = Address::new(1, 1);
    const PEER: PeerId = PeerId(0);

    fn heartbeats(count: usize) -> Vec<Vec<u8>> {
        let beat = Message::Heartbeat(Heartbeat { vehicle_type: 10, autopilot: 8, base_mode: 0, system_status: 4 });
        let mut encoder = Encoder::new(WireVersion::V2);
        let mut frames = vec![Vec::new(); count];
        for frame in &mut frames {
            encoder.encode(ROBOT, &beat, frame);
        }
        frames
    }

    fn verify(verifier: &mut FrameVerifier, peer: PeerId, frames: &[Vec<u8>]) -> Vec<Result<u32, SignatureError>> {
        let mut verdicts = Vec::new();
        let mut framer = Framer::new(FramerConfig::default());
        for frame in frames {
            framer.push(Timestamp::ZERO, frame, &mut |found| {
                let verdict = verifier.verify(Timestamp::ZERO, peer, &found);
                verdicts.push(verdict.map(|sender| sender.missing));
            });
        }
        verdicts
    }

    #[test]
    fn gaps_are_counted_peer_by_peer_and_kept_over_a_loss_of_the_link() {
        let mut verifier = FrameVerifier::new(None);
        let frames = heartbeats(8);
        assert_eq!(verify(&mut verifier, PEER, &frames[..1]), [Ok(0)]);
        assert_eq!(verify(&mut verifier, PeerId(1), &frames[5..6]), [Ok(0)], "another robot with the same address");
        assert_eq!(verify(&mut verifier, PEER, &frames[3..4]), [Ok(2)]);
        verifier.handle_link_loss();
        // Without timestamps it is unknown whether the next frame is of the same sender.
        assert_eq!(verify(&mut verifier, PEER, &frames[6..7]), [Ok(0)]);
        let health = SourceHealth { source: ROBOT, frames: 4, lost: 2 };
        assert_eq!(verifier.source_health(), [health]);
        verifier.forget(PEER);
        assert_eq!(verifier.source_health(), [health], "what a peer has counted stays counted");
    }

    #[test]
    fn invented_senders_are_dropped_before_busy_ones() {
        let sender = |index: u16| Address::new((index >> 8) as u8, index as u8);
        let frames = |index: u16| if index == 3 { 50 } else { u64::from(index >= 5) + 1 };
        let health = |index| (sender(index), SourceHealth { source: sender(index), frames: frames(index), lost: 0 });
        let mut sources: BTreeMap<_, _> = (0..MAX_SENDERS as u16 + 4).map(health).collect();
        retain_most_active(&mut sources);
        assert_eq!(sources.len(), MAX_SENDERS);
        let dropped: Vec<u16> = (0..10).filter(|index| !sources.contains_key(&sender(*index))).collect();
        assert_eq!(dropped, [0, 1, 2, 4]);
    }

    #[test]
    fn an_unsigned_frame_on_a_link_with_a_key_is_rejected_and_counted_for_no_sender() {
        let signing = SigningConfig {
            key: Key::from_bytes([7; 32]),
            link_id: 1,
            unsigned: UnsignedPolicy::RejectExcept(BTreeSet::new()),
            state: SigningState::default(),
        };
        let mut verifier = FrameVerifier::new(Some(signing));
        assert!(verifier.is_signed());
        assert_eq!(verify(&mut verifier, PEER, &heartbeats(1)), [Err(SignatureError::Unsigned)]);
        assert!(verifier.source_health().is_empty());
    }
}

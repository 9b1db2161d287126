//! The peers of one link: each has a scanner and sequence numbers of its own.
//!
//! Where the link has a key, a frame that is refused for its signature is none of its sender's: it moves no sequence number
//! and counts as missing when the next one comes, because nobody knows who has sent it.
//!
//! Bytes of several peers must not mix in one scanner, and two robots behind one port may bear the same address. A peer that
//! has been silent for long is forgotten; what it had counted stays counted.

use std::collections::BTreeMap;

use posebridge_protocol::framing::{
    ScanCounters, Scanned, Scanner, ScannerConfig, SequenceTracker,
};
use posebridge_protocol::signing::LinkSigning;
use posebridge_telemetry::{Address, HostClock, PeerId, Refusal, SourceHealth, Span, Stamp};

/// Silence after which a peer is forgotten: three times as long as ports remember one, so that they decide.
const IDLE: Span = Span::from_millis(30_000);
/// Most peers of one link; the most silent goes first. As many as a UDP port remembers.
const MOST_PEERS: usize = 4_096;
/// So many are remembered over a loss of the link, those with the highest numbers: a link with one peer always calls it 0, and a
/// link with several gives whoever returns a new number.
const MOST_RESTING: usize = 16;

/// The peers of one link.
#[derive(Debug)]
pub(crate) struct Peers {
    config: ScannerConfig,
    /// Signs and judges; all peers of a link share its key and its streams.
    pub(crate) signing: Option<LinkSigning>,
    present: BTreeMap<PeerId, Peer>,
    /// The numbers of those that were there when the link was lost: one that comes back under its name goes on.
    resting: BTreeMap<PeerId, SequenceTracker>,
    /// What those that are gone had counted.
    gone: ScanCounters,
    gone_sources: BTreeMap<Address, SourceHealth>,
}

#[derive(Debug)]
struct Peer {
    scanner: Scanner,
    sequences: SequenceTracker,
    last_heard: Stamp<HostClock>,
}

impl Peers {
    pub(crate) const fn new(config: ScannerConfig, signing: Option<LinkSigning>) -> Self {
        Self {
            config,
            signing,
            present: BTreeMap::new(),
            resting: BTreeMap::new(),
            gone: NOTHING,
            gone_sources: BTreeMap::new(),
        }
    }

    /// Bytes of a peer; what is found in them goes to `sink`, with how many more frames of the sender are known to be missing, or
    /// why it must not be believed.
    pub(crate) fn push(
        &mut self,
        now: Stamp<HostClock>,
        id: PeerId,
        bytes: &[u8],
        sink: &mut impl FnMut(Scanned<'_>, Result<u32, Refusal>),
    ) {
        if !self.present.contains_key(&id) {
            self.make_room(now);
        }
        let resting = &mut self.resting;
        let peer = self.present.entry(id).or_insert_with(|| Peer {
            scanner: Scanner::new(self.config),
            sequences: resting.remove(&id).unwrap_or_default(),
            last_heard: now,
        });
        peer.last_heard = now;
        let (signing, sequences) = (&mut self.signing, &mut peer.sequences);
        peer.scanner.push(now, bytes, &mut |scanned| {
            let verdict = judge(signing.as_mut(), now, &scanned)
                .map(|()| newly_missing(now, sequences, &scanned));
            sink(scanned, verdict);
        });
    }

    /// Whether anybody but this peer was heard of late.
    pub(crate) fn has_other_than(&self, id: PeerId) -> bool {
        self.present.keys().any(|present| *present != id)
    }

    /// Peers whose waiting bytes are to be given up now.
    pub(crate) fn stalled(&self, now: Stamp<HostClock>) -> Vec<PeerId> {
        self.present
            .iter()
            .filter(|(_, peer)| peer.scanner.deadline().is_some_and(|due| due <= now))
            .map(|(id, _)| *id)
            .collect()
    }

    /// Gives up what waits of a peer.
    pub(crate) fn give_up(
        &mut self,
        now: Stamp<HostClock>,
        id: PeerId,
        sink: &mut impl FnMut(Scanned<'_>, Result<u32, Refusal>),
    ) {
        if let Some(peer) = self.present.get_mut(&id) {
            let (signing, sequences) = (&mut self.signing, &mut peer.sequences);
            peer.scanner.tick(now, &mut |scanned| {
                let verdict = judge(signing.as_mut(), now, &scanned)
                    .map(|()| newly_missing(now, sequences, &scanned));
                sink(scanned, verdict);
            });
        }
    }

    /// When [`Self::stalled`] has somebody next.
    pub(crate) fn deadline(&self) -> Option<Stamp<HostClock>> {
        self.present
            .values()
            .filter_map(|peer| peer.scanner.deadline())
            .min()
    }

    /// The link was lost: nothing that was half received goes on. What a sender says next still follows what it said last, so
    /// that what it sent meanwhile is known to be missing.
    pub(crate) fn restart(&mut self) {
        for (id, mut peer) in std::mem::take(&mut self.present) {
            self.gone = sum(self.gone, *peer.scanner.counters());
            peer.sequences.break_off();
            self.resting.insert(id, peer.sequences);
        }
        while self.resting.len() > MOST_RESTING
            && let Some((_, sequences)) = self.resting.pop_first()
        {
            add_sources(&mut self.gone_sources, &sequences);
        }
    }

    /// Counts of all peers, those included that are gone.
    pub(crate) fn counters(&self) -> ScanCounters {
        let present = self.present.values().map(|peer| peer.scanner.counters());
        present.fold(self.gone, |a, b| sum(a, *b))
    }

    /// What each sender has sent, in the order of their addresses.
    pub(crate) fn sources(&self) -> Vec<SourceHealth> {
        let mut sources = self.gone_sources.clone();
        let present = self.present.values().map(|peer| &peer.sequences);
        for sequences in present.chain(self.resting.values()) {
            add_sources(&mut sources, sequences);
        }
        sources.into_values().collect()
    }

    fn make_room(&mut self, now: Stamp<HostClock>) {
        let idle: Vec<PeerId> = self
            .present
            .iter()
            .filter(|(_, peer)| now - peer.last_heard > IDLE)
            .map(|(id, _)| *id)
            .collect();
        let most_silent = (self.present.len() - idle.len() >= MOST_PEERS)
            .then(|| self.present.iter().min_by_key(|(_, peer)| peer.last_heard))
            .flatten()
            .map(|(id, _)| *id);
        for id in idle.into_iter().chain(most_silent) {
            if let Some(peer) = self.present.remove(&id) {
                self.count_gone(&peer);
            }
        }
    }

    fn count_gone(&mut self, peer: &Peer) {
        self.gone = sum(self.gone, *peer.scanner.counters());
        add_sources(&mut self.gone_sources, &peer.sequences);
    }
}

const NOTHING: ScanCounters = ScanCounters {
    frames: 0,
    checksum_errors: 0,
    garbage_bytes: 0,
    unknown_ids: 0,
    stalls: 0,
    impossible_headers: 0,
};

fn sum(a: ScanCounters, b: ScanCounters) -> ScanCounters {
    ScanCounters {
        frames: a.frames + b.frames,
        checksum_errors: a.checksum_errors + b.checksum_errors,
        garbage_bytes: a.garbage_bytes + b.garbage_bytes,
        unknown_ids: a.unknown_ids + b.unknown_ids,
        stalls: a.stalls + b.stalls,
        impossible_headers: a.impossible_headers + b.impossible_headers,
    }
}

/// Whether a frame is to be believed; what is no frame needs no signature. Frames with unknown ids are signed like others.
fn judge(
    signing: Option<&mut LinkSigning>,
    now: Stamp<HostClock>,
    scanned: &Scanned<'_>,
) -> Result<(), Refusal> {
    match (signing, scanned) {
        (Some(signing), Scanned::Frame(frame) | Scanned::Unknown(frame)) => {
            signing.judge(now, frame)
        }
        (None, _) | (_, Scanned::Defect(_)) => Ok(()),
    }
}

fn newly_missing(
    now: Stamp<HostClock>,
    sequences: &mut SequenceTracker,
    scanned: &Scanned<'_>,
) -> u32 {
    match scanned {
        Scanned::Frame(frame) => sequences.take(frame, now),
        Scanned::Unknown(_) | Scanned::Defect(_) => 0,
    }
}

fn add_sources(sums: &mut BTreeMap<Address, SourceHealth>, sequences: &SequenceTracker) {
    for said in sequences.sources() {
        let sum = sums.entry(said.source).or_insert(SourceHealth {
            source: said.source,
            frames: 0,
            lost: 0,
        });
        sum.frames += said.frames;
        sum.lost += said.lost;
    }
}

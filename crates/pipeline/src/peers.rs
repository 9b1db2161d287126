//! The peers of one link: each has a scanner and sequence numbers of its own.
//!
//! Where the link has a key, a frame that is refused for its signature is none of its sender's: it moves no sequence number
//! and counts as missing when the next one comes, because nobody knows who has sent it. The same holds for one that may come
//! without a signature.
//!
//! Bytes of several peers must not mix in one scanner, and two robots behind one port may bear the same address. A peer that
//! has been silent for long is forgotten; what it had counted stays counted.

use std::collections::{BTreeMap, BTreeSet};

use posebridge_protocol::framing::{ScanCounters, Scanned, Scanner, ScannerConfig, SequenceTracker};
use posebridge_protocol::routing::{Check, MOST_PEERS, ROUTE_LIFETIME};
use posebridge_protocol::signing::LinkSigning;
use posebridge_telemetry::{Address, HostClock, PeerId, Refusal, SourceHealth, Span, Stamp};

/// Silence after which a peer is forgotten; nobody is reached by it any more.
const IDLE: Span = ROUTE_LIFETIME;
/// Where the port says how many peers there are, somebody else must have been heard since its last word but one: it tells each second.
const PORT_NEWS: Span = Span::from_millis(2_000);
/// Most senders of one link of which the health tells; those with the most frames. A class of robots has a few hundred.
const MOST_SENDERS: usize = 1_024;
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
    /// Whose bytes wait for more, by the instant at which they are given up.
    waiting: BTreeSet<(Stamp<HostClock>, PeerId)>,
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

/// What is known of the sender of a frame that is believed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Believed {
    /// Whether he is who the frame says.
    pub(crate) check: Check,
    /// How many more of his frames are now known to be missing.
    pub(crate) missing: u32,
}

impl Believed {
    /// Of whom nothing is learnt, or nobody.
    const UNKNOWN: Self = Self { check: Check::Unverifiable, missing: 0 };
}

impl Peers {
    pub(crate) fn new(config: ScannerConfig, signing: Option<LinkSigning>) -> Self {
        Self {
            config,
            signing,
            present: BTreeMap::new(),
            resting: BTreeMap::new(),
            waiting: BTreeSet::new(),
            gone: ScanCounters::default(),
            gone_sources: BTreeMap::new(),
        }
    }

    /// Bytes of a peer; what is found in them goes to `sink`, with what is known of its sender or why it must not be believed.
    pub(crate) fn push(
        &mut self,
        now: Stamp<HostClock>,
        id: PeerId,
        bytes: &[u8],
        sink: &mut impl FnMut(Scanned<'_>, Result<Believed, Refusal>),
    ) {
        if self.present.len() >= MOST_PEERS && !self.present.contains_key(&id) {
            self.forget_most_silent();
        }
        let resting = &mut self.resting;
        let peer = self.present.entry(id).or_insert_with(|| Peer {
            scanner: Scanner::new(self.config),
            sequences: resting.remove(&id).unwrap_or_default(),
            last_heard: now,
        });
        peer.last_heard = now;
        self.feed(now, id, |scanner, found| scanner.push(now, bytes, found), sink);
    }

    /// Whether anybody but this peer is there, as far as was heard of late. `told` is how many peers the port has told of; zero if
    /// it has not.
    pub(crate) fn has_other_than(&self, id: PeerId, now: Stamp<HostClock>, told: u32) -> bool {
        // A peer that only listens was never heard, but the port knows of it; and of one that was replaced.
        let recent = match told {
            0 => IDLE,
            1 => PORT_NEWS,
            _ => return true,
        };
        let mut others = self.present.iter().filter(|(other, _)| **other != id);
        others.any(|(_, peer)| now - peer.last_heard <= recent)
    }

    /// Peers whose waiting bytes are to be given up now.
    pub(crate) fn stalled(&self, now: Stamp<HostClock>) -> Vec<PeerId> {
        let due = self.waiting.iter().take_while(|(due, _)| *due <= now);
        due.map(|(_, id)| *id).collect()
    }

    /// A peer was silent for as long as its frames are waited for: what hides behind a torn one comes to light.
    pub(crate) fn give_up(
        &mut self,
        now: Stamp<HostClock>,
        id: PeerId,
        sink: &mut impl FnMut(Scanned<'_>, Result<Believed, Refusal>),
    ) {
        self.feed(now, id, |scanner, found| scanner.tick(now, found), sink);
    }

    /// The line to a peer broke: whole frames that hide behind a torn one come to light, the rest is dropped.
    pub(crate) fn end(
        &mut self,
        now: Stamp<HostClock>,
        id: PeerId,
        sink: &mut impl FnMut(Scanned<'_>, Result<Believed, Refusal>),
    ) {
        self.feed(now, id, |scanner, found| scanner.break_off(found), sink);
    }

    /// Those that are there.
    pub(crate) fn present(&self) -> Vec<PeerId> {
        self.present.keys().copied().collect()
    }

    /// Lets the scanner of a peer that is there do something; what it finds is judged and handed on.
    fn feed(
        &mut self,
        now: Stamp<HostClock>,
        id: PeerId,
        work: impl FnOnce(&mut Scanner, &mut dyn FnMut(Scanned<'_>)),
        sink: &mut impl FnMut(Scanned<'_>, Result<Believed, Refusal>),
    ) {
        let Some(peer) = self.present.get_mut(&id) else {
            return;
        };
        let waited = peer.scanner.deadline();
        let (signing, sequences) = (&mut self.signing, &mut peer.sequences);
        work(&mut peer.scanner, &mut |scanned| {
            let verdict = judge(signing.as_mut(), now, sequences, &scanned);
            sink(scanned, verdict);
        });
        let waits = peer.scanner.deadline();
        self.wait(id, waited, waits);
    }

    /// When [`Self::stalled`] has somebody next.
    pub(crate) fn deadline(&self) -> Option<Stamp<HostClock>> {
        self.waiting.first().map(|(due, _)| *due)
    }

    /// Peers that have been silent for long are there no more.
    pub(crate) fn forget_idle(&mut self, now: Stamp<HostClock>) {
        let silent = self.present.iter();
        let silent = silent.filter(|(_, peer)| now - peer.last_heard > IDLE);
        let silent: Vec<PeerId> = silent.map(|(id, _)| *id).collect();
        self.forget(&silent);
    }

    /// The link was lost: nothing that was half received goes on. What a sender says next still follows what it said last, so
    /// that what it sent meanwhile is known to be missing.
    pub(crate) fn restart(&mut self) {
        self.waiting.clear();
        for (id, mut peer) in std::mem::take(&mut self.present) {
            self.gone = self.gone.plus(peer.scanner.counters());
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
        present.fold(self.gone, ScanCounters::plus)
    }

    /// What each sender has sent, in the order of their addresses.
    pub(crate) fn sources(&self) -> Vec<SourceHealth> {
        let mut sources = self.gone_sources.clone();
        let present = self.present.values().map(|peer| &peer.sequences);
        for sequences in present.chain(self.resting.values()) {
            add_sources(&mut sources, sequences);
        }
        keep_most_heard(&mut sources);
        sources.into_values().collect()
    }

    fn wait(&mut self, id: PeerId, waited: Option<Stamp<HostClock>>, waits: Option<Stamp<HostClock>>) {
        if waited != waits {
            if let Some(due) = waited {
                self.waiting.remove(&(due, id));
            }
            self.waiting.extend(waits.map(|due| (due, id)));
        }
    }

    /// Makes room by a quarter at a time, so that a flood of invented peers does not cost a search for each.
    fn forget_most_silent(&mut self) {
        let peers = self.present.iter();
        let mut by_silence: Vec<_> = peers.map(|(id, peer)| (peer.last_heard, *id)).collect();
        by_silence.sort_unstable();
        by_silence.truncate(MOST_PEERS / 4);
        let silent: Vec<PeerId> = by_silence.into_iter().map(|(_, id)| id).collect();
        self.forget(&silent);
    }

    fn forget(&mut self, ids: &[PeerId]) {
        for id in ids {
            if let Some(mut peer) = self.present.remove(id) {
                let waits = peer.scanner.deadline();
                self.wait(*id, waits, None);
                if waits.is_none() {
                    // A frame that stopped in its middle is not completed any more, and nothing hides behind it.
                    peer.scanner.finish(&mut |_| {});
                }
                self.count_gone(&peer);
            }
        }
        keep_most_heard(&mut self.gone_sources);
    }

    fn count_gone(&mut self, peer: &Peer) {
        self.gone = self.gone.plus(peer.scanner.counters());
        add_sources(&mut self.gone_sources, &peer.sequences);
    }
}

/// Whether a find is to be believed; what is no frame needs no signature. Frames with unknown ids are signed like others.
fn judge(
    signing: Option<&mut LinkSigning>,
    now: Stamp<HostClock>,
    sequences: &mut SequenceTracker,
    scanned: &Scanned<'_>,
) -> Result<Believed, Refusal> {
    let (Scanned::Frame(frame) | Scanned::Unknown(frame)) = scanned else {
        return Ok(Believed::UNKNOWN);
    };
    let is_vouched_for = match signing {
        Some(signing) => {
            signing.judge(now, frame)?;
            signing.vouches_for(frame)
        }
        None => true,
    };
    if matches!(scanned, Scanned::Unknown(_)) || !is_vouched_for {
        return Ok(Believed::UNKNOWN);
    }
    Ok(Believed { check: Check::Verified, missing: sequences.take(frame, now) })
}

/// Of more senders than anybody has, those with the most frames stay: the others were invented, or damage.
fn keep_most_heard(sources: &mut BTreeMap<Address, SourceHealth>) {
    if sources.len() <= MOST_SENDERS {
        return;
    }
    let mut by_frames: Vec<_> = sources.values().map(|said| (said.frames, said.source)).collect();
    by_frames.sort_unstable();
    for (_, source) in &by_frames[..by_frames.len() - MOST_SENDERS] {
        sources.remove(source);
    }
}

fn add_sources(sums: &mut BTreeMap<Address, SourceHealth>, sequences: &SequenceTracker) {
    for said in sequences.sources() {
        let sum = sums.entry(said.source).or_insert(SourceHealth { source: said.source, frames: 0, lost: 0 });
        sum.frames += said.frames;
        sum.lost += said.lost;
    }
}

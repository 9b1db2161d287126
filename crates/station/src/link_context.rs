//! The receiving side of one link: its state, its framers or its codec, its verifier, its counters.

use std::collections::BTreeSet;

use posebridge_protocol::bricks::BrickCodec;
use posebridge_protocol::frame_verifier::FrameVerifier;
use posebridge_protocol::framing::FramerConfig;
use posebridge_protocol::routing::LinkSharing;
use posebridge_telemetry::{HostClock, LinkHealth, LinkState, PeerId, SourceHealth, TimeDelta, Timestamp};

use crate::config::{AcceptedVersions, LinkConfig};
use crate::decoder::Decoder;
use crate::peer_framers::PeerFramers;

pub(crate) struct LinkContext {
    pub(crate) state: LinkState,
    has_been_up: bool,
    pub(crate) health: LinkHealth,
    pub(crate) framers: PeerFramers,
    pub(crate) verifier: FrameVerifier,
    pub(crate) decoder: Decoder,
    /// Peers whose heartbeat has the type ground station.
    pub(crate) ground_stations: BTreeSet<PeerId>,
    /// The codec of a brick that does not use MAVLink; then framers and verifier are unused.
    pub(crate) codec: Option<Box<dyn BrickCodec>>,
    pub(crate) losses: LossAlarm,
}

/// Says when a link loses so many frames that a robot notices.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LossAlarm {
    reported: Option<Timestamp<HostClock>>,
    was_receiving: bool,
}

impl LossAlarm {
    /// Compares two reports of the link, a second apart; `None` if few frames were lost between them, if it was said lately, or if the
    /// sender has just come back: what it sent meanwhile is another event.
    pub(crate) fn observe(
        &mut self,
        now: Timestamp<HostClock>,
        before: &LinkHealth,
        after: &LinkHealth,
    ) -> Option<String> {
        let lost = after.frames_lost.saturating_sub(before.frames_lost);
        let all = lost + after.frames_in.saturating_sub(before.frames_in);
        let was_receiving = std::mem::replace(&mut self.was_receiving, after.frames_in > before.frames_in);
        let is_due = was_receiving && self.reported.is_none_or(|reported| now - reported >= LOSS_REPEAT);
        if !is_due || lost < MIN_LOST_FRAMES || (lost as f64) < MIN_LOST_SHARE * all as f64 {
            return None;
        }
        self.reported = Some(now);
        Some(format!("lost {lost} of {all} frames in a second: let the robot send less often, or bring it nearer"))
    }
}

/// Fewer lost frames than this, or a smaller share, harm no estimate.
const MIN_LOST_FRAMES: u64 = 5;
const MIN_LOST_SHARE: f64 = 0.1;
/// Time after which a loss that lasts is reported again.
const LOSS_REPEAT: TimeDelta = TimeDelta::from_millis(30_000);

impl LinkContext {
    pub(crate) fn new(config: &LinkConfig) -> Self {
        Self {
            state: LinkState::Down,
            has_been_up: false,
            health: LinkHealth::default(),
            framers: PeerFramers::new(FramerConfig {
                accept_v1: config.accepted_versions == AcceptedVersions::V1AndV2,
                transport: config.framing,
                ..FramerConfig::default()
            }),
            verifier: FrameVerifier::new(config.signing.clone()),
            decoder: Decoder::default(),
            ground_stations: BTreeSet::new(),
            losses: LossAlarm::default(),
            codec: config.brick.as_ref().map(|brick| (brick.protocol.open)(&brick.settings)),
        }
    }

    /// Sets the state of the link; incomplete input will never be completed.
    pub(crate) fn set_state(&mut self, now: Timestamp<HostClock>, state: LinkState) {
        if let (Some(codec), LinkState::Up) = (&mut self.codec, state) {
            codec.on_link_up(now);
        }
        match (self.state, state) {
            (LinkState::Down, LinkState::Up) => {
                self.health.reconnects += u64::from(self.has_been_up);
                self.has_been_up = true;
            }
            (_, LinkState::Down) => {
                self.framers.handle_link_loss();
                self.verifier.handle_link_loss();
                self.ground_stations.clear();
            }
            (LinkState::Up, LinkState::Up) => {}
        }
        self.state = state;
    }

    /// Whether a peer is alone on the link.
    pub(crate) fn sharing(&self, peer: PeerId, now: Timestamp<HostClock>) -> LinkSharing {
        let is_shared = self.framers.has_other_than(peer, now, self.health.port.peers);
        if is_shared { LinkSharing::Shared } else { LinkSharing::Exclusive }
    }

    /// Makes room for the framer of a new peer.
    pub(crate) fn admit_peer(&mut self, peer: PeerId) {
        let evicted = self.framers.admit(peer);
        self.forget(&evicted);
    }

    pub(crate) fn evict_idle_peers(&mut self, now: Timestamp<HostClock>) {
        let evicted = self.framers.evict_idle(now);
        self.forget(&evicted);
    }

    fn forget(&mut self, peers: &[PeerId]) {
        for peer in peers {
            self.verifier.forget(*peer);
            self.ground_stations.remove(peer);
        }
    }

    pub(crate) fn count_sent(&mut self, frame: &[u8]) {
        self.health.bytes_out += frame.len() as u64;
        self.health.frames_out += 1;
    }

    pub(crate) fn deadline(&self) -> Option<Timestamp<HostClock>> {
        [self.framers.deadline(), self.codec_deadline()].into_iter().flatten().min()
    }

    /// When to call the codec; never without a peer.
    pub(crate) fn codec_deadline(&self) -> Option<Timestamp<HostClock>> {
        let codec = self.codec.as_ref()?;
        (self.state == LinkState::Up).then(|| codec.deadline())?
    }

    /// Copies the framers' and senders' counters into the health record and returns the counters of each sender.
    pub(crate) fn refresh_health(&mut self) -> Vec<SourceHealth> {
        let (sources, counters) = match &self.codec {
            Some(codec) => (codec.source_health(), codec.counters()),
            None => (self.verifier.source_health(), self.framers.counters()),
        };
        self.health.frames_lost = sources.iter().map(|source| source.lost).sum();
        self.health.frames_in = counters.frames;
        self.health.checksum_errors = counters.checksum_errors;
        self.health.garbage_bytes = counters.garbage_bytes;
        self.health.unknown_ids = counters.unknown_ids;
        self.health.timeouts = counters.stalls;
        sources
    }
}

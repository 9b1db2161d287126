//! The receiving side of one link: its state, its framers or its codec, its verifier, its counters.

use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;

use posebridge_protocol::bricks::BrickCodec;
use posebridge_protocol::frame_verifier::FrameVerifier;
use posebridge_protocol::framing::FramerConfig;
use posebridge_protocol::routing::{LinkSharing, MAX_PEERS};
use posebridge_telemetry::{HostClock, LinkCounts, LinkHealth, LinkState, PeerId, SourceHealth, TimeDelta, Timestamp};

use crate::config::{AcceptedVersions, LinkConfig};
use crate::decoder::Decoder;
use crate::mavlink1_probe::Mavlink1Probe;
use crate::peer_framers::PeerFramers;
use crate::sender_pins::SenderPins;
use crate::token_bucket::{TokenBucket, TokenRate};

pub(crate) struct LinkContext {
    pub(crate) state: LinkState,
    has_been_up: bool,
    /// Whether the link has a peer. A transport whose peers come and go reports their number once a second.
    has_peer: bool,
    pub(crate) health: LinkHealth,
    pub(crate) framers: PeerFramers,
    /// Where garbage may be MAVLink 1.
    pub(crate) mavlink1_probe: Option<Mavlink1Probe>,
    pub(crate) verifier: FrameVerifier,
    pub(crate) decoder: Decoder,
    /// Peers whose heartbeat has the type ground station.
    pub(crate) ground_stations: BTreeSet<PeerId>,
    /// Whether it was said that there are too many.
    pub(crate) has_named_ground_stations: bool,
    /// Peers that have asked for parameters.
    pub(crate) parameter_clients: BTreeSet<PeerId>,
    /// The addresses of peers, where the transport knows them.
    hosts: BTreeMap<PeerId, IpAddr>,
    pub(crate) pins: Option<SenderPins>,
    forwarding: BTreeMap<PeerId, TokenBucket>,
    requests: BTreeMap<PeerId, TokenBucket>,
    /// The codec of a brick that does not use MAVLink; then framers and verifier are unused.
    pub(crate) codec: Option<Box<dyn BrickCodec>>,
    pub(crate) losses: LossAlarm,
}

/// Says when a link loses so many frames that a robot notices.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LossAlarm {
    reported: Option<Timestamp<HostClock>>,
    was_receiving: bool,
    kernel_drops: u64,
    drops_reported: Option<Timestamp<HostClock>>,
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

    /// Says how many datagrams the system has dropped since the last report of the link; `None` if there are none, or if it was said lately.
    pub(crate) fn observe_kernel(&mut self, now: Timestamp<HostClock>, kernel_drops: u64) -> Option<String> {
        let dropped = kernel_drops.saturating_sub(self.kernel_drops);
        let is_due = self.drops_reported.is_none_or(|reported| now - reported >= LOSS_REPEAT);
        if dropped == 0 || !is_due {
            return None;
        }
        self.kernel_drops = kernel_drops;
        self.drops_reported = Some(now);
        Some(format!(
            "lost {dropped} datagrams in the system's receive buffer: run `sudo sysctl net.core.rmem_max=4194304` and start again, \
             or let fewer robots send, or less often"
        ))
    }
}

/// Peers of a small network, which may hear each other.
const CROWD: usize = 16;

/// Each gets the estimates of all robots. Those that came first are served.
const MAX_GROUND_STATIONS: usize = 32;

/// Copies of its frames that one peer may cause in a second, and at once: ten ground stations see all of a robot that sends a thousand
/// frames a second.
const FORWARDED_COPIES: TokenRate = TokenRate { per_second: 10_000, burst: 10_000 };

/// Answers that one peer may cause. A ground station that connects asks for about a hundred; one that repeats its requests without end
/// gets less than 60 kB a second.
const REQUESTED_ANSWERS: TokenRate = TokenRate { per_second: 200, burst: 400 };

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
            has_peer: true,
            health: LinkHealth::default(),
            framers: PeerFramers::new(FramerConfig {
                accept_v1: config.accepted_versions == AcceptedVersions::V1AndV2,
                transport: config.framing,
                ..FramerConfig::default()
            }),
            mavlink1_probe: (config.accepted_versions == AcceptedVersions::V2 && config.brick.is_none())
                .then(|| Mavlink1Probe::new(config.framing)),
            verifier: FrameVerifier::new(config.signing.clone()),
            decoder: Decoder::default(),
            ground_stations: BTreeSet::new(),
            has_named_ground_stations: false,
            parameter_clients: BTreeSet::new(),
            hosts: BTreeMap::new(),
            pins: config.pin.map(SenderPins::new),
            forwarding: BTreeMap::new(),
            requests: BTreeMap::new(),
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
                self.has_peer = true;
            }
            (_, LinkState::Down) => {
                self.framers.handle_link_loss();
                self.verifier.handle_link_loss();
                self.ground_stations.clear();
                self.parameter_clients.clear();
                self.forwarding.clear();
                self.requests.clear();
                self.hosts.clear();
                if let Some(probe) = &mut self.mavlink1_probe {
                    probe.handle_link_loss();
                }
                if let Some(pins) = &mut self.pins {
                    pins.handle_link_loss();
                }
            }
            (LinkState::Up, LinkState::Up) => {}
        }
        self.state = state;
    }

    /// Whether so many peers send on the link that what is for all of them is too much for each: then only ground stations get it.
    pub(crate) fn is_crowded(&self) -> bool {
        self.framers.count() > CROWD
    }

    /// Notes the address of a peer. Beyond the limit the oldest is forgotten.
    pub(crate) fn set_host(&mut self, peer: PeerId, host: IpAddr) {
        if self.hosts.len() >= MAX_PEERS && !self.hosts.contains_key(&peer) {
            self.hosts.pop_first();
        }
        self.hosts.insert(peer, host);
    }

    pub(crate) fn host(&self, peer: PeerId) -> Option<IpAddr> {
        self.hosts.get(&peer).copied()
    }

    /// Notes a peer that calls itself a ground station; false if there are too many to serve.
    pub(crate) fn add_ground_station(&mut self, peer: PeerId) -> bool {
        let has_room = self.ground_stations.len() < MAX_GROUND_STATIONS || self.ground_stations.contains(&peer);
        if has_room {
            self.ground_stations.insert(peer);
        }
        has_room
    }

    /// Whether a peer may cause so many copies of one of its frames now; if so it is charged.
    pub(crate) fn charge_forwarding(&mut self, now: Timestamp<HostClock>, peer: PeerId, copies: usize) -> bool {
        self.forwarding.entry(peer).or_insert(TokenBucket::new(FORWARDED_COPIES)).charge(now, copies)
    }

    /// Whether a request of a peer may cause so many answers now; if so it is charged, else it is counted.
    pub(crate) fn charge_request(&mut self, now: Timestamp<HostClock>, peer: PeerId, answers: usize) -> bool {
        let is_covered = self.requests.entry(peer).or_insert(TokenBucket::new(REQUESTED_ANSWERS)).charge(now, answers);
        self.health.excess_requests += u64::from(!is_covered);
        is_covered
    }

    /// Notes a peer that reads parameters, like a ground station. Beyond the limit the first of them makes room.
    pub(crate) fn add_parameter_client(&mut self, peer: PeerId) {
        if self.parameter_clients.len() >= CROWD && !self.parameter_clients.contains(&peer) {
            self.parameter_clients.pop_first();
        }
        self.parameter_clients.insert(peer);
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
            self.parameter_clients.remove(peer);
            self.forwarding.remove(peer);
            self.requests.remove(peer);
            self.hosts.remove(peer);
            if let Some(probe) = &mut self.mavlink1_probe {
                probe.forget(*peer);
            }
        }
    }

    /// Whether something that a peer sent was understood. The codec of a brick does not say.
    pub(crate) fn understands(&self, peer: PeerId) -> bool {
        self.codec.is_some() || self.verifier.has_accepted(peer)
    }

    pub(crate) fn set_port_counts(&mut self, counts: LinkCounts) {
        self.health.port = counts;
        self.has_peer = counts.peers > 0;
    }

    /// Bytes came: a peer has connected since the transport's last counters.
    pub(crate) const fn note_peer(&mut self) {
        self.has_peer = true;
    }

    /// Counts a frame that the link is given: as sent, or as dropped where the link has no peer.
    pub(crate) fn count_sent(&mut self, frame: &[u8]) {
        if self.has_peer {
            self.health.bytes_out += frame.len() as u64;
            self.health.frames_out += 1;
        } else {
            self.health.drops_out += 1;
        }
    }

    pub(crate) fn count_forwarded(&mut self, frame: &[u8]) {
        self.count_sent(frame);
        self.health.forwarded += u64::from(self.has_peer);
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
        self.health.foreign_frames = counters.foreign_frames;
        self.health.checksum_errors = counters.checksum_errors;
        self.health.garbage_bytes = counters.garbage_bytes;
        self.health.unknown_ids = counters.unknown_ids;
        self.health.timeouts = counters.stalls;
        sources
    }
}

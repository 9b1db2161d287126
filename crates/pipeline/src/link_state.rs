//! What the pipeline keeps for one link: its peers, encoder, session, counters.

use posebridge_estimator::PARAMS;
use posebridge_protocol::bricks::BrickCodec;
use posebridge_protocol::dialect::commands::UNDERSTOOD;
use posebridge_protocol::dialect::{Encoder, ids};
use posebridge_protocol::framing::{ScannerConfig, WireVersion};
use posebridge_protocol::message::{Heartbeat, Message};
use posebridge_protocol::routing::Limiter;
use posebridge_protocol::session::{Session, SessionConfig, SessionOutput};
use posebridge_protocol::signing::LinkSigning;
use posebridge_telemetry::{Address, HostClock, LinkHealth, LinkState, SourceHealth, Span, Stamp};

use crate::config::{AcceptedVersions, LinkConfig, PipelineConfig, Voices};
use crate::peers::Peers;
use crate::publisher::{self, Publisher};
use crate::robot_voice::RobotVoice;

/// MAV_TYPE_ONBOARD_CONTROLLER.
const ONBOARD_CONTROLLER: u8 = 18;
/// MAV_AUTOPILOT_INVALID: not an autopilot.
const NOT_AN_AUTOPILOT: u8 = 8;
/// MAV_STATE_ACTIVE.
const ACTIVE: u8 = 4;
/// The common interval of heartbeats.
const HEARTBEAT_PERIOD: Span = Span::from_millis(1_000);
/// Five missed heartbeats: the usual limit of ground stations.
pub(crate) const PEER_TIMEOUT: Span = Span::from_millis(5_000);

/// Commands that are taken also when they are for all components: what people ask of the station, and questions about messages,
/// which whoever can may answer.
const SERVED: [u16; UNDERSTOOD.len() + 2] = {
    let [storage, start, stop, pose, reset, calibration, source] = UNDERSTOOD;
    [
        ids::COMMAND_GET_MESSAGE_INTERVAL,
        ids::COMMAND_REQUEST_MESSAGE,
        storage,
        start,
        stop,
        pose,
        reset,
        calibration,
        source,
    ]
};

/// As whom something is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Speaker {
    /// As the station itself.
    Station,
    /// As the robot, on a link for ground stations.
    Robot,
}

/// One link.
pub(crate) struct Link {
    /// Who is heard there; the bytes of each are a stream of their own.
    pub(crate) peers: Peers,
    /// The codec of a brick that speaks no MAVLink; then the peers hear nothing.
    pub(crate) codec: Option<Box<dyn BrickCodec>>,
    pub(crate) encoder: Encoder,
    /// The MAVLink version that is spoken there.
    pub(crate) speaks: WireVersion,
    /// Holds back what would be too much.
    pub(crate) limiter: Limiter,
    pub(crate) session: Session<HostClock>,
    /// The robot's voice, where the station lends it one.
    pub(crate) voice: Option<RobotVoice>,
    pub(crate) publisher: Publisher,
    pub(crate) state: LinkState,
    /// It has been up before.
    was_up: bool,
    pub(crate) health: LinkHealth,
}

impl Link {
    pub(crate) fn new(config: &LinkConfig, pipeline: &PipelineConfig, now: Stamp<HostClock>) -> Self {
        Self {
            peers: Peers::new(scanner_config(config), config.signing.clone().map(LinkSigning::new)),
            codec: config.brick.as_ref().map(|brick| (brick.protocol.open)(&brick.settings)),
            encoder: Encoder::new(config.speaks),
            speaks: config.speaks,
            limiter: Limiter::new(config.rules.limits.clone(), now),
            session: session(config, pipeline, now),
            voice: (config.voices == Voices::OwnAndRobot && config.brick.is_none()).then(RobotVoice::default),
            publisher: Publisher::new(&config.outputs),
            state: LinkState::Down,
            was_up: false,
            health: LinkHealth::default(),
        }
    }

    /// The link came up or was lost: then what was half received will never be completed.
    pub(crate) fn turn(&mut self, now: Stamp<HostClock>, state: LinkState) {
        if let (Some(codec), LinkState::Up) = (&mut self.codec, state) {
            codec.begin(now);
        }
        match (self.state, state) {
            (LinkState::Down, LinkState::Up) => {
                self.health.reconnects += u64::from(self.was_up);
                self.was_up = true;
            }
            (_, LinkState::Down) => self.peers.restart(),
            (LinkState::Up, LinkState::Up) => {}
        }
        self.state = state;
    }

    /// What the conversations on the link want next, and whose it is.
    pub(crate) fn poll_conversation(&mut self) -> Option<(Speaker, SessionOutput<HostClock>)> {
        if let Some(output) = self.session.poll() {
            return Some((Speaker::Station, output));
        }
        let output = self.voice.as_mut()?.poll()?;
        Some((Speaker::Robot, output))
    }

    /// Whether the conversations on the link want nothing.
    pub(crate) fn is_silent(&self) -> bool {
        self.session.is_silent() && self.voice.as_ref().is_none_or(RobotVoice::is_silent)
    }

    /// The conversation of one of them; `None` if the robot has no voice there.
    pub(crate) fn conversation(&mut self, speaker: Speaker) -> Option<&mut Session<HostClock>> {
        match speaker {
            Speaker::Station => Some(&mut self.session),
            Speaker::Robot => self.voice.as_mut()?.session(),
        }
    }

    /// When anything on the link must be woken.
    pub(crate) fn deadline(&self) -> Option<Stamp<HostClock>> {
        let all = [
            self.session.deadline(),
            self.voice.as_ref().and_then(RobotVoice::deadline),
            self.peers.deadline(),
            self.codec_deadline(),
        ];
        all.into_iter().flatten().min()
    }

    /// Whether anything on the link waits for an instant that has come.
    pub(crate) fn is_due(&mut self, now: Stamp<HostClock>) -> bool {
        let others = [self.peers.deadline(), self.codec_deadline()];
        others.into_iter().flatten().any(|due| due <= now)
            || self.session.is_due(now)
            || self.voice.as_mut().is_some_and(|voice| voice.is_due(now))
    }

    /// When the codec must be woken; never while there is nobody to talk to.
    pub(crate) fn codec_deadline(&self) -> Option<Stamp<HostClock>> {
        let codec = self.codec.as_ref()?;
        (self.state == LinkState::Up).then(|| codec.deadline())?
    }

    /// Appends a message of our own, signed if the link has a key, and returns its length; 0 if it cannot be sent there.
    pub(crate) fn encode(
        &mut self,
        now: Stamp<HostClock>,
        own: Address,
        message: &Message,
        out: &mut Vec<u8>,
    ) -> usize {
        if let Some(codec) = &mut self.codec {
            return codec.encode(now, own, message, out);
        }
        let Some(signing) = &mut self.peers.signing else {
            return self.encoder.encode(own, message, out);
        };
        // Without a stamp nothing leaves: an unsigned frame would tell the peers that signatures do not matter.
        signing.next_seal(now).map_or(0, |seal| self.encoder.encode_signed(own, message, &seal, out))
    }

    /// Brings the scanners' and senders' counters into the health record and returns what each sender has sent.
    pub(crate) fn refresh_health(&mut self) -> Vec<SourceHealth> {
        let (sources, counters) = match &self.codec {
            Some(codec) => (codec.sources(), codec.counters()),
            None => (self.peers.sources(), self.peers.counters()),
        };
        self.health.frames_lost = sources.iter().map(|source| source.lost).sum();
        self.health.frames_in = counters.frames;
        self.health.checksum_errors = counters.checksum_errors;
        self.health.garbage_bytes = counters.garbage_bytes;
        self.health.unknown_ids = counters.unknown_ids;
        self.health.stalls = counters.stalls;
        sources
    }
}

fn scanner_config(config: &LinkConfig) -> ScannerConfig {
    ScannerConfig {
        accept_v1: config.version == AcceptedVersions::V1AndV2,
        transport: config.framing,
        ..ScannerConfig::default()
    }
}

fn session(config: &LinkConfig, pipeline: &PipelineConfig, now: Stamp<HostClock>) -> Session<HostClock> {
    let mut session = Session::new(session_config(config, pipeline), now);
    let params = &pipeline.filter_config.params;
    session.offer_parameters(
        PARAMS
            .iter()
            // In capitals, as MAVLink's parameters are: MAVProxy asks for no others.
            .map(|row| (row.key.to_ascii_uppercase(), (row.read)(params) as f32)),
    );
    session.serve_commands(&SERVED);
    session
}

/// A conversation of the station's on any link.
pub(crate) fn conversation_of(pipeline: &PipelineConfig) -> SessionConfig {
    SessionConfig {
        own: pipeline.own,
        heartbeat: Heartbeat {
            vehicle_type: ONBOARD_CONTROLLER,
            autopilot: NOT_AN_AUTOPILOT,
            base_mode: 0,
            system_status: ACTIVE,
        },
        heartbeat_period: HEARTBEAT_PERIOD,
        timesync_period: Some(pipeline.timesync_period),
        peer_timeout: PEER_TIMEOUT,
        wanted: pipeline.wanted.clone(),
        offered: publisher::SETTABLE.iter().map(|(id, _)| *id).collect(),
    }
}

fn session_config(link: &LinkConfig, pipeline: &PipelineConfig) -> SessionConfig {
    let conversation = conversation_of(pipeline);
    // Who speaks no MAVLink cannot be asked for its messages.
    let wanted = match link.brick {
        Some(_) => Vec::new(),
        None => conversation.wanted.clone(),
    };
    SessionConfig { wanted, ..conversation }
}

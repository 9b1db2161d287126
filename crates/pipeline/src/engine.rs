//! The engine: bytes in, events and bytes out, as one deterministic value.
//!
//! Here stand the value itself, its doors and its time; what it does with bytes, conversations and estimates stands in the
//! modules below.

mod announce;
mod bricks;
mod commands;
mod converse;
mod deliver;
mod fix_requests;
mod forward;
mod ground_station;
mod intake;
mod outbox;
mod receive;
mod requests;
mod slip_watch;
mod warmth;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use posebridge_estimator::{Filter, Params, filter_named};
use posebridge_protocol::routing::{Forward, Router, RouterConfig, Way};
use posebridge_protocol::signing::{LinkSigning, Memory};
use posebridge_telemetry::{
    Address, BrickClock, Calibration, CameraClock, DriveGeometry, Estimate, Event, FusionRecord, HostClock, Input,
    LinkId, LinkState, Output, PeerId, Radians, RobotId, SensorId, Span, Stamp,
};

use self::announce::Announcer;
use self::commands::Standing;
use self::fix_requests::FixRequests;
use self::ground_station::LastRange;
use self::intake::{Arrival, Arrived, Came};
use self::outbox::Outbox;
use self::slip_watch::SlipWatch;
use crate::clock::align::ClockAligner;
use crate::config::PipelineConfig;
use crate::interpret::Interpreter;
use crate::link_state::{Link, Speaker};
use crate::thermometers::Thermometers;
use forward::Seen;

/// Health of every link is told once per second.
const HEALTH_PERIOD: Span = Span::from_millis(1_000);
/// MAV_SEVERITY_WARNING.
const SEVERITY_WARNING: u8 = 4;

/// Why a pipeline could not be built.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// There is no such filter.
    #[error("unknown filter `{name}`; there are: {known}")]
    UnknownFilter {
        /// The name that was asked for.
        name: String,
        /// The names that there are.
        known: String,
    },
    /// Two links have one id.
    #[error("link id {id} is used twice")]
    DuplicateLink {
        /// The id.
        id: LinkId,
    },
}

/// One robot's pipeline: decode, align clocks, estimate, publish.
///
/// After every [`handle`](Self::handle) call [`poll`](Self::poll) until it returns `None`. [`deadline`](Self::deadline)
/// says when to call `handle` with [`Input::Tick`]. The same configuration and the same inputs give the same outputs, bit for bit.
pub struct Pipeline {
    config: PipelineConfig,
    links: BTreeMap<LinkId, Link>,
    /// So many links are for ground stations.
    voices: usize,
    router: Router,
    robot: Option<RobotId>,
    /// By which way and when the robot was heard last.
    robot_heard: Option<(Way, Stamp<HostClock>)>,
    filter: Box<dyn Filter>,
    interpreter: Interpreter,
    brick_clock: ClockAligner<BrickClock>,
    observers: BTreeMap<(LinkId, Address), ClockAligner<CameraClock>>,
    /// Who has sent fixes in clocks of their own, in the order of their first: each is a sensor of its own.
    cameras: Vec<(LinkId, Address)>,
    fix_requests: FixRequests,
    /// What was told of payloads without sense, once for each sender and message.
    told_payloads: BTreeSet<(LinkId, Address, u32)>,
    last_gyro_turn: Option<(Stamp<BrickClock>, Radians)>,
    slip: SlipWatch,
    thermometers: Thermometers,
    /// Normalised innovation squared of the last fix over its gate; 0 before the first.
    fix_ratio: f64,
    /// The gate that was looked up last, because a search for each fix takes longer than its use: degrees of freedom, probability,
    /// quantile of chi-square.
    fix_gate: Option<(u8, f64, f64)>,
    /// The robot's range as it was observed last.
    last_range: Option<LastRange>,
    /// What became of each sensor's last observation that could be held against a prediction.
    last_records: BTreeMap<SensorId, FusionRecord>,
    /// What ground stations are told in words.
    announcer: Announcer,
    described: bool,
    /// What people have asked and still holds.
    standing: Standing,
    /// Something was observed since the last estimate left.
    is_news: bool,
    /// The estimate that the robot has been sent and the others not yet.
    for_others: Option<Estimate>,
    /// What was seen on a link and is to be counted and sent on.
    passages: Vec<(LinkId, Seen)>,
    /// The memory in which the messages of an input are kept until all of its bytes are read.
    spare: Vec<Arrived>,
    /// Nothing is left to do of the last input.
    is_complete: bool,
    next_health: Option<Stamp<HostClock>>,
    /// The latest instant of any input so far: everything is planned, signed and limited by it. It never falls.
    now: Stamp<HostClock>,
    outputs: Outbox,
    /// Frames of others on their way to another link. They leave after what is our own: nobody steers by them.
    passed_on: VecDeque<Output>,
}

impl Pipeline {
    /// A pipeline that has seen nothing; `now` is the first instant of its session.
    ///
    /// # Errors
    /// The filter is unknown, or two links share an id.
    pub fn new(config: PipelineConfig, now: Stamp<HostClock>) -> Result<Self, BuildError> {
        let entry = filter_named(&config.filter).ok_or_else(|| BuildError::UnknownFilter {
            name: config.filter.clone(),
            known: posebridge_estimator::FILTERS.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
        })?;
        let mut links = BTreeMap::new();
        for link in &config.links {
            if links.insert(link.id, Link::new(link, &config, now)).is_some() {
                return Err(BuildError::DuplicateLink { id: link.id });
            }
        }
        Ok(Self {
            voices: links.values().filter(|link| link.voice.is_some()).count(),
            links,
            router: Router::new(router_config(&config)),
            robot: None,
            robot_heard: None,
            filter: (entry.build)(&config.filter_config),
            interpreter: Interpreter { geometry: config.filter_config.geometry, tag_in_body: config.tag_in_body },
            brick_clock: ClockAligner::default(),
            observers: BTreeMap::new(),
            cameras: Vec::new(),
            fix_requests: FixRequests::default(),
            told_payloads: BTreeSet::new(),
            last_gyro_turn: None,
            slip: SlipWatch::default(),
            thermometers: Thermometers::default(),
            fix_ratio: 0.0,
            fix_gate: None,
            last_range: None,
            last_records: BTreeMap::new(),
            announcer: Announcer::default(),
            described: false,
            standing: Standing::new(config.filter_config.params),
            is_news: false,
            for_others: None,
            passages: Vec::new(),
            spare: Vec::new(),
            is_complete: true,
            next_health: (!config.links.is_empty()).then(|| now + HEALTH_PERIOD),
            now,
            outputs: Outbox::default(),
            passed_on: VecDeque::new(),
            config,
        })
    }

    /// Takes one input that came at `arrival`.
    ///
    /// Bytes that waited for their turn may have come before what was handled before them. Their own instant counts where it says
    /// something about a remote clock; time itself does not go back for them.
    ///
    /// Only what leads to the robot's estimate is done here; the rest is done when that has been polled. Poll until `None`
    /// before [`deadline`](Self::deadline) is asked.
    pub fn handle(&mut self, arrival: Stamp<HostClock>, input: &Input) {
        self.complete();
        let now = self.now.max(arrival);
        self.now = now;
        match input {
            Input::Bytes { link, peer, bytes } => {
                self.handle_bytes(arrival, (*link, *peer), Came::Bytes(bytes));
            }
            Input::Link { link, state } => self.handle_link(*link, *state),
            Input::Port { link, counts } => {
                if let Some(link) = self.links.get_mut(link) {
                    link.health.port = *counts;
                }
            }
            Input::Observation(observation) => {
                let robot = self.robot.unwrap_or_default();
                self.observe(robot, robot.address, arrival, *observation);
            }
            Input::Command(command) => self.handle_command(*command),
            Input::Report { severity, text } => self.handle_report(*severity, text),
            Input::Tick => {}
        }
        // What is due goes first: a time request that waited behind the estimate would measure that, too.
        if self.is_due(now) {
            self.pass_time(now);
        }
        self.publish_to_robot(now);
        self.is_complete = false;
    }

    /// What nobody waits for of the input before: estimates for the others, frames that go on, what time brings.
    fn complete(&mut self) {
        if std::mem::replace(&mut self.is_complete, true) {
            return;
        }
        let now = self.now;
        self.publish_to_others(now);
        self.finish_passages(now);
        self.router.settle(now);
        self.pass_time(now);
        // What waited of a peer that fell silent may have been news, too.
        self.publish_to_robot(now);
        self.publish_to_others(now);
        self.finish_passages(now);
        self.settle_temperatures();
        self.say_texts();
    }

    fn finish_passages(&mut self, now: Stamp<HostClock>) {
        if self.passages.is_empty() {
            return;
        }
        let mut passages = std::mem::take(&mut self.passages);
        for (link, seen) in passages.drain(..) {
            self.finish_passage(now, link, &seen);
        }
        // Its memory is wanted again.
        self.passages = passages;
    }

    /// The next output: our own and what happened, oldest first, then what is passed on, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        if self.outputs.is_empty() {
            self.complete();
        }
        if self.outputs.is_empty() {
            return self.passed_on.pop_front();
        }
        self.outputs.pop()
    }

    /// The same where it stands, for who only looks at it; it stays until [`Self::pass_over`]. An output is large.
    pub fn peek(&mut self) -> Option<&Output> {
        if self.outputs.is_empty() {
            self.complete();
        }
        self.outputs.front().or_else(|| self.passed_on.front())
    }

    /// Leaves out the next output, after [`Self::peek`].
    pub fn pass_over(&mut self) {
        if !self.outputs.pass_over() {
            self.passed_on.pop_front();
        }
    }

    /// When to call [`handle`](Self::handle) with [`Input::Tick`], at the latest.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<HostClock>> {
        let links = self.links.values().filter_map(Link::deadline);
        links.chain(self.next_health).min()
    }

    /// The belief for a brick instant; see [`Filter::estimate_at`].
    #[must_use]
    pub fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<Estimate> {
        self.filter.estimate_at(stamp)
    }

    /// What the filter has learned about the robot, relative to [`Self::geometry`]; see [`Filter::calibration`].
    #[must_use]
    pub fn calibration(&self) -> Option<Calibration> {
        self.filter.calibration()
    }

    /// The tunables as they are set.
    #[must_use]
    pub const fn params(&self) -> &Params {
        &self.config.filter_config.params
    }

    /// The nominal geometry that the filter works with: the configured one, or the one that the robot has described.
    #[must_use]
    pub const fn geometry(&self) -> DriveGeometry {
        self.config.filter_config.geometry
    }

    /// The latest instant of which an observation spoke.
    #[must_use]
    pub fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.filter.latest()
    }

    /// What the signing of a link must still know after a restart, as of `now`; `None` if the link is not signed.
    #[must_use]
    pub fn signing_memory(&self, link: LinkId, now: Stamp<HostClock>) -> Option<Memory> {
        let signing = self.links.get(&link)?.peers.signing.as_ref()?;
        Some(signing.memory(now))
    }

    /// How many signed streams were heard for the first time, over all links. When it has grown, the memories should be
    /// written down at once; see [`LinkSigning::streams_met`](posebridge_protocol::signing::LinkSigning::streams_met).
    #[must_use]
    pub fn signing_streams_met(&self) -> u64 {
        let signings = self.links.values().filter_map(|link| link.peers.signing.as_ref());
        signings.map(LinkSigning::streams_met).sum()
    }

    fn handle_link(&mut self, id: LinkId, state: LinkState) {
        let Some(link) = self.links.get(&id) else {
            return;
        };
        if state == LinkState::Down {
            // Before the link's turn: a torn beginning may have hidden whole frames, which came while it was up.
            for peer in link.peers.present() {
                self.handle_bytes(self.now, (id, peer), Came::End);
            }
        }
        if let Some(link) = self.links.get_mut(&id) {
            link.turn(self.now, state);
        }
        if state == LinkState::Down {
            self.router.forget_link(id);
        }
        self.tell(Event::Link { link: id, state });
        self.ask_brick(id);
    }

    /// Whether anything waits for an instant that has come.
    fn is_due(&mut self, now: Stamp<HostClock>) -> bool {
        let is_health_due = self.next_health.is_some_and(|due| due <= now);
        is_health_due || self.links.values_mut().any(|link| link.is_due(now))
    }

    fn pass_time(&mut self, now: Stamp<HostClock>) {
        self.show_robot();
        if self.is_due(now) {
            self.wake(now);
        } else {
            self.drain_sessions(now);
        }
    }

    /// Does what is due.
    fn wake(&mut self, now: Stamp<HostClock>) {
        let ids: Vec<LinkId> = self.links.keys().copied().collect();
        for id in &ids {
            let stalled = self.links.get(id).map_or_else(Vec::new, |link| link.peers.stalled(now));
            for peer in stalled {
                // Before the session's turn: what comes to light may give it something to do at once.
                self.handle_bytes(now, (*id, peer), Came::Gap);
            }
            self.wake_brick(now, *id);
            if let Some(link) = self.links.get_mut(id) {
                link.session.tick(now);
                if let Some(session) = link.conversation(Speaker::Robot) {
                    session.tick(now);
                }
            }
            let way = Way { link: *id, peer: PeerId::default() };
            self.drain_session(Arrival { way, at: now });
        }
        if let Some(due) = self.next_health.filter(|due| *due <= now) {
            // From the due time, not from now: the period must not drift with the load.
            let missed = (now - due).as_nanos() / HEALTH_PERIOD.as_nanos();
            let ahead_nanos = (missed + 1).saturating_mul(HEALTH_PERIOD.as_nanos());
            self.next_health = Some(due + Span::from_nanos(ahead_nanos));
            for id in ids {
                if let Some(link) = self.links.get_mut(&id) {
                    link.peers.forget_idle(now);
                }
                self.tell_health(id);
            }
        }
    }

    fn tell_health(&mut self, id: LinkId) {
        let home = self.router.first_of_group(id);
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let sources = link.refresh_health();
        if self.robot.is_some_and(|robot| robot.link == home) {
            link.health.round_trip = self.brick_clock.round_trip();
            link.health.clock_uncertainty = self.brick_clock.uncertainty();
        }
        let health = link.health;
        self.tell(Event::Health { link: id, health, sources });
    }

    fn tell(&mut self, event: Event) {
        if self.voices > 0 {
            self.announce_and_tell(event);
        } else {
            // On this way nobody has a reference to the event, so that it is copied once only: to where it waits.
            self.outputs.tell(event);
        }
    }

    #[inline(never)]
    fn announce_and_tell(&mut self, event: Event) {
        self.announce(&event);
        self.outputs.tell(event);
    }
}

fn router_config(config: &PipelineConfig) -> RouterConfig {
    let rules = config.links.iter().map(|link| {
        let mut rules = link.rules.clone();
        // A brick that speaks no MAVLink would take the others' frames for noise.
        if link.brick.is_some() {
            rules.forward = Forward::Nothing;
        }
        (link.id, rules)
    });
    RouterConfig { own: config.own, duplicate_window: config.duplicate_window, links: rules.collect() }
}

//! The engine: bytes in, events and bytes out, as one deterministic value.

use std::collections::{BTreeMap, VecDeque};

use posebridge_estimator::{Filter, StartPose, filter_named};
use posebridge_protocol::dialect;
use posebridge_protocol::framing::{FrameRef, Scanned};
use posebridge_protocol::message::{Message, RobotDescription};
use posebridge_protocol::session::SessionOutput;
use posebridge_telemetry::{
    Address, BrickClock, CameraClock, Command, Defect, Event, HostClock, Input, LinkId, LinkState,
    Observation, Observed, Output, Radians, RadiansPerSecond, RobotId, Span, Stamp, SystemId,
};

use crate::clock::align::{Alignment, ClockAligner};
use crate::clock::unwrap::Unwrapped;
use crate::config::{DescriptionPolicy, OutputInstant, OutputStream, PipelineConfig};
use crate::interpret::{Interpreter, Reading, StampedBy};
use crate::link_state::Link;
use crate::publish::{self, Prediction};

/// Health of every link is told once per second.
const HEALTH_PERIOD: Span = Span::from_millis(1_000);
/// An integral of the gyro over a longer gap than this says nothing about the rate.
const LONGEST_GYRO_GAP: Span = Span::from_millis(1_000);
/// The integral on the wire has 32 bits of microradians.
const GYRO_TURN_PERIOD_RAD: f64 = 4_294.967_296;

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
    robot: Option<RobotId>,
    filter: Box<dyn Filter>,
    interpreter: Interpreter,
    brick_clock: ClockAligner<BrickClock>,
    observers: BTreeMap<(LinkId, Address), ClockAligner<CameraClock>>,
    last_gyro_turn: Option<(Stamp<BrickClock>, Radians)>,
    described: bool,
    /// Something was observed since the last estimate left.
    is_news: bool,
    next_health: Option<Stamp<HostClock>>,
    outputs: VecDeque<Output>,
}

impl Pipeline {
    /// A pipeline that has seen nothing; `now` is the first instant of its session.
    ///
    /// # Errors
    /// The filter is unknown, or two links share an id.
    pub fn new(config: PipelineConfig, now: Stamp<HostClock>) -> Result<Self, BuildError> {
        let entry = filter_named(&config.filter).ok_or_else(|| BuildError::UnknownFilter {
            name: config.filter.clone(),
            known: posebridge_estimator::FILTERS
                .iter()
                .map(|entry| entry.name)
                .collect::<Vec<_>>()
                .join(", "),
        })?;
        let mut links = BTreeMap::new();
        for link in &config.links {
            if links
                .insert(link.id, Link::new(link, &config, now))
                .is_some()
            {
                return Err(BuildError::DuplicateLink { id: link.id });
            }
        }
        Ok(Self {
            links,
            robot: None,
            filter: (entry.build)(&config.filter_config),
            interpreter: Interpreter {
                geometry: config.filter_config.geometry,
                tag_in_body: config.tag_in_body,
            },
            brick_clock: ClockAligner::default(),
            observers: BTreeMap::new(),
            last_gyro_turn: None,
            described: false,
            is_news: false,
            next_health: (!config.links.is_empty()).then(|| now + HEALTH_PERIOD),
            outputs: VecDeque::new(),
            config,
        })
    }

    /// Takes one input that came at `now`.
    pub fn handle(&mut self, now: Stamp<HostClock>, input: &Input) {
        match input {
            Input::Bytes { link, bytes } => self.handle_bytes(now, *link, Some(bytes)),
            Input::Link { link, state } => self.handle_link(*link, *state),
            Input::Observation(observation) => {
                let robot = self.robot.unwrap_or_default();
                self.observe(robot, robot.address, now, *observation);
            }
            Input::Command(command) => self.handle_command(*command),
            Input::Tick => {}
        }
        self.pass_time(now);
        self.publish_news(now);
    }

    /// The next output, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When to call [`handle`](Self::handle) with [`Input::Tick`], at the latest.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<HostClock>> {
        let links = self
            .links
            .values()
            .flat_map(|link| [link.scanner.deadline(), link.session.deadline()])
            .flatten();
        links.chain(self.next_health).min()
    }

    /// The belief for a brick instant; see [`Filter::estimate_at`].
    #[must_use]
    pub fn estimate_at(&self, stamp: Stamp<BrickClock>) -> Option<posebridge_telemetry::Estimate> {
        self.filter.estimate_at(stamp)
    }

    /// The latest instant of which an observation spoke.
    #[must_use]
    pub fn latest(&self) -> Option<Stamp<BrickClock>> {
        self.filter.latest()
    }

    fn handle_bytes(&mut self, now: Stamp<HostClock>, id: LinkId, bytes: Option<&[u8]>) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if let Some(bytes) = bytes {
            link.health.bytes_in += bytes.len() as u64;
        }
        let mut arrived: Vec<(Address, Message)> = Vec::new();
        let mut events: Vec<Event> = Vec::new();
        let sequences = &mut link.sequences;
        let frames_lost = &mut link.health.frames_lost;
        let mut sink = |scanned: Scanned<'_>| match scanned {
            Scanned::Frame(frame) => {
                let frames = sequences.missing_before(frame.source, frame.sequence);
                if frames > 0 {
                    *frames_lost += u64::from(frames);
                    events.push(Event::Defect {
                        link: id,
                        defect: Defect::Lost {
                            source: frame.source,
                            frames,
                        },
                    });
                }
                take_frame(id, &frame, &mut arrived, &mut events);
            }
            Scanned::Unknown(_) => {}
            Scanned::Defect(defect) => events.push(Event::Defect { link: id, defect }),
        };
        match bytes {
            Some(bytes) => link.scanner.push(now, bytes, &mut sink),
            None => link.scanner.tick(now, &mut sink),
        }
        self.outputs.extend(events.into_iter().map(Output::Event));
        for (source, message) in arrived {
            self.handle_message(now, id, source, &message);
        }
    }

    fn handle_message(
        &mut self,
        now: Stamp<HostClock>,
        id: LinkId,
        source: Address,
        message: &Message,
    ) {
        if let Some(link) = self.links.get_mut(&id) {
            link.session.handle(now, source, message);
        }
        self.drain_session(id);
        match message {
            Message::StatusText { severity, text } => {
                self.tell(Event::Text {
                    source,
                    severity: *severity,
                    text: text.clone(),
                });
            }
            Message::RobotDescription(description) => self.handle_description(description),
            _ => {}
        }
        for reading in self.interpreter.readings(message).into_iter().flatten() {
            self.handle_reading(now, id, source, &reading);
        }
    }

    fn handle_reading(
        &mut self,
        now: Stamp<HostClock>,
        id: LinkId,
        source: Address,
        reading: &Reading,
    ) {
        let from_robot = self
            .robot
            .is_some_and(|robot| robot.link == id && robot.address == source);
        match reading.stamped_by {
            StampedBy::Brick => {
                if let Some(robot) = self.adopt_robot(id, source) {
                    self.handle_brick_reading(now, robot, reading);
                }
            }
            StampedBy::Observer if from_robot => {
                if let Some(robot) = self.robot {
                    self.handle_brick_reading(now, robot, reading);
                }
            }
            StampedBy::Observer => self.handle_observer_reading(now, id, source, reading),
        }
    }

    /// The robot that a sender of odometry is: the first of the configured system, and nobody else after it.
    fn adopt_robot(&mut self, link: LinkId, address: Address) -> Option<RobotId> {
        if self
            .config
            .robot_system
            .is_some_and(|wanted: SystemId| wanted != address.system)
        {
            return None;
        }
        let candidate = RobotId { link, address };
        match self.robot {
            Some(robot) => (robot == candidate).then_some(robot),
            None => {
                self.robot = Some(candidate);
                Some(candidate)
            }
        }
    }

    fn handle_brick_reading(&mut self, now: Stamp<HostClock>, robot: RobotId, reading: &Reading) {
        let stamp = match self.brick_clock.arrived(reading.stamp, now) {
            Unwrapped::Continued(stamp) => stamp,
            Unwrapped::Restarted(stamp) => {
                self.brick_restarted(robot);
                stamp
            }
        };
        let observed = self.whole_turn_rate(stamp, reading);
        let observation = Observation {
            sensor: reading.sensor,
            stamp,
            stamp_sigma: Span::ZERO,
            observed,
        };
        self.observe(robot, robot.address, now, observation);
    }

    /// The mean rate since the sensor's last observation that arrived: from the integral, where the sender has one.
    fn whole_turn_rate(&mut self, stamp: Stamp<BrickClock>, reading: &Reading) -> Observed {
        let Some(turn) = reading.gyro_turn else {
            return reading.observed;
        };
        let before = self.last_gyro_turn.replace((stamp, turn));
        let Some((last_stamp, last_turn)) = before else {
            return reading.observed;
        };
        let gap = stamp - last_stamp;
        if gap <= Span::ZERO || gap > LONGEST_GYRO_GAP {
            return reading.observed;
        }
        let turned_rad = (turn.0 - last_turn.0 + 0.5 * GYRO_TURN_PERIOD_RAD)
            .rem_euclid(GYRO_TURN_PERIOD_RAD)
            - 0.5 * GYRO_TURN_PERIOD_RAD;
        Observed::TurnRate(RadiansPerSecond(turned_rad / gap.as_secs_f64()))
    }

    fn handle_observer_reading(
        &mut self,
        now: Stamp<HostClock>,
        link: LinkId,
        source: Address,
        reading: &Reading,
    ) {
        let clock = self.observers.entry((link, source)).or_default();
        let (Unwrapped::Continued(stamp) | Unwrapped::Restarted(stamp)) =
            clock.arrived(reading.stamp, now);
        let on_brick = clock.host_at(stamp).and_then(|(host, camera_off)| {
            let (brick, brick_off) = self.brick_clock.remote_at(host)?;
            Some((brick, sigma_of(camera_off + brick_off)))
        });
        match (on_brick, self.robot) {
            (Some((stamp, stamp_sigma)), Some(robot)) => {
                let observation = Observation {
                    sensor: reading.sensor,
                    stamp,
                    stamp_sigma,
                    observed: reading.observed,
                };
                self.observe(robot, source, now, observation);
            }
            _ => self.tell(Event::Defect {
                link,
                defect: Defect::Unaligned { source },
            }),
        }
    }

    fn observe(
        &mut self,
        robot: RobotId,
        source: Address,
        arrival: Stamp<HostClock>,
        observation: Observation,
    ) {
        self.tell(Event::Observed {
            robot,
            source,
            arrival,
            observation,
        });
        let record = self.filter.observe(&observation);
        let mut health = Vec::new();
        for (id, link) in &mut self.links {
            health.extend(
                link.publisher
                    .fusion_health(&record)
                    .map(|message| (*id, message)),
            );
        }
        for (id, message) in health {
            self.transmit(id, &message);
        }
        self.tell(Event::Fused { robot, record });
        self.is_news = true;
    }

    fn brick_restarted(&mut self, robot: RobotId) {
        self.filter.restart_clock();
        self.last_gyro_turn = None;
        self.tell(Event::BrickRestarted { robot });
    }

    fn handle_description(&mut self, description: &RobotDescription) {
        if self.described || self.config.description == DescriptionPolicy::Ignore {
            return;
        }
        self.described = true;
        let mut filter_config = self.config.filter_config;
        let turn = std::f64::consts::TAU;
        filter_config.geometry.left_wheel_radius = description.left_wheel_radius;
        filter_config.geometry.right_wheel_radius = description.right_wheel_radius;
        filter_config.geometry.track_width = description.track_width;
        filter_config.geometry.tick = Radians(turn / description.ticks_per_turn);
        let sensible = [
            description.left_wheel_radius.0,
            description.right_wheel_radius.0,
            description.track_width.0,
            filter_config.geometry.tick.0,
        ]
        .into_iter()
        .all(|value| value.is_finite() && value > 0.0);
        if !sensible || filter_config.geometry == self.config.filter_config.geometry {
            return;
        }
        self.config.filter_config = filter_config;
        self.interpreter.geometry = filter_config.geometry;
        if let Some(estimate) = self
            .filter
            .latest()
            .and_then(|latest| self.filter.estimate_at(latest))
        {
            filter_config.start = Some(StartPose {
                pose: estimate.pose,
                position_sigma_m: estimate.x_sigma_m().max(estimate.y_sigma_m()),
                heading_sigma_rad: estimate.heading_sigma_rad(),
            });
        }
        if let Some(entry) = filter_named(&self.config.filter) {
            self.filter = (entry.build)(&filter_config);
        }
    }

    fn handle_link(&mut self, id: LinkId, state: LinkState) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if link.state == LinkState::Down && state == LinkState::Up && link.health.frames_in > 0 {
            link.health.reconnects += 1;
        }
        link.state = state;
        if state == LinkState::Down {
            link.restart();
        }
        self.tell(Event::Link { link: id, state });
    }

    fn handle_command(&mut self, command: Command) {
        match command {
            Command::SetPose {
                pose,
                position_sigma_m,
                heading_sigma_rad,
            } => {
                self.filter.set_pose(&StartPose {
                    pose,
                    position_sigma_m,
                    heading_sigma_rad,
                });
                self.is_news = true;
            }
        }
    }

    fn pass_time(&mut self, now: Stamp<HostClock>) {
        let ids: Vec<LinkId> = self.links.keys().copied().collect();
        for id in &ids {
            let Some(link) = self.links.get_mut(id) else {
                continue;
            };
            let is_stalled = link
                .scanner
                .deadline()
                .is_some_and(|deadline| deadline <= now);
            link.session.tick(now);
            if is_stalled {
                self.handle_bytes(now, *id, None);
            }
            self.drain_session(*id);
        }
        if let Some(due) = self.next_health.filter(|due| *due <= now) {
            // From the due time, not from now: the period must not drift with the load.
            let missed = (now - due).as_nanos() / HEALTH_PERIOD.as_nanos();
            self.next_health =
                Some(due + Span::from_nanos((missed + 1) * HEALTH_PERIOD.as_nanos()));
            for id in ids {
                self.tell_health(id);
            }
        }
    }

    fn tell_health(&mut self, id: LinkId) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        link.refresh_health();
        if self.robot.is_some_and(|robot| robot.link == id) {
            link.health.round_trip = self.brick_clock.round_trip();
            link.health.clock_uncertainty = self.brick_clock.uncertainty();
        }
        let health = link.health;
        self.tell(Event::Health { link: id, health });
    }

    fn drain_session(&mut self, id: LinkId) {
        while let Some(output) = self.links.get_mut(&id).and_then(|link| link.session.poll()) {
            match output {
                // Nobody hears it; the session says it again when the link is back.
                SessionOutput::Send(_) if self.is_down(id) => {}
                SessionOutput::Send(message) => self.transmit(id, &message),
                SessionOutput::PeerSeen { peer, .. } => {
                    self.tell(Event::RobotSeen {
                        robot: RobotId {
                            link: id,
                            address: peer,
                        },
                    });
                }
                SessionOutput::PeerLost { peer, silence } => {
                    self.tell(Event::RobotLost {
                        robot: RobotId {
                            link: id,
                            address: peer,
                        },
                        silence,
                    });
                }
                SessionOutput::TimeExchanged {
                    peer,
                    sent,
                    received,
                    peer_nanos,
                } => {
                    self.handle_exchange(id, peer, (sent, received), peer_nanos);
                }
                // Nobody asks the station for intervals: its outputs are configured.
                SessionOutput::IntervalRequested { .. } => {}
            }
        }
    }

    fn is_down(&self, id: LinkId) -> bool {
        self.links
            .get(&id)
            .is_none_or(|link| link.state == LinkState::Down)
    }

    fn handle_exchange(
        &mut self,
        id: LinkId,
        peer: Address,
        (sent, received): (Stamp<HostClock>, Stamp<HostClock>),
        peer_nanos: i64,
    ) {
        let robot = self
            .robot
            .filter(|robot| robot.link == id && robot.address == peer);
        if let Some(robot) = robot {
            let (unwrapped, alignment) = self.brick_clock.exchanged(sent, received, peer_nanos);
            if matches!(unwrapped, Unwrapped::Restarted(_)) {
                self.brick_restarted(robot);
            }
            if let Some(Alignment {
                remote,
                host,
                offset,
                skew_ppm,
                uncertainty,
                round_trip,
            }) = alignment
            {
                self.tell(Event::BrickClockAligned {
                    robot,
                    offset,
                    skew_ppm,
                    uncertainty,
                    round_trip: Some(round_trip),
                    brick: remote,
                    host,
                });
            }
            return;
        }
        let clock = self.observers.entry((id, peer)).or_default();
        if let (_, Some(alignment)) = clock.exchanged(sent, received, peer_nanos) {
            self.tell(Event::CameraClockAligned {
                camera: peer,
                offset: alignment.offset,
                uncertainty: alignment.uncertainty,
                stamp: alignment.remote,
                host: alignment.host,
            });
        }
    }

    /// One estimate per input that brought news, for the latest instant that was observed.
    fn publish_news(&mut self, now: Stamp<HostClock>) {
        if !std::mem::take(&mut self.is_news) {
            return;
        }
        let Some(estimate) = self
            .filter
            .latest()
            .and_then(|latest| self.filter.estimate_at(latest))
        else {
            return;
        };
        let robot = self.robot.unwrap_or_default();
        self.tell(Event::Estimated { robot, estimate });
        let ids: Vec<LinkId> = self.links.keys().copied().collect();
        for id in ids {
            let due = match self.links.get_mut(&id) {
                Some(link) if link.state == LinkState::Up => link.publisher.due(now),
                _ => continue,
            };
            for stream in due {
                if let Some(message) = self.message_for(&stream, &estimate, now) {
                    self.transmit(id, &message);
                }
            }
        }
    }

    fn message_for(
        &self,
        stream: &OutputStream,
        observed: &posebridge_telemetry::Estimate,
        now: Stamp<HostClock>,
    ) -> Option<Message> {
        let arrival = now + publish::travel_time(self.brick_clock.round_trip());
        let ahead = match stream.instant {
            OutputInstant::Observed => None,
            OutputInstant::Arrival => self.brick_clock.remote_at(arrival).map(|(brick, _)| brick),
        };
        match ahead
            .filter(|brick| *brick > observed.stamp)
            .and_then(|brick| self.filter.estimate_at(brick))
        {
            Some(predicted) => {
                publish::message(stream.kind, &predicted, Prediction::Ahead, arrival)
            }
            None => {
                let host = self
                    .brick_clock
                    .host_at(observed.stamp)
                    .map_or(now, |(host, _)| host);
                publish::message(stream.kind, observed, Prediction::None, host)
            }
        }
    }

    fn transmit(&mut self, id: LinkId, message: &Message) {
        let own = self.config.own;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if link.state == LinkState::Down {
            link.health.drops_out += 1;
            return;
        }
        let mut bytes = Vec::new();
        link.encoder.encode(own, message, &mut bytes);
        link.health.bytes_out += bytes.len() as u64;
        link.health.frames_out += 1;
        self.outputs.push_back(Output::Transmit { link: id, bytes });
    }

    fn tell(&mut self, event: Event) {
        self.outputs.push_back(Output::Event(event));
    }
}

fn take_frame(
    link: LinkId,
    frame: &FrameRef<'_>,
    arrived: &mut Vec<(Address, Message)>,
    events: &mut Vec<Event>,
) {
    match dialect::decode(frame) {
        Ok(Some(message)) => arrived.push((frame.source, message)),
        Ok(None) => {}
        Err(error) => {
            let defect = Defect::Payload {
                message_id: error.message_id(),
            };
            events.push(Event::Defect { link, defect });
        }
    }
}

/// Standard deviation of an instant that lies anywhere within plus or minus `bound`: uniform.
fn sigma_of(bound: Span) -> Span {
    Span::from_secs_f64(bound.as_secs_f64() / 3.0_f64.sqrt())
}

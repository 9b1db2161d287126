//! The station: bytes in, events and bytes out, as one deterministic value for any number of robots.
//!
//! Data pass the stages in one direction: framers, verifier, router and decoder (in [`Station::receive`]), sessions,
//! then each robot's clock, estimator and publisher, then egress. The flow is here; `observations` handles the content
//! of messages, `commands` the operator's requests.

use std::collections::BTreeMap;

use posebridge_estimator::Params;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{Endpoint, FrameRouter};
use posebridge_protocol::session::SessionOutput;
use posebridge_protocol::signing::SigningState;
use posebridge_telemetry::{
    Event, HostClock, Input, LinkId, LinkState, Output, PeerId, Priority, RobotId, StationInput, TimeDelta, Timestamp,
    severity,
};

use crate::config::{BuildError, StationConfig};
use crate::egress::Egress;
use crate::link_command::LinkCommand;
use crate::link_context::LinkContext;
use crate::missing_sensor_report::SensorInventory;
use crate::mission::Missions;
use crate::observers::Observers;
use crate::operator::OperatorState;
use crate::output_queue::OutputQueue;
use crate::peer_framers::FramerInput;
use crate::receive::{ReceiveInfo, TimeExchange, owned};
use crate::receive_pass::{ReceivePass, ReceivedBatch};
use crate::robot::Robot;
use crate::robot_table::RobotTable;
use crate::sessions::{SenderRole, Sessions};
use crate::status_text::{StatusTextQueue, TextContext};
use crate::thermometer_bank::ThermometerBank;
use crate::transmitter::Transmitter;
use crate::vehicle_proxy::CommandResponder;
use crate::vehicle_status::vehicle_status;

/// The health of every link is emitted once per second.
const HEALTH_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);

/// The engine of a station: decodes, aligns clocks, estimates and publishes, for every robot.
///
/// After every [`handle`](Self::handle) call [`poll`](Self::poll) until it returns `None`. [`deadline`](Self::deadline)
/// is the time to call `handle` with [`Input::Tick`]. The same configuration and the same inputs give the same outputs,
/// bit for bit.
pub struct Station {
    pub(crate) config: StationConfig,
    pub(crate) links: BTreeMap<LinkId, LinkContext>,
    pub(crate) router: FrameRouter,
    pub(crate) sessions: Sessions,
    pub(crate) observers: Observers,
    pub(crate) robots: RobotTable,
    pub(crate) thermometers: ThermometerBank,
    pub(crate) operator: OperatorState,
    pub(crate) missions: Missions,
    pub(crate) sensor_inventory: SensorInventory,
    pub(crate) status_texts: StatusTextQueue,
    pub(crate) egress: Egress,
    pub(crate) outputs: OutputQueue,
    pub(crate) time: StationTime,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct StationTime {
    /// The latest instant of any input so far, for all schedules, signatures and limits. It never falls.
    pub(crate) now: Timestamp<HostClock>,
    next_health: Option<Timestamp<HostClock>>,
}

impl Station {
    /// `now` is the first instant of the session.
    ///
    /// Fails if the filter is unknown, or two links share an id.
    pub fn new(mut config: StationConfig, now: Timestamp<HostClock>) -> Result<Self, BuildError> {
        let mut links = BTreeMap::new();
        for link in &config.links {
            if links.insert(link.id, LinkContext::new(link)).is_some() {
                return Err(BuildError::DuplicateLink { id: link.id });
            }
        }
        let router = FrameRouter::new(config.router_config());
        for block in &mut config.robots {
            // A robot of redundant links is known by the first of them.
            block.matches.link = block.matches.link.map(|link| router.first_of_group(link));
        }
        Ok(Self {
            links,
            router,
            sessions: Sessions::new(&config, now),
            observers: Observers::default(),
            robots: RobotTable::new(&config)?,
            thermometers: ThermometerBank::default(),
            operator: OperatorState::new(config.robot.filter_config.params),
            missions: Missions::default(),
            sensor_inventory: SensorInventory::default(),
            status_texts: StatusTextQueue::default(),
            egress: Egress::new(&config.links, now),
            outputs: OutputQueue::default(),
            time: StationTime { now, next_health: (!config.links.is_empty()).then(|| now + HEALTH_PERIOD) },
            config,
        })
    }

    /// Handles one input that arrived at `arrival`.
    ///
    /// Queued bytes may have arrived before an input that was handled earlier. Their own arrival is used for clock
    /// alignment; time itself does not go back for them.
    ///
    /// Only the work for the robots' estimates is done here; the rest is done when these have been polled. Poll until
    /// `None` before you use [`deadline`](Self::deadline).
    pub fn handle(&mut self, arrival: Timestamp<HostClock>, input: &Input) {
        self.finish_input();
        let now = self.time.now.max(arrival);
        self.time.now = now;
        match input {
            Input::Bytes { link, peer, bytes } => {
                if let Some(link) = self.links.get_mut(link) {
                    link.note_peer();
                }
                let endpoint = Endpoint { link: *link, peer: *peer };
                self.receive(ReceiveInfo { endpoint, host_time: arrival }, FramerInput::Bytes(bytes));
            }
            Input::Link { link, state } => self.handle_link_state(*link, *state),
            Input::PeerAddress { link, peer, host } => {
                if let Some(link) = self.links.get_mut(link) {
                    link.set_host(*peer, *host);
                }
            }
            Input::Port { link, counts } => {
                if let Some(link) = self.links.get_mut(link) {
                    link.set_port_counts(*counts);
                }
            }
            Input::Observation(observation) => {
                let source = self.robots.first().id.address;
                self.observe(0, source, arrival, *observation);
            }
            Input::Command(command) | Input::OfStation { input: StationInput::Command(command), .. } => {
                self.handle_command(*command);
            }
            Input::RobotCommand { robot, command } => self.handle_robot_command(*robot, *command),
            Input::Ownership { robot, ownership } => self.handle_ownership(*robot, ownership),
            Input::OutsideFix { robot, fix } => self.handle_outside_fix(*robot, fix),
            Input::Report { severity, text }
            | Input::OfStation { input: StationInput::Report { severity, text }, .. } => {
                self.handle_report(*severity, text);
            }
            Input::Tick | Input::OfStation { input: StationInput::Tick, .. } => {}
        }
        // What is due goes first: a time request that waited behind the estimate would measure that, too.
        if self.is_due() {
            self.advance_time();
        }
        self.publish_to_robots();
        self.outputs.is_unfinished = true;
    }

    /// Deferred work for the last input. The order of the lines is the order of the outputs, which a replay compares.
    fn finish_input(&mut self) {
        if !std::mem::take(&mut self.outputs.is_unfinished) {
            return;
        }
        self.publish_to_others();
        self.transmitter().forward_frames();
        self.router.run_deferred_work(self.time.now);
        self.advance_time();
        // Pending bytes of a peer that fell silent may have been a frame.
        self.publish_to_robots();
        self.publish_to_others();
        self.transmitter().forward_frames();
        self.run_missions();
        self.process_temperatures();
        self.process_comparisons();
        self.report_withheld_frames();
        self.send_status_texts();
    }

    /// The next output: the station's own outputs and events, oldest first, then forwarded frames, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        if self.outputs.has_no_own() {
            self.finish_input();
        }
        self.outputs.pop()
    }

    /// When to call [`handle`](Self::handle) with [`Input::Tick`], at the latest.
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let links = self.links.values().filter_map(LinkContext::deadline);
        let others = [self.sessions.deadline(), self.time.next_health, self.missions.deadline()];
        links.chain(others.into_iter().flatten()).min()
    }

    /// Whether something that a peer sent was understood, so that it deserves more than a stranger.
    pub fn understands(&self, link: LinkId, peer: PeerId) -> bool {
        self.links.get(&link).is_some_and(|link| link.understands(peer))
    }

    /// All robots, in the order of their first message; before any is detected, the configured one.
    pub fn robots(&self) -> &[Robot] {
        self.robots.all()
    }

    /// The robots that were heard, in the order of their first message.
    pub fn detected_robots(&self) -> &[Robot] {
        self.robots.detected()
    }

    /// A line for each vehicle that lacks a sensor: what it sends and what is missing.
    pub fn missing_sensors(&self) -> Vec<String> {
        self.sensor_inventory.missing(self.config.origin)
    }

    /// Before any robot is detected, the configured one.
    pub fn first_robot(&self) -> &Robot {
        self.robots.first()
    }

    pub const fn params(&self) -> &Params {
        &self.config.robot.filter_config.params
    }

    /// The signing state of a link to keep for a restart, as of `now`; `None` if the link is not signed.
    pub fn signing_state(&self, link: LinkId, now: Timestamp<HostClock>) -> Option<SigningState> {
        self.links.get(&link)?.verifier.signing_state(now)
    }

    /// Number of new signed streams, over all links. When it has grown, the states should be written at once; see
    /// [`LinkSigner::streams_seen`](posebridge_protocol::signing::LinkSigner::streams_seen).
    pub fn signing_stream_count(&self) -> u64 {
        self.links.values().map(|link| link.verifier.signing_stream_count()).sum()
    }

    /// Passes the input of one peer through framer, verifier, router and decoder, then handles its messages.
    fn receive(&mut self, received: ReceiveInfo, input: FramerInput<'_>) {
        let now = self.time.now;
        let Endpoint { link: id, peer } = received.endpoint;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if let FramerInput::Bytes(bytes) = input {
            link.health.bytes_in += bytes.len() as u64;
        }
        if let Some(codec) = &mut link.codec {
            if let FramerInput::Bytes(bytes) = input {
                let mut events = Vec::new();
                codec.push_from_peer(now, peer, bytes, &mut |event| events.extend(owned(event)));
                self.handle_codec_events(received, events);
            }
            return;
        }
        if let FramerInput::Bytes(bytes) = input
            && link.mavlink1_probe.as_mut().is_some_and(|probe| probe.push(now, peer, bytes))
        {
            let text = format!("link {id}: this is MAVLink 1: add ?version=1 to its URL");
            self.report_own_text(severity::WARNING, text);
        }
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let sharing = link.sharing(peer, now);
        link.admit_peer(peer);
        let LinkContext { framers, verifier, decoder, .. } = link;
        let mut pass = ReceivePass {
            now,
            from: received.endpoint,
            sharing,
            verifier,
            router: &mut self.router,
            decoder,
            vehicles: self.sessions.vehicles(id),
            robots: &self.robots,
            observers: &self.observers,
            batch: ReceivedBatch::default(),
        };
        framers.push(now, peer, input, &mut |found| pass.push(found));
        let batch = pass.batch;
        if batch.report.has_content() {
            self.outputs.reports.push((id, batch.report));
        }
        link.health.rejected_frames += batch.rejected_frames;
        for error in batch.errors {
            self.outputs.emit(Event::ReceiveError { link: id, defect: error });
        }
        for (source, text) in batch.descriptions {
            self.emit(Event::Text { source, severity: severity::WARNING, text });
        }
        for message in batch.messages {
            self.handle_message(received, &message);
        }
    }

    fn handle_link_state(&mut self, id: LinkId, state: LinkState) {
        let now = self.time.now;
        let Some(link) = self.links.get(&id) else {
            return;
        };
        if state == LinkState::Down {
            // Before the link changes its state: a truncated beginning may have hidden complete frames, which came while it was up.
            for peer in link.framers.present() {
                let endpoint = Endpoint { link: id, peer };
                self.receive(ReceiveInfo { endpoint, host_time: now }, FramerInput::Closed);
            }
        }
        if let Some(link) = self.links.get_mut(&id) {
            link.set_state(now, state);
        }
        if state == LinkState::Down {
            self.router.forget_link(id);
        }
        self.emit(Event::Link { link: id, state });
        self.transmitter().send_codec_output(id);
    }

    fn is_due(&mut self) -> bool {
        let now = self.time.now;
        self.time.next_health.is_some_and(|due| due <= now)
            || self.links.values().any(|link| link.deadline().is_some_and(|due| due <= now))
            || self.sessions.is_due(now)
    }

    fn advance_time(&mut self) {
        self.update_presence();
        for (robot, silence) in self.robots.take_namesake_changes(self.time.now) {
            self.emit(match silence {
                Some(silence) => Event::RobotLost { robot, silence },
                None => Event::RobotDetected { robot },
            });
        }
        if self.is_due() {
            self.run_due();
        } else if !self.sessions.are_idle() {
            for id in self.link_ids() {
                self.drain_sessions(ReceiveInfo::local(id, self.time.now));
            }
        }
    }

    fn run_due(&mut self) {
        let now = self.time.now;
        let ids = self.link_ids();
        for id in &ids {
            let timed_out = self.links.get(id).map_or_else(Vec::new, |link| link.framers.timed_out(now));
            for peer in timed_out {
                // Before the session's turn: what comes to light may give it something to do at once.
                let endpoint = Endpoint { link: *id, peer };
                self.receive(ReceiveInfo { endpoint, host_time: now }, FramerInput::Timeout);
            }
            self.run_codec(*id);
            self.sessions.tick(now, *id);
            self.drain_sessions(ReceiveInfo::local(*id, now));
        }
        if let Some(due) = self.time.next_health.filter(|due| *due <= now) {
            // From the due time, not from now: the period must not drift with the load.
            let missed = (now - due).as_nanos() / HEALTH_PERIOD.as_nanos();
            let ahead_nanos = (missed + 1).saturating_mul(HEALTH_PERIOD.as_nanos());
            self.time.next_health = Some(due + TimeDelta::from_nanos(ahead_nanos));
            for id in ids {
                if let Some(link) = self.links.get_mut(&id) {
                    link.evict_idle_peers(now);
                }
                self.emit_health(id);
            }
        }
    }

    pub(crate) fn link_ids(&self) -> Vec<LinkId> {
        self.links.keys().copied().collect()
    }

    /// Handles the outputs of a link's sessions after a message or a tick.
    pub(crate) fn drain_sessions(&mut self, received: ReceiveInfo) {
        let id = received.endpoint.link;
        while let Some((role, output)) = self.sessions.poll(id) {
            match output {
                SessionOutput::Send(message) => {
                    self.transmitter().send_session_message(id, role, &message);
                    if let (SenderRole::Vehicle(robot), Message::Heartbeat(_)) = (role, &message) {
                        self.send_vehicle_status(id, robot);
                    }
                }
                SessionOutput::PeerSeen { peer, .. } | SessionOutput::PeerLost { peer, .. }
                    if self.robots.is_shared(self.router.first_of_group(id), peer) => {}
                SessionOutput::PeerSeen { peer, .. } => {
                    self.emit(Event::RobotDetected { robot: RobotId { link: id, address: peer } });
                }
                SessionOutput::PeerLost { peer, silence } => {
                    self.emit(Event::RobotLost { robot: RobotId { link: id, address: peer }, silence });
                }
                SessionOutput::TimeExchanged { peer, sent, peer_nanos, .. } => {
                    // The session's own idea of when it came is when it was handled.
                    self.handle_time_exchange(peer, &TimeExchange { sent, answer: received, peer_nanos });
                }
                SessionOutput::CommandReceived { by, command, exact } => {
                    self.handle_link_command(received, role, by, &LinkCommand { command, exact });
                }
                SessionOutput::PlanReceived { by, request } => {
                    if let SenderRole::Vehicle(robot) = role {
                        self.handle_plan_request(received, robot, by, &request);
                    }
                }
                SessionOutput::IntervalRequested { by, message_id, interval } => {
                    let robot = match role {
                        SenderRole::Station => self.requesting_robot(received, by),
                        SenderRole::Vehicle(robot) => self.robots.find(robot),
                    };
                    self.robots.set_interval(robot, id, message_id, interval);
                }
                SessionOutput::ParameterSetRequested { index, value, .. } => {
                    self.handle_parameter_set(id, role, index, value);
                }
                SessionOutput::ParameterUnsupported { index, kind, .. } => {
                    self.handle_unsupported_type(id, role, index, kind);
                }
                SessionOutput::ParameterUnknown { requested, .. } => self.handle_unknown_parameter(id, &requested),
            }
        }
    }

    /// Sends the status of a robot as a vehicle on a link, right after its heartbeat, where the robot cannot tell its own.
    fn send_vehicle_status(&mut self, link: LinkId, robot: RobotId) {
        let is_described =
            self.sessions.vehicles(link).is_some_and(|vehicles| vehicles.is_described_here(self.time.now, robot));
        let Some(index) = self.robots.find(robot).filter(|_| is_described) else {
            return;
        };
        for message in vehicle_status(self.time.now, self.robots.get(index)) {
            self.transmitter().send_as(link, SenderRole::Vehicle(robot), &message, Priority::Session);
        }
    }

    pub(crate) const fn transmitter(&mut self) -> Transmitter<'_> {
        Transmitter {
            now: self.time.now,
            own_address: self.config.own_address,
            links: &mut self.links,
            router: &mut self.router,
            sessions: &mut self.sessions,
            robots: &self.robots,
            egress: &mut self.egress,
            outputs: &mut self.outputs,
        }
    }

    /// Updates which side sends heartbeats: a ground station must detect the loss of a robot.
    pub(crate) fn update_presence(&mut self) {
        let Self { sessions, robots, router, links, config, .. } = self;
        sessions.update_presence(self.time.now, robots, router, |robot| {
            CommandResponder::for_robot(robot, links.get(&robot.id.link)?, config.own_address)
        });
    }

    fn emit_health(&mut self, id: LinkId) {
        let home = self.router.first_of_group(id);
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let before = link.health;
        let sources = link.refresh_health();
        let losses = link.losses.observe(self.time.now, &before, &link.health);
        let kernel_losses = link.losses.observe_kernel(self.time.now, link.health.port.kernel_drops);
        // With several robots on a link the first represents it.
        if let Some(index) = self.robots.at_home(home, &self.router).first() {
            let clock = &self.robots.get(*index).clocks.aligner;
            link.health.round_trip = clock.round_trip();
            link.health.clock_uncertainty = clock.uncertainty();
        }
        let health = link.health;
        self.emit(Event::Health { link: id, health, sources });
        for text in losses.into_iter().chain(kernel_losses) {
            self.report_own_text(severity::WARNING, format!("link {id} {text}"));
        }
    }

    /// Emits an event, also as a text for ground stations.
    #[inline]
    pub(crate) fn emit(&mut self, event: Event) {
        if self.sessions.has_ground_stations() {
            self.push_status_text(&event);
        }
        self.outputs.emit(event);
    }

    fn push_status_text(&mut self, event: &Event) {
        let context = TextContext {
            own_address: self.config.own_address,
            now: self.time.now,
            robots: &self.robots,
            links: &self.links,
            sessions: &self.sessions,
            router: &self.router,
        };
        self.status_texts.push_event(&context, event);
    }

    /// Sends the queued texts, on every link for ground stations.
    fn send_status_texts(&mut self) {
        for text in self.status_texts.take_pending() {
            let parts = self.status_texts.split_text(text.severity, &text.text);
            let links = self.sessions.ground_station_links();
            let is_up = |id: &LinkId| self.links.get(id).is_some_and(|link| link.state == LinkState::Up);
            let links: Vec<LinkId> = links.filter(is_up).collect();
            for id in links {
                for part in &parts {
                    self.transmitter().send_as(id, text.sender, part, Priority::Session);
                }
            }
        }
    }
}

//! The station: bytes in, events and bytes out, as one deterministic value for any number of robots.
//!
//! Data go through the stages in one direction: framers, verifier, router and decoder (in [`Station::receive`]), sessions, then each
//! robot's clock, estimator and publisher, then egress. The flow is here; what messages say about robots is in `observations`, what
//! people ask in `commands`.

use std::collections::BTreeMap;

use posebridge_estimator::{FILTERS, Params, find_filter};
use posebridge_protocol::dialect::RenumberError;
use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{DuplicateStatus, Endpoint, ForwardPolicy, FrameRouter, RouterConfig};
use posebridge_protocol::session::{HeartbeatMode, SessionOutput};
use posebridge_protocol::signing::SigningState;
use posebridge_telemetry::{
    Address, BrickClock, Calibration, DriveGeometry, Estimate, Event, HostClock, Input, LinkId, LinkState, Output,
    PeerId, Priority, Recipients, RobotId, SensorId, TimeDelta, Timestamp,
};

use crate::codec_events::{CodecEvents, OwnedCodecEvent};
use crate::commands::OperatorState;
use crate::config::{OutputKind, StationConfig};
use crate::egress::{Egress, OutgoingMessage};
use crate::estimate_publisher::PublishedMessage;
use crate::forwarding::{ForwardedFrame, ForwardingPass, ForwardingReport};
use crate::link_context::LinkContext;

use crate::observers::Observers;
use crate::output_queue::OutputQueue;
use crate::output_schedule::message_for_output;
use crate::peer_framers::FramerInput;
use crate::receive::{ReceiveInfo, ReceivedMessage, TimeExchange};
use crate::receive_pass::{ReceivePass, ReceivedBatch};
use crate::robot::Robot;
use crate::robot_table::{RobotIndex, RobotTable};
use crate::sessions::{SenderRole, Sessions, session_priority};
use crate::status_text::{StatusTextQueue, TextContext};
use crate::thermometer_bank::ThermometerBank;
use crate::vehicle_proxy::{CommandResponder, VEHICLE_COMPONENT};

/// The health of every link is emitted once per second.
const HEALTH_PERIOD: TimeDelta = TimeDelta::from_millis(1_000);
/// MAV_SEVERITY_WARNING.
pub(crate) const SEVERITY_WARNING: u8 = 4;

/// Why a station could not be built.
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

/// The engine of a station: decode, align clocks, estimate, publish, for every robot that is heard.
///
/// After every [`handle`](Self::handle) call [`poll`](Self::poll) until it returns `None`. [`deadline`](Self::deadline)
/// says when to call `handle` with [`Input::Tick`]. The same configuration and the same inputs give the same outputs, bit for bit.
pub struct Station {
    pub(crate) config: StationConfig,
    pub(crate) links: BTreeMap<LinkId, LinkContext>,
    pub(crate) router: FrameRouter,
    pub(crate) sessions: Sessions,
    pub(crate) observers: Observers,
    pub(crate) robots: RobotTable,
    pub(crate) thermometers: ThermometerBank,
    pub(crate) operator: OperatorState,
    pub(crate) status_texts: StatusTextQueue,
    pub(crate) egress: Egress,
    pub(crate) outputs: OutputQueue,
    pub(crate) time: StationTime,
}

/// The time of a station.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StationTime {
    /// The latest instant of any input so far: everything is planned, signed and limited by it. It never falls.
    pub(crate) now: Timestamp<HostClock>,
    next_health: Option<Timestamp<HostClock>>,
}

/// What is sent, as whom, how urgently and to whom.
#[derive(Clone, Copy)]
struct Transmission<'a> {
    link: LinkId,
    sender: Sender,
    message: &'a Message,
    priority: Priority,
    to: Recipients,
}

/// An address to send under.
#[derive(Clone, Copy)]
enum Sender {
    /// The station's own.
    Station,
    /// The station's component in a robot's system.
    Estimator(Address),
    /// The robot's, which is reached by this endpoint.
    Vehicle(Address, Endpoint),
}

impl Station {
    /// A station that has seen nothing; `now` is the first instant of its session.
    ///
    /// # Errors
    /// The filter is unknown, or two links share an id.
    pub fn new(config: StationConfig, now: Timestamp<HostClock>) -> Result<Self, BuildError> {
        let entry = find_filter(&config.robot.filter).ok_or_else(|| BuildError::UnknownFilter {
            name: config.robot.filter.clone(),
            known: FILTERS.iter().map(|entry| entry.name).collect::<Vec<_>>().join(", "),
        })?;
        let mut links = BTreeMap::new();
        for link in &config.links {
            if links.insert(link.id, LinkContext::new(link)).is_some() {
                return Err(BuildError::DuplicateLink { id: link.id });
            }
        }
        Ok(Self {
            links,
            router: FrameRouter::new(router_config(&config)),
            sessions: Sessions::new(&config, now),
            observers: Observers::default(),
            robots: RobotTable::new(entry, &config),
            thermometers: ThermometerBank::default(),
            operator: OperatorState::new(config.robot.filter_config.params),
            status_texts: StatusTextQueue::default(),
            egress: Egress::new(&config.links, now),
            outputs: OutputQueue::default(),
            time: StationTime { now, next_health: (!config.links.is_empty()).then(|| now + HEALTH_PERIOD) },
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
    pub fn handle(&mut self, arrival: Timestamp<HostClock>, input: &Input) {
        self.finish_input();
        let now = self.time.now.max(arrival);
        self.time.now = now;
        match input {
            Input::Bytes { link, peer, bytes } => {
                let endpoint = Endpoint { link: *link, peer: *peer };
                self.receive(ReceiveInfo { endpoint, host_time: arrival }, FramerInput::Bytes(bytes));
            }
            Input::Link { link, state } => self.handle_link_state(*link, *state),
            Input::Port { link, counts } => {
                if let Some(link) = self.links.get_mut(link) {
                    link.health.port = *counts;
                }
            }
            Input::Observation(observation) => {
                let source = self.robots.first().id.address;
                self.observe(0, source, arrival, *observation);
            }
            Input::Command(command) => self.handle_command(*command),
            Input::RobotCommand { robot, command } => self.handle_robot_command(*robot, *command),
            Input::Report { severity, text } => self.handle_report(*severity, text),
            Input::Tick => {}
        }
        // What is due goes first: a time request that waited behind the estimate would measure that, too.
        if self.is_due() {
            self.advance_time();
        }
        self.publish_to_robots();
        self.outputs.set_unfinished();
    }

    /// What nobody waits for of the input before. The order of the lines is the order of the outputs, which a replay compares.
    fn finish_input(&mut self) {
        if !self.outputs.take_unfinished() {
            return;
        }
        self.publish_to_others();
        self.forward_frames();
        self.router.run_deferred_work(self.time.now);
        self.advance_time();
        // What waited of a peer that fell silent may have been news, too.
        self.publish_to_robots();
        self.publish_to_others();
        self.forward_frames();
        self.process_temperatures();
        self.send_status_texts();
    }

    /// The next output: the station's own and what happened, oldest first, then what is forwarded, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        if self.outputs.has_no_own() {
            self.finish_input();
        }
        self.outputs.pop()
    }

    /// The same where it stands, for a caller that only looks at it; it stays until [`Self::skip_output`]. An output is large.
    pub fn peek(&mut self) -> Option<&Output> {
        if self.outputs.has_no_own() {
            self.finish_input();
        }
        self.outputs.front()
    }

    /// Leaves out the next output, after [`Self::peek`].
    pub fn skip_output(&mut self) {
        self.outputs.skip();
    }

    /// When to call [`handle`](Self::handle) with [`Input::Tick`], at the latest.
    #[must_use]
    pub fn deadline(&self) -> Option<Timestamp<HostClock>> {
        let links = self.links.values().filter_map(LinkContext::deadline);
        links.chain(self.sessions.deadline()).chain(self.time.next_health).min()
    }

    /// All robots that were heard, in the order of their first message; before any is heard, the one that is configured.
    #[must_use]
    pub fn robots(&self) -> &[Robot] {
        self.robots.all()
    }

    /// The first robot's estimate at an instant of its clock; see [`Robot::estimate_at`].
    #[must_use]
    pub fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.robots.first().estimate_at(stamp)
    }

    /// What the first robot's filter has learned; see [`Robot::calibration`].
    #[must_use]
    pub fn calibration(&self) -> Option<Calibration> {
        self.robots.first().calibration()
    }

    /// The tunables as they are set.
    #[must_use]
    pub const fn params(&self) -> &Params {
        &self.config.robot.filter_config.params
    }

    /// The first robot's nominal geometry; see [`Robot::geometry`].
    #[must_use]
    pub fn geometry(&self) -> DriveGeometry {
        self.robots.first().geometry()
    }

    /// The latest instant of any observation of the first robot.
    #[must_use]
    pub fn latest_time(&self) -> Option<Timestamp<BrickClock>> {
        self.robots.first().latest_time()
    }

    /// The sensors of the first robot that are switched off, by their numbers.
    pub fn switched_off(&self) -> impl Iterator<Item = SensorId> {
        self.robots.first().switched_off()
    }

    /// What the signing of a link must still know after a restart, as of `now`; `None` if the link is not signed.
    #[must_use]
    pub fn signing_state(&self, link: LinkId, now: Timestamp<HostClock>) -> Option<SigningState> {
        self.links.get(&link)?.verifier.signing_state(now)
    }

    /// How many signed streams were heard for the first time, over all links. When it has grown, the states should be written down at
    /// once; see [`LinkSigner::streams_seen`](posebridge_protocol::signing::LinkSigner::streams_seen).
    #[must_use]
    pub fn signing_stream_count(&self) -> u64 {
        self.links.values().map(|link| link.verifier.signing_stream_count()).sum()
    }

    /// Takes what came of one peer of a link through framer, verifier, router and decoder, then acts on its messages.
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
                let mut events = CodecEvents::default();
                codec.push_from_peer(now, peer, bytes, &mut |event| events.push(event));
                self.handle_codec_events(received, events);
            }
            return;
        }
        let sharing = link.sharing(peer, now);
        link.admit_peer(peer);
        let vehicles = self.sessions.vehicles(id);
        let forwarding = ForwardingPass::new(&mut self.router, now, received.endpoint, sharing, vehicles, &self.robots);
        let LinkContext { framers, verifier, decoder, .. } = link;
        let batch = ReceivedBatch::default();
        let mut pass = ReceivePass { now, peer, verifier, forwarding, decoder, batch };
        framers.push(now, peer, input, &mut |found| pass.push(found));
        let ReceivePass { forwarding, batch, .. } = pass;
        self.outputs.push_report(id, forwarding.finish());
        link.health.rejected_frames += batch.rejected_frames;
        for error in batch.errors {
            self.outputs.emit(Event::ReceiveError { link: id, defect: error });
        }
        for (source, text) in batch.descriptions {
            self.emit(Event::Text { source, severity: SEVERITY_WARNING, text });
        }
        for message in batch.messages {
            self.handle_message(received, &message);
        }
    }

    /// Acts on what a codec has found, then sends what it asks.
    fn handle_codec_events(&mut self, received: ReceiveInfo, events: CodecEvents) {
        let link = received.endpoint.link;
        for event in events.into_events() {
            match event {
                OwnedCodecEvent::Message(source, message) => {
                    let message = ReceivedMessage { source, duplicate_status: DuplicateStatus::New, message };
                    self.handle_message(received, &message);
                }
                OwnedCodecEvent::ClockReply { from, sent, peer_nanos } => {
                    self.handle_time_exchange(from, &TimeExchange { sent, answer: received, peer_nanos });
                }
                OwnedCodecEvent::StatusText { from: source, severity, text } => {
                    self.emit(Event::Text { source, severity, text });
                }
                OwnedCodecEvent::Error(error) => self.emit(Event::ReceiveError { link, defect: error }),
            }
        }
        self.send_codec_output(link);
    }

    /// Lets a codec do what is due.
    fn run_codec(&mut self, id: LinkId) {
        let now = self.time.now;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        if link.codec_deadline().is_none_or(|due| due > now) {
            return;
        }
        let Some(codec) = &mut link.codec else {
            return;
        };
        let mut events = CodecEvents::default();
        codec.tick(now, &mut |event| events.push(event));
        let endpoint = Endpoint { link: id, peer: PeerId::default() };
        self.handle_codec_events(ReceiveInfo { endpoint, host_time: now }, events);
    }

    /// Sends what a codec wants to send of itself.
    fn send_codec_output(&mut self, id: LinkId) {
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        while let Some((to, bytes)) = link.codec.as_mut().and_then(|codec| codec.poll_addressed()) {
            if link.state == LinkState::Down {
                continue;
            }
            link.health.bytes_out += bytes.len() as u64;
            link.health.frames_out += 1;
            // Nothing takes the place of a lost request: the robot would wait for ever.
            self.outputs.push(Output::Transmit { link: id, to, priority: Priority::Command, bytes });
        }
    }

    fn handle_link_state(&mut self, id: LinkId, state: LinkState) {
        let now = self.time.now;
        let Some(link) = self.links.get(&id) else {
            return;
        };
        if state == LinkState::Down {
            // Before the link changes its state: a torn beginning may have hidden whole frames, which came while it was up.
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
        self.send_codec_output(id);
    }

    /// Whether anything waits for an instant that has come.
    fn is_due(&mut self) -> bool {
        let now = self.time.now;
        self.time.next_health.is_some_and(|due| due <= now)
            || self.links.values().any(|link| link.deadline().is_some_and(|due| due <= now))
            || self.sessions.is_due(now)
    }

    fn advance_time(&mut self) {
        self.update_presence();
        if self.is_due() {
            self.run_due();
        } else if !self.sessions.are_idle() {
            for id in self.link_ids() {
                self.drain_sessions(self.local_receive_info(id));
            }
        }
    }

    /// Does what is due.
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
            self.drain_sessions(self.local_receive_info(*id));
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

    fn link_ids(&self) -> Vec<LinkId> {
        self.links.keys().copied().collect()
    }

    /// How something that the station does of itself on a link counts as received.
    fn local_receive_info(&self, link: LinkId) -> ReceiveInfo {
        ReceiveInfo { endpoint: Endpoint { link, peer: PeerId::default() }, host_time: self.time.now }
    }

    /// Does what the sessions of a link want done after they took what came so, or time.
    pub(crate) fn drain_sessions(&mut self, received: ReceiveInfo) {
        let id = received.endpoint.link;
        while let Some((role, output)) = self.sessions.poll(id) {
            match output {
                SessionOutput::Send(message) => self.send_session_message(id, role, &message),
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
                SessionOutput::CommandReceived { by, command } => self.handle_link_command(id, role, by, &command),
                SessionOutput::IntervalRequested { message_id, interval, .. } => {
                    let robot = self.robot_of(role);
                    self.robots.set_interval(robot, id, message_id, interval);
                }
                SessionOutput::ParameterSetRequested { index, value, .. } => {
                    self.handle_parameter_set(id, index, value);
                }
                SessionOutput::ParameterUnsupported { index, kind, .. } => {
                    self.handle_unsupported_type(id, index, kind);
                }
                SessionOutput::ParameterUnknown { asked, .. } => self.handle_unknown_parameter(id, &asked),
            }
        }
    }

    /// Sends a session's message; on a link that is down it is lost, and the session sends it again when the link is back.
    fn send_session_message(&mut self, id: LinkId, role: SenderRole, message: &Message) {
        if self.links.get(&id).is_none_or(|link| link.state == LinkState::Down) {
            return;
        }
        self.send_as(id, role, message, session_priority(message));
    }

    /// Sends a message to all peers of a link, as the station or as a robot.
    pub(crate) fn send_as(&mut self, id: LinkId, role: SenderRole, message: &Message, priority: Priority) {
        match role {
            SenderRole::Station => self.send(id, message, priority),
            SenderRole::Vehicle(robot) => self.send_as_vehicle(id, robot, message, priority),
        }
    }

    /// Sends a message of the station to all peers of a link.
    pub(crate) fn send(&mut self, link: LinkId, message: &Message, priority: Priority) {
        self.transmit(Transmission { link, sender: Sender::Station, message, priority, to: Recipients::All });
    }

    /// Sends what a robot's session as a vehicle says, unless the robot says it itself or the station must not speak for it.
    fn send_as_vehicle(&mut self, link: LinkId, robot: RobotId, message: &Message, priority: Priority) {
        let now = self.time.now;
        let Some(vehicles) = self.sessions.vehicles(link) else {
            return;
        };
        let is_heartbeat = matches!(message, Message::Heartbeat(_));
        let is_sent_by_robot =
            is_heartbeat && vehicles.is_sent_by_robot(now, robot, posebridge_protocol::dialect::ids::HEARTBEAT);
        if vehicles.is_suppressed(now, robot) || is_sent_by_robot {
            return;
        }
        if let Some(sender) = self.vehicle_sender(link, robot) {
            self.transmit(Transmission { link, sender, message, priority, to: Recipients::All });
        }
    }

    /// How a robot appears as a vehicle on a link; `None` if it does not.
    fn vehicle_sender(&self, link: LinkId, robot: RobotId) -> Option<Sender> {
        let address = self.sessions.vehicles(link)?.address(robot)?;
        let last_seen = self.robots.find(robot).and_then(|index| self.robots.get(index).last_seen);
        Some(Sender::Vehicle(address, last_seen.map_or_else(Endpoint::default, |(endpoint, _)| endpoint)))
    }

    /// The robot that a role speaks for; `None` for the station.
    fn robot_of(&self, role: SenderRole) -> Option<RobotIndex> {
        match role {
            SenderRole::Station => None,
            SenderRole::Vehicle(robot) => self.robots.find(robot),
        }
    }

    /// Gives a message to egress and its bytes to the queue.
    fn transmit(&mut self, transmission: Transmission<'_>) {
        let now = self.time.now;
        let Transmission { link: id, sender, message, priority, to } = transmission;
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let address = match sender {
            Sender::Station => self.config.own_address,
            Sender::Estimator(address) | Sender::Vehicle(address, _) => address,
        };
        let outgoing = OutgoingMessage { link: id, sender: address, message, priority };
        let Some(bytes) = self.egress.send(now, link, outgoing) else {
            return;
        };
        match sender {
            Sender::Vehicle(_, endpoint) => self.router.record_sent_for(now, endpoint, &bytes),
            Sender::Station | Sender::Estimator(_) if link.codec.is_none() => self.router.record_sent(&bytes),
            Sender::Station | Sender::Estimator(_) => {}
        }
        link.health.bytes_out += bytes.len() as u64;
        link.health.frames_out += 1;
        self.outputs.push(Output::Transmit { link: id, to, priority, bytes });
    }

    /// One estimate per robot that has something new, for the latest instant that was observed: to the robot at once.
    fn publish_to_robots(&mut self) {
        while let Some(index) = self.robots.pop_news() {
            let estimate = self.robots.get(index).estimator.latest_estimate();
            self.request_fixes(estimate.as_ref());
            let Some(estimate) = estimate else {
                continue;
            };
            let robot = self.robots.get(index).id;
            self.emit(Event::EstimateUpdated { robot, estimate });
            self.publish_estimate(index, robot.link, &estimate);
            if self.links.len() > 1 || !self.links.contains_key(&robot.link) {
                self.robots.get_mut(index).publisher.set_pending(&estimate);
                self.robots.mark_pending(index);
            }
        }
    }

    /// The estimates on all other links, when nobody waits.
    fn publish_to_others(&mut self) {
        while let Some(index) = self.robots.pop_pending() {
            let robot = self.robots.get_mut(index);
            let home = robot.id.link;
            let Some(estimate) = robot.publisher.take_pending() else {
                continue;
            };
            for id in self.link_ids() {
                if id != home {
                    self.publish_estimate(index, id, &estimate);
                }
            }
        }
    }

    fn publish_estimate(&mut self, index: RobotIndex, id: LinkId, estimate: &Estimate) {
        if self.links.get(&id).is_none_or(|link| link.state != LinkState::Up) {
            return;
        }
        let (publisher, source) = self.robots.get_mut(index).publishing(self.time.now);
        for message in publisher.publish(id, estimate, source) {
            self.send_published(index, &message);
        }
    }

    /// Sends a robot's output: as the robot where a ground station looks for it at the vehicle, else as the station.
    pub(crate) fn send_published(&mut self, index: RobotIndex, published: &PublishedMessage) {
        let now = self.time.now;
        let PublishedMessage { link, kind, ref message, priority } = *published;
        let robot = self.robots.get(index).id;
        let mut sender = Sender::Station;
        if let Some(vehicles) = self.sessions.vehicles(link)
            && kind.is_vehicle_output()
            && vehicles.address(robot).is_some()
        {
            if vehicles.is_sent_by_robot(now, robot, message_for_output(kind)) {
                return;
            }
            if !vehicles.is_suppressed(now, robot)
                && let Some(vehicle) = self.vehicle_sender(link, robot)
            {
                sender = vehicle;
            }
        }
        let at_home = self.robots.at_home(link, &self.router);
        let is_at_home = self.router.first_of_group(link) == robot.link;
        if index > 0 && matches!(sender, Sender::Station) && !is_at_home {
            sender = self.estimator_sender(index);
        }
        if at_home.is_empty() || at_home == [index] {
            self.transmit(Transmission { link, sender, message, priority, to: Recipients::All });
        } else {
            self.send_on_shared_link(index, Transmission { link, sender, message, priority, to: Recipients::All });
        }
    }

    /// On a link with several robots a robot gets its own outputs, ground stations get all of them, and no robot gets another's.
    fn send_on_shared_link(&mut self, index: RobotIndex, transmission: Transmission<'_>) {
        let id = transmission.link;
        let own_endpoint = self.robots.get(index).last_seen.map(|(endpoint, _)| endpoint);
        if let Some(endpoint) = own_endpoint.filter(|endpoint| endpoint.link == id) {
            self.transmit(Transmission {
                to: Recipients::Peer(endpoint.peer),
                sender: Sender::Station,
                ..transmission
            });
        }
        let Some(link) = self.links.get(&id) else {
            return;
        };
        let ground_stations: Vec<PeerId> = link.ground_stations().collect();
        let sender = match transmission.sender {
            Sender::Station if index > 0 => self.estimator_sender(index),
            Sender::Station | Sender::Estimator(_) | Sender::Vehicle(..) => transmission.sender,
        };
        for peer in ground_stations {
            self.transmit(Transmission { to: Recipients::Peer(peer), sender, ..transmission });
        }
    }

    /// The station's component in the system of a robot: whoever listens can tell the robots' outputs apart.
    fn estimator_sender(&self, index: RobotIndex) -> Sender {
        let system = self.robots.get(index).vehicle_address.system;
        Sender::Estimator(Address { system, component: self.config.own_address.component })
    }

    /// Brings up to date who sends heartbeats: a ground station must notice when a robot is not heard any more.
    pub(crate) fn update_presence(&mut self) {
        let now = self.time.now;
        if !self.sessions.has_ground_stations() || !self.robots.take_presence_change(now) {
            return;
        }
        let mode = |is_alive| if is_alive { HeartbeatMode::Active } else { HeartbeatMode::Suppressed };
        self.sessions.set_heartbeat_mode(mode(self.robots.is_any_alive(now)));
        let links: Vec<LinkId> = self.sessions.ground_station_links().collect();
        for robot in self.robots.all().iter().take(self.robots.len()) {
            let responder = self.responder_for(robot);
            for link in &links {
                // On a link where it is heard itself it needs nobody to speak for it.
                if let Some(responder) = responder
                    && !self.router.are_redundant(*link, robot.id.link)
                {
                    self.sessions.add_vehicle(*link, robot.id, robot.vehicle_address, responder, now);
                }
                if let Some(vehicles) = self.sessions.vehicles_mut(*link) {
                    vehicles.set_heartbeat_mode(robot.id, mode(robot.is_alive(now)));
                }
            }
        }
    }

    /// Who answers commands to the robot as a vehicle; `None` if it must not appear as one.
    fn responder_for(&self, robot: &Robot) -> Option<CommandResponder> {
        let link = self.links.get(&robot.id.link)?;
        let responder = if link.codec.is_some() || robot.wire_address.component != robot.vehicle_address.component {
            CommandResponder::Station
        } else {
            CommandResponder::Robot
        };
        (robot.vehicle_address != self.config.own_address).then_some(responder)
    }

    /// Counts what was routed in this input and forwards it.
    fn forward_frames(&mut self) {
        for (id, report) in self.outputs.take_reports() {
            let ForwardingReport { filtered, duplicates, address_conflicts, unchangeable, forwarded } = report;
            if let Some(link) = self.links.get_mut(&id) {
                link.health.drops_out += unchangeable;
                link.health.filtered += filtered;
                link.health.duplicates += duplicates;
                link.health.address_conflicts += address_conflicts;
            }
            for frame in &forwarded {
                for to_link in frame.to.chunk_by(|one, next| one.0 == next.0) {
                    self.forward_frame(to_link, frame);
                }
            }
        }
    }

    /// Forwards a frame to its recipients on one link.
    fn forward_frame(&mut self, to: &[(LinkId, Recipients)], frame: &ForwardedFrame) {
        let now = self.time.now;
        let Some((id, link)) = to.first().and_then(|(id, _)| Some((*id, self.links.get_mut(id)?))) else {
            return;
        };
        if !self.egress.admit_forwarded(now, id, link, frame) || self.forward_renumbered(id, frame) {
            return;
        }
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        for (_, to) in to {
            link.health.bytes_out += frame.bytes.len() as u64;
            link.health.frames_out += 1;
            link.health.forwarded += 1;
            let bytes = frame.bytes.clone();
            self.outputs.push_forwarded(Output::Transmit { link: id, to: *to, priority: frame.priority, bytes });
        }
    }

    /// Forwards a frame to a link for ground stations, under the address by which they know its sender and the next number of its count
    /// there. False if it is to be forwarded like any other.
    ///
    /// Not every frame of a sender is for this link (answers to others, what is filtered or rate limited), and a robot shares its
    /// address with the station: by the numbers that the frames came with a ground station would compute losses that are none.
    fn forward_renumbered(&mut self, id: LinkId, frame: &ForwardedFrame) -> bool {
        let now = self.time.now;
        // Whoever is on the link itself is heard there by some peers without the station.
        if self.router.are_redundant(frame.from.link, id) {
            return false;
        }
        // A sender with a robot's address on a link without robots must not silence the station.
        let is_from_robot = self.robots.len() == 0 || !self.robots.at_home(frame.from.link, &self.router).is_empty();
        let (Some(link), Some(vehicles)) = (self.links.get_mut(&id), self.sessions.vehicles_mut(id)) else {
            return false;
        };
        let home = self.router.first_of_group(frame.from.link);
        let announced = self.robots.announced_address(frame.from, home, frame.source);
        let from = announced.unwrap_or(frame.source);
        if announced.is_some() && frame.is_signed {
            // Under its own ids it would be another robot's there.
            link.health.drops_out += 1;
            return true;
        }
        if is_from_robot && from.component == VEHICLE_COMPONENT {
            vehicles.record_forwarded(now, from.system, frame.message_id);
            if link.verifier.is_signed() {
                vehicles.record_on_signed_link(now, from.system);
            }
        }
        let renumbered = if vehicles.is_unmodified(now, from) {
            Err(RenumberError::Signed)
        } else {
            self.egress.readdress(id, &frame.bytes, from)
        };
        if renumbered == Err(RenumberError::Signed) && is_from_robot {
            if frame.is_signed {
                vehicles.record_unmodified(now, from);
            }
            // Should the next one be ours, it follows that.
            self.egress.follow_sequence(id, from, frame.sequence);
        }
        let Ok(bytes) = renumbered else {
            link.health.drops_out += u64::from(announced.is_some());
            return announced.is_some();
        };
        self.router.record_sent_for(now, frame.from, &bytes);
        link.health.bytes_out += bytes.len() as u64;
        link.health.frames_out += 1;
        link.health.forwarded += 1;
        // Among the station's own, because the robot's count is the station's, too, and what is counted first must leave first. To all
        // peers of the link, because whoever does not get a frame would take it for lost.
        self.outputs.push(Output::Transmit { link: id, to: Recipients::All, priority: frame.priority, bytes });
        true
    }

    fn emit_health(&mut self, id: LinkId) {
        let home = self.router.first_of_group(id);
        let Some(link) = self.links.get_mut(&id) else {
            return;
        };
        let sources = link.refresh_health();
        // With several robots on a link the first stands for it.
        if let Some(index) = self.robots.at_home(home, &self.router).first() {
            let clocks = &self.robots.get(*index).clocks;
            link.health.round_trip = clocks.round_trip();
            link.health.clock_uncertainty = clocks.uncertainty();
        }
        let health = link.health;
        self.emit(Event::Health { link: id, health, sources });
    }

    /// Puts an event out, and into words for ground stations.
    pub(crate) fn emit(&mut self, event: Event) {
        if self.sessions.has_ground_stations() {
            let context = TextContext {
                own_address: self.config.own_address,
                now: self.time.now,
                robots: &self.robots,
                links: &self.links,
                sessions: &self.sessions,
                router: &self.router,
            };
            self.status_texts.push_event(&context, &event);
        }
        self.outputs.emit(event);
    }

    /// Sends the texts that wait, on every link for ground stations.
    fn send_status_texts(&mut self) {
        for text in self.status_texts.take_pending() {
            let parts = self.status_texts.split_text(text.severity, &text.text);
            let links = self.sessions.ground_station_links();
            let is_up = |id: &LinkId| self.links.get(id).is_some_and(|link| link.state == LinkState::Up);
            let links: Vec<LinkId> = links.filter(is_up).collect();
            for id in links {
                for part in &parts {
                    self.send_as(id, text.sender, part, Priority::Session);
                }
            }
        }
    }

    /// Uses the temperatures that wait: nobody steers by them.
    pub(crate) fn process_temperatures(&mut self) {
        let outputs = &mut self.outputs;
        self.thermometers
            .process(&self.config.robot.filter_config, &self.config.thermometers, |event| outputs.emit(event));
        if self.thermometers.take_limit_report() {
            self.emit(Event::Text {
                source: self.config.own_address,
                severity: SEVERITY_WARNING,
                text: "there are more thermometers than are followed; those heard last are left out".to_owned(),
            });
        }
    }
}

impl OutputKind {
    /// Whether a ground station looks for it at the vehicle.
    const fn is_vehicle_output(self) -> bool {
        match self {
            Self::Attitude | Self::DistanceSensor => true,
            Self::PlanarPose
            | Self::Odometry
            | Self::LocalPosition
            | Self::EstimatorStatus
            | Self::FusionHealth
            | Self::NamedValue
            | Self::FloatArray => false,
        }
    }
}

fn router_config(config: &StationConfig) -> RouterConfig {
    let rules = config.links.iter().map(|link| {
        let mut rules = link.rules.clone();
        // A robot that speaks no MAVLink would take the others' frames for noise.
        if link.brick.is_some() {
            rules.forward = ForwardPolicy::Disabled;
        }
        (link.id, rules)
    });
    RouterConfig { own: config.own_address, duplicate_window: config.duplicate_window, links: rules.collect() }
}

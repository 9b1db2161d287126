//! The MAVLink services beside the telemetry: heartbeats, time synchronization, message intervals, commands, parameters.
//!
//! A session is one participant's part on one link, in its own clock: the station's, the simulated brick's, the simulated
//! camera's. It does not estimate clock offsets (it reports exchanges) and does not interpret parameters or commands.
//!
//! Sources: MAVLink guide, "Heartbeat/Connection Protocol", "Time Synchronization Protocol v2", "Command Protocol", and
//! MAV_CMD_SET_MESSAGE_INTERVAL of common.xml.

mod file_server;
mod output;
mod parameters;
mod peers;
mod time_requests;
mod vehicle_services;

use std::collections::VecDeque;
use std::sync::Arc;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, ComponentId, TimeDelta, Timestamp};

pub use self::file_server::{ServedFile, crc32};
use self::output::{MIN_PERIOD, next_period};
pub use self::output::{PlanRequest, SessionOutput, SessionSender};
use self::parameters::ParameterServer;
use self::peers::PeerTable;
pub use self::peers::RequestedMessages;
use self::time_requests::TimeRequests;
use self::vehicle_services::VehicleServices;
pub use self::vehicle_services::{PlanService, most_answers};
use crate::dialect::ids::COMMAND_SET_MESSAGE_INTERVAL;
use crate::message::{
    CommandAck, CommandInt, CommandLong, CommandResult, Heartbeat, Message, SetMessageInterval, TimeSync,
};

/// The configuration of a [`Session`].
#[derive(Clone, Debug, PartialEq)]
pub struct SessionConfig {
    pub own: Address,
    pub heartbeat: Heartbeat,
    /// Time between our heartbeats; the convention is one second.
    pub heartbeat_period: TimeDelta,
    /// Time between our time requests after the first ten; `None` only replies.
    pub timesync_period: Option<TimeDelta>,
    /// Silence after which a peer is lost.
    pub peer_timeout: TimeDelta,
    pub requested_messages: RequestedMessages,
    /// Messages whose interval others may set; a request for any other gets the reply "unsupported".
    pub offered_messages: Vec<u32>,
}

/// Whether a [`Session`] sends heartbeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HeartbeatMode {
    #[default]
    Active,
    /// It sends none, because its component is absent, which others must detect. It still replies.
    Suppressed,
}

/// The commands to all components of our system that a [`Session`] passes on; those to itself alone are always passed on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServedCommands {
    These(&'static [u16]),
    /// All but these, which another component of the system serves.
    AllBut(&'static [u16]),
}

impl ServedCommands {
    fn include(self, command: u16) -> bool {
        match self {
            Self::These(commands) => commands.contains(&command),
            Self::AllBut(commands) => !commands.contains(&command),
        }
    }
}

/// One participant's MAVLink services on one link, in its own clock `C`.
#[derive(Debug)]
pub struct Session<C: Clock> {
    config: SessionConfig,
    latest: Timestamp<C>,
    next_heartbeat: Timestamp<C>,
    last_heartbeat: Option<Timestamp<C>>,
    /// Nothing is due before this; `None` if that must be computed. It may be too early, never too late.
    idle_until: Option<Timestamp<C>>,
    heartbeat_mode: HeartbeatMode,
    time_requests: TimeRequests<C>,
    peers: PeerTable<C>,
    parameters: ParameterServer<C>,
    /// Commands to all components that are passed to the owner.
    served_commands: ServedCommands,
    vehicle_services: Option<VehicleServices>,
    outputs: VecDeque<SessionOutput<C>>,
}

impl<C: Clock> Session<C> {
    pub fn new(config: SessionConfig, now: Timestamp<C>) -> Self {
        Self {
            time_requests: TimeRequests::new(config.timesync_period, now),
            peers: PeerTable::new(config.peer_timeout),
            parameters: ParameterServer::none(),
            served_commands: ServedCommands::These(&[]),
            vehicle_services: None,
            latest: now,
            next_heartbeat: now,
            last_heartbeat: None,
            idle_until: None,
            heartbeat_mode: HeartbeatMode::Active,
            outputs: VecDeque::new(),
            config,
        }
    }

    pub const fn own_address(&self) -> Address {
        self.config.own
    }

    /// Offers parameters by these names, at most sixteen bytes each, with these values. Their number and order must not
    /// change.
    pub fn offer_parameters(&mut self, named: impl Iterator<Item = (String, f32)>) {
        self.parameters.offer(named);
    }

    /// Stores the value of an offered parameter, changed or not. Returns the message for all peers of this link, if one
    /// of them has ever requested parameters.
    pub fn report_parameter(&mut self, index: usize, value: f32) -> Option<Message> {
        self.parameters.set_value(index, value)
    }

    /// The message that reports an offered parameter.
    pub fn parameter(&self, index: usize) -> Option<Message> {
        self.parameters.value(index)
    }

    /// Ends a list of parameters that is being sent.
    pub fn stop_listing(&mut self) {
        self.parameters.stop_listing();
        self.idle_until = None;
    }

    /// The offered parameters with their values.
    pub fn offered_parameters(&self) -> impl Iterator<Item = (String, f32)> {
        self.parameters.offered()
    }

    /// Which commands are passed to the owner, as [`SessionOutput::CommandReceived`], also when they are for all components
    /// of our system.
    pub const fn serve_commands(&mut self, served: ServedCommands) {
        self.served_commands = served;
    }

    /// Answers what is asked of a vehicle beside telemetry, parameters and commands: plans, an empty list of logs, and these files.
    pub fn serve_as_vehicle(&mut self, files: Arc<[ServedFile]>, plans: PlanService) {
        self.vehicle_services = Some(VehicleServices::new(files, plans));
    }

    /// `None` if it is no vehicle.
    pub fn plan_service(&self) -> Option<PlanService> {
        self.vehicle_services.as_ref().map(VehicleServices::plan_service)
    }

    /// Sends the next heartbeat now, and the following ones from then on.
    pub fn beat_now(&mut self, now: Timestamp<C>) {
        self.next_heartbeat = self.next_heartbeat.min(now);
        self.idle_until = None;
    }

    /// Whether a message asks us for something that costs an answer.
    #[expect(clippy::wildcard_enum_match_arm, reason = "most messages ask for nothing")]
    pub fn is_asked(&self, message: &Message) -> bool {
        let target = match message {
            Message::TimeSync(sync) if sync.answer_nanos == 0 => {
                return sync.target.is_none_or(|to| self.is_for_us(to));
            }
            Message::SetMessageInterval(request) => request.target,
            Message::Command(command) => command.target,
            Message::CommandInt(command) => command.target,
            Message::ParamRequestList { target }
            | Message::ParamRequestRead { target, .. }
            | Message::ParamSet { target, .. }
            | Message::ParamSetUnsupported { target, .. } => *target,
            _ => match message.service_target() {
                Some(target) if self.vehicle_services.is_some() => target,
                _ => return false,
            },
        };
        self.is_for_us(target)
    }

    /// Sends the heartbeats in step with those of another participant from now on, each right after the other's; without any, at our own
    /// period. Call it for each heartbeat of the other.
    pub fn follow_heartbeat(&mut self, now: Timestamp<C>) {
        self.rebase_clock(now);
        let period = self.config.heartbeat_period.max(MIN_PERIOD);
        let half = TimeDelta::from_nanos(period.as_nanos() / 2);
        let is_due = self.last_heartbeat.is_none_or(|last| now - last >= half);
        if is_due && self.heartbeat_mode == HeartbeatMode::Active {
            self.last_heartbeat = Some(now);
            self.send(Message::Heartbeat(self.config.heartbeat));
        }
        // The other may be late without being silent.
        self.next_heartbeat = now + period + half;
        self.idle_until = None;
    }

    /// Handles a message that arrived at `now`. Our own messages, from a link that echoes, are ignored.
    pub fn handle(&mut self, now: Timestamp<C>, from: Address, message: &Message) {
        self.handle_from_peer(now, SessionSender { address: from, peer: None }, message);
    }

    /// The same on a link where several participants may have one address: each of them replies to a time request.
    pub fn handle_from_peer(&mut self, now: Timestamp<C>, sender: SessionSender, message: &Message) {
        let from = sender.address;
        self.rebase_clock(now);
        if from == self.config.own {
            return;
        }
        self.peers.record_activity(now, from);
        // An arm that plans something new clears `idle_until`: with hundreds of peers the search for the next instant is expensive.
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "telemetry is not part of the conversation, however many kinds there are"
        )]
        match message {
            Message::Heartbeat(heartbeat) => self.on_heartbeat(now, from, *heartbeat),
            Message::TimeSync(sync) => self.on_time_sync(now, sender, *sync),
            Message::SetMessageInterval(request) => self.on_interval(from, *request),
            Message::Command(command) => self.on_command(from, *command, None),
            Message::CommandInt(exact) => {
                let command = exact.to_long();
                match SetMessageInterval::from_command(&command) {
                    Some(request) => self.on_interval(from, request),
                    None => self.on_command(from, command, Some(*exact)),
                }
            }
            Message::CommandAck(ack) => {
                self.idle_until = None;
                self.on_ack(now, from, *ack);
            }
            Message::ParamRequestList { .. }
            | Message::ParamRequestRead { .. }
            | Message::ParamSet { .. }
            | Message::ParamSetUnsupported { .. } => {
                self.idle_until = None;
                let own = self.config.own;
                let output = self.parameters.handle(now, own, from, message);
                self.outputs.extend(output);
            }
            Message::Plan(_) | Message::MissionItem(_) | Message::FileTransfer(_) | Message::Log(_) => {
                self.on_service_request(sender, message);
            }
            // A sign of life.
            _ => {}
        }
    }

    /// Records that a known peer is alive, from a message at `now` that is not for this session.
    pub fn record_activity(&mut self, now: Timestamp<C>, from: Address) {
        self.rebase_clock(now);
        self.peers.record_activity(now, from);
    }

    /// Starts or stops the heartbeats. The first one is due at once.
    pub fn set_heartbeat_mode(&mut self, now: Timestamp<C>, presence: HeartbeatMode) {
        let before = std::mem::replace(&mut self.heartbeat_mode, presence);
        if before == HeartbeatMode::Suppressed && presence == HeartbeatMode::Active {
            self.beat_now(now);
        }
    }

    /// The content of a heartbeat; `None` while suppressed.
    pub fn active_heartbeat(&self) -> Option<Heartbeat> {
        (self.heartbeat_mode == HeartbeatMode::Active).then_some(self.config.heartbeat)
    }

    /// Whether [`Self::tick`] has something to do at `now`.
    pub fn is_due(&mut self, now: Timestamp<C>) -> bool {
        // A clock that fell is followed by `tick`.
        if now >= self.latest && self.idle_until.is_some_and(|until| now < until) {
            return false;
        }
        let due = self.find_deadline();
        self.idle_until = Some(due);
        now < self.latest || due <= now
    }

    pub fn tick(&mut self, now: Timestamp<C>) {
        self.rebase_clock(now);
        self.idle_until = None;
        if now >= self.next_heartbeat {
            if self.heartbeat_mode == HeartbeatMode::Active {
                self.last_heartbeat = Some(now);
                self.send(Message::Heartbeat(self.config.heartbeat));
            }
            let period = self.config.heartbeat_period.max(MIN_PERIOD);
            self.next_heartbeat = next_period(self.next_heartbeat, period, now);
        }
        for (peer, silence) in self.peers.take_lost(now) {
            self.outputs.push_back(SessionOutput::PeerLost { peer, silence });
        }
        if let Some(request_nanos) = self.time_requests.due(now) {
            self.send(Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, target: None }));
        }
        let listed = self.parameters.due(now);
        self.outputs.extend(listed.map(SessionOutput::Send));
        for (target, (message_id, interval)) in self.peers.due_requests(now, &self.config.requested_messages) {
            self.send(Message::SetMessageInterval(SetMessageInterval { target, message_id, interval: Some(interval) }));
        }
    }

    pub fn poll(&mut self) -> Option<SessionOutput<C>> {
        self.outputs.pop_front()
    }

    pub fn is_idle(&self) -> bool {
        self.outputs.is_empty()
    }

    /// When to call [`Session::tick`], at the latest. There is always a next heartbeat.
    pub fn deadline(&self) -> Option<Timestamp<C>> {
        // A sign of life since it was found has only put the end off.
        Some(self.idle_until.unwrap_or_else(|| self.find_deadline()))
    }

    fn find_deadline(&self) -> Timestamp<C> {
        let others = [self.time_requests.deadline(), self.peers.deadline(), self.parameters.deadline()];
        let others = others.into_iter().flatten();
        others.fold(self.next_heartbeat, Timestamp::min)
    }

    /// Repeats all requests to a robot that was restarted and has forgotten them; ignored for unknown peers.
    pub fn peer_restarted(&mut self, now: Timestamp<C>, peer: Address) {
        self.rebase_clock(now);
        self.idle_until = None;
        self.peers.restart_requests(now, peer);
        self.time_requests.restart_quick(now);
    }

    pub fn acknowledge_command(&mut self, to: Address, command: u16, result: CommandResult) {
        self.send(Message::CommandAck(CommandAck { command, result: result as u8, target: Some(to) }));
    }

    pub fn queue_message(&mut self, message: Message) {
        self.send(message);
    }

    fn send(&mut self, message: Message) {
        self.outputs.push_back(SessionOutput::Send(message));
    }

    fn on_heartbeat(&mut self, now: Timestamp<C>, from: Address, heartbeat: Heartbeat) {
        if self.peers.record_heartbeat(now, from, heartbeat) {
            self.idle_until = None;
            self.time_requests.restart_quick(now);
            self.outputs.push_back(SessionOutput::PeerSeen { peer: from, heartbeat });
        }
    }

    fn on_time_sync(&mut self, now: Timestamp<C>, sender: SessionSender, sync: TimeSync) {
        let from = sender.address;
        let is_for_us = sync.target.is_none_or(|target| self.is_for_us(target));
        if !is_for_us {
            return;
        }
        if sync.answer_nanos == 0 {
            self.send(Message::TimeSync(TimeSync {
                answer_nanos: nonzero_nanos(now),
                request_nanos: sync.request_nanos,
                target: Some(from),
            }));
        } else if let Some(sent) = self.time_requests.match_response(now, sender, sync.request_nanos) {
            self.outputs.push_back(SessionOutput::TimeExchanged {
                peer: from,
                sent,
                received: now,
                peer_nanos: sync.answer_nanos,
            });
        }
    }

    fn on_interval(&mut self, by: Address, request: SetMessageInterval) {
        let own = self.config.own;
        // Ours, or for all components of our system; a broadcast gets no reply, or a whole class would start to send.
        if request.target.system != own.system || !self.is_for_us(request.target) {
            return;
        }
        if !self.config.offered_messages.contains(&request.message_id) {
            if request.target == own {
                self.acknowledge_command(by, COMMAND_SET_MESSAGE_INTERVAL, CommandResult::Unsupported);
            } else {
                // Of all components another one may send it: the owner knows whether there is one.
                self.on_command(by, request.to_command(), None);
            }
            return;
        }
        self.acknowledge_command(by, COMMAND_SET_MESSAGE_INTERVAL, CommandResult::Accepted);
        self.outputs.push_back(SessionOutput::IntervalRequested {
            by,
            message_id: request.message_id,
            interval: request.interval,
        });
    }

    fn on_command(&mut self, by: Address, command: CommandLong, exact: Option<CommandInt>) {
        let is_for_our_system = command.target.system == self.config.own.system
            && self.is_for_us(command.target)
            && self.served_commands.include(command.command);
        // Of a command to all components, only those that the owner serves: another one may have the better answer.
        if command.target == self.config.own || is_for_our_system {
            self.outputs.push_back(SessionOutput::CommandReceived { by, command, exact });
        }
    }

    fn on_service_request(&mut self, sender: SessionSender, message: &Message) {
        let own = self.config.own;
        // A broadcast gets no reply, or a whole class would start to send.
        let is_ours = |target: &Address| target.system == own.system && self.is_for_us(*target);
        if message.service_target().as_ref().is_none_or(|target| !is_ours(target)) {
            return;
        }
        if let Some(services) = &mut self.vehicle_services {
            if let Some(request) = services.owners_request(message) {
                self.outputs.push_back(SessionOutput::PlanReceived { by: sender, request });
                return;
            }
            let answers = services.answer(sender, message);
            self.outputs.extend(answers.into_iter().map(SessionOutput::Send));
        }
    }

    fn on_ack(&mut self, now: Timestamp<C>, from: Address, ack: CommandAck) {
        let is_for_us = ack.target.is_none_or(|target| self.is_for_us(target));
        let goes_on = [CommandResult::TemporarilyRejected, CommandResult::InProgress];
        let is_final = goes_on.iter().all(|result| *result as u8 != ack.result);
        if is_for_us && is_final && ack.command == COMMAND_SET_MESSAGE_INTERVAL {
            self.peers.record_response(now, from);
        }
    }

    fn is_for_us(&self, target: Address) -> bool {
        let own = self.config.own;
        (target.system.0 == 0 || target.system == own.system)
            && (target.component == ComponentId(0) || target.component == own.component)
    }

    /// A 32-bit clock falls when it wraps, and any clock may be set back: shifts the schedule with it, so that nothing
    /// waits for an hour.
    fn rebase_clock(&mut self, now: Timestamp<C>) {
        if now < self.latest {
            self.idle_until = None;
            let fall = self.latest - now;
            self.next_heartbeat = self.next_heartbeat - fall;
            self.last_heartbeat = self.last_heartbeat.map(|last| last - fall);
            self.time_requests.shift_clock(fall);
            self.peers.shift_clock(fall);
            self.parameters.shift_clock(fall);
        }
        self.latest = now;
    }
}

/// Our clock in a reply; 0 would make a request of it.
fn nonzero_nanos<C: Clock>(now: Timestamp<C>) -> i64 {
    match now.as_nanos() {
        0 => 1,
        nanos => nanos,
    }
}

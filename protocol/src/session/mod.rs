//! Who is there, what time is it there, and please send me this: the conversation beside the telemetry.
//!
//! A session is one participant's part of it, for one link: heartbeats, peers, TIMESYNC, message intervals and the answers
//! to commands, and parameters. It is a value without IO: it gets time and messages, it gives messages and events, and says when it wants
//! to be woken. The station, the simulated brick and the simulated camera all run the same one, each in its own clock.
//!
//! It does not estimate clock offsets (it reports exchanges), does not parse bytes, and does not know what a parameter or a command
//! means.
//!
//! # Sources
//! MAVLink guide: "Heartbeat/Connection Protocol", "Time Synchronization Protocol v2", "Command Protocol", and the command
//! MAV_CMD_SET_MESSAGE_INTERVAL of common.xml.

mod parameters;
mod peers;
mod time_requests;

use std::collections::VecDeque;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, ComponentId, Span, Stamp};

use self::parameters::Parameters;
use self::peers::Peers;
use self::time_requests::TimeRequests;
use crate::dialect::ids::COMMAND_SET_MESSAGE_INTERVAL;
use crate::message::{CommandAck, CommandLong, CommandResult, Heartbeat, Message, SetMessageInterval, TimeSync};

/// Shorter periods than this are taken as this, so that a zero in a configuration cannot spin.
const SHORTEST_PERIOD: Span = Span::from_millis(1);

/// How a [`Session`] behaves.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionConfig {
    /// Who we are on this link.
    pub own: Address,
    /// What we say of ourselves.
    pub heartbeat: Heartbeat,
    /// Time between our heartbeats; the convention is one second.
    pub heartbeat_period: Span,
    /// Time between our time requests once the first ten are out; `None` answers only.
    pub timesync_period: Option<Span>,
    /// Silence after which a peer is lost.
    pub peer_timeout: Span,
    /// Messages that every newly seen robot is asked for, with their intervals.
    pub wanted: Vec<(u32, Span)>,
    /// Messages whose interval others may set; a request for any other is answered as unsupported.
    pub offered: Vec<u32>,
}

/// Whether a [`Session`] shows that it is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Presence {
    /// It sends heartbeats.
    #[default]
    Shown,
    /// It sends none, because what it speaks for is not there: others must see that. It answers all the same.
    Withheld,
}

/// What a [`Session`] wants done or known.
#[derive(Clone, Debug, PartialEq)]
pub enum SessionOutput<C: Clock> {
    /// Send this from our own address.
    Send(Message),
    /// A peer was heard for the first time, or again after it was lost.
    PeerSeen {
        /// Who it is.
        peer: Address,
        /// What it says of itself.
        heartbeat: Heartbeat,
    },
    /// A peer has fallen silent.
    PeerLost {
        /// Who it was.
        peer: Address,
        /// Time since it was last heard.
        silence: Span,
    },
    /// A time request of ours was answered.
    TimeExchanged {
        /// Who answered.
        peer: Address,
        /// When we asked.
        sent: Stamp<C>,
        /// When the answer arrived.
        received: Stamp<C>,
        /// The peer's clock in between, in nanoseconds.
        peer_nanos: i64,
    },
    /// Somebody asks us to send a message at an interval; it was told that we will.
    IntervalRequested {
        /// Who asks.
        by: Address,
        /// The message's id.
        message_id: u32,
        /// The interval; `None` stops the message, zero asks for our default.
        interval: Option<Span>,
    },
    /// Somebody commands us alone, or all of our system something that we serve. Whoever owns the session says with
    /// [`Session::answer`] what became of it; [`CommandResult::Unsupported`] if nobody takes it.
    Commanded {
        /// Who commands.
        by: Address,
        /// The command, known to us or not; COMMAND_INT comes in this form, too.
        command: CommandLong,
    },
    /// Somebody wants one of our parameters to have another value; what stands afterwards must be told with
    /// [`Session::parameter_stands`].
    ParameterWish {
        /// Who asks.
        by: Address,
        /// Which of those that were offered.
        index: usize,
        /// The value, any bits.
        value: f32,
    },
    /// Somebody wants one of our parameters to have a value of a type that cannot be read; what stands must be told as after a wish.
    ParameterUnsupported {
        /// Who asks.
        by: Address,
        /// Which of those that were offered.
        index: usize,
        /// MAV_PARAM_TYPE of the value.
        kind: u8,
    },
    /// Somebody asks us alone for a parameter that we do not have; nothing is answered.
    ParameterUnknown {
        /// Who asks.
        by: Address,
        /// The name or the index that was asked for, as it came.
        asked: String,
    },
}

/// One participant's part of the conversation on one link, in its own clock `C`.
#[derive(Debug)]
pub struct Session<C: Clock> {
    config: SessionConfig,
    latest: Stamp<C>,
    next_heartbeat: Stamp<C>,
    /// Before this nothing is due; `None` if that must be found out. What is planned for later can only be put off without this.
    idle_until: Option<Stamp<C>>,
    presence: Presence,
    time_requests: TimeRequests<C>,
    peers: Peers<C>,
    parameters: Parameters<C>,
    /// Commands that are passed on.
    served: &'static [u16],
    outputs: VecDeque<SessionOutput<C>>,
}

impl<C: Clock> Session<C> {
    /// A session that has heard nobody; its first heartbeat is due at `now`.
    #[must_use]
    pub fn new(config: SessionConfig, now: Stamp<C>) -> Self {
        Self {
            time_requests: TimeRequests::new(config.timesync_period, now),
            peers: Peers::new(config.peer_timeout),
            parameters: Parameters::none(),
            served: &[],
            latest: now,
            next_heartbeat: now,
            idle_until: None,
            presence: Presence::Shown,
            outputs: VecDeque::new(),
            config,
        }
    }

    /// Offers parameters by these names, at most sixteen bytes each, with these values. Their number and order must not change.
    pub fn offer_parameters(&mut self, named: impl Iterator<Item = (String, f32)>) {
        self.parameters.offer(named);
    }

    /// This value of an offered parameter stands now, whether anything changed or not. What is to be sent to all on this link, if
    /// anybody there has ever asked.
    pub fn parameter_stands(&mut self, index: usize, value: f32) -> Option<Message> {
        self.parameters.stand(index, value)
    }

    /// Passes these commands on, as [`SessionOutput::Commanded`], also when they are for all components of our system.
    pub const fn serve_commands(&mut self, served: &'static [u16]) {
        self.served = served;
    }

    /// Takes a message that arrived at `now`. Our own messages, coming back from a link that echoes, are ignored.
    pub fn handle(&mut self, now: Stamp<C>, from: Address, message: &Message) {
        self.follow_clock(now);
        if from == self.config.own {
            return;
        }
        self.peers.heard(now, from);
        let idle_until = self.idle_until.take();
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "telemetry is not part of the conversation, however many kinds there are"
        )]
        match message {
            Message::Heartbeat(heartbeat) => self.on_heartbeat(now, from, *heartbeat),
            Message::TimeSync(sync) => self.on_time_sync(now, from, *sync),
            Message::SetMessageInterval(wanted) => self.on_interval(from, *wanted),
            Message::Command(command) => self.on_command(from, *command),
            Message::CommandInt(command) => {
                let command = command.to_long();
                match SetMessageInterval::of(&command) {
                    Some(wanted) => self.on_interval(from, wanted),
                    None => self.on_command(from, command),
                }
            }
            Message::CommandAck(ack) => self.on_ack(now, from, *ack),
            Message::ParamRequestList { .. }
            | Message::ParamRequestRead { .. }
            | Message::ParamSet { .. }
            | Message::ParamSetUnsupported { .. } => {
                let own = self.config.own;
                let output = self.parameters.handle(now, (own, from), message);
                self.outputs.extend(output);
            }
            // A sign of life, which plans nothing.
            _ => self.idle_until = idle_until,
        }
    }

    /// Takes note that a known peer is alive, from a message at `now` that is not for this session.
    pub fn heard(&mut self, now: Stamp<C>, from: Address) {
        self.follow_clock(now);
        self.peers.heard(now, from);
    }

    /// Whether heartbeats are sent from now on; the beat stays the same.
    pub const fn show(&mut self, presence: Presence) {
        self.presence = presence;
    }

    /// What is said in a heartbeat; `None` while they are withheld.
    #[must_use]
    pub fn shown_heartbeat(&self) -> Option<Heartbeat> {
        (self.presence == Presence::Shown).then_some(self.config.heartbeat)
    }

    /// Whether [`Self::tick`] has something to do at `now`.
    pub fn is_due(&mut self, now: Stamp<C>) -> bool {
        // A clock that fell is followed by `tick`.
        if now >= self.latest && self.idle_until.is_some_and(|until| now < until) {
            return false;
        }
        self.idle_until = self.deadline();
        now < self.latest || self.idle_until.is_some_and(|due| due <= now)
    }

    /// Does what is due at `now`.
    pub fn tick(&mut self, now: Stamp<C>) {
        self.follow_clock(now);
        self.idle_until = None;
        if now >= self.next_heartbeat {
            if self.presence == Presence::Shown {
                self.send(Message::Heartbeat(self.config.heartbeat));
            }
            let period = self.config.heartbeat_period.max(SHORTEST_PERIOD);
            self.next_heartbeat = next_after(self.next_heartbeat, period, now);
        }
        for (peer, silence) in self.peers.take_lost(now) {
            self.outputs.push_back(SessionOutput::PeerLost { peer, silence });
        }
        if let Some(request_nanos) = self.time_requests.due(now) {
            self.send(Message::TimeSync(TimeSync { answer_nanos: 0, request_nanos, target: None }));
        }
        let listed = self.parameters.due(now);
        self.outputs.extend(listed.map(SessionOutput::Send));
        for (target, index) in self.peers.due_requests(now, self.config.wanted.len()) {
            let (message_id, interval) = self.config.wanted[index];
            self.send(Message::SetMessageInterval(SetMessageInterval { target, message_id, interval: Some(interval) }));
        }
    }

    /// What is to be done next; `None` when nothing is left.
    pub fn poll(&mut self) -> Option<SessionOutput<C>> {
        self.outputs.pop_front()
    }

    /// Whether [`Self::poll`] has nothing.
    #[must_use]
    pub fn is_silent(&self) -> bool {
        self.outputs.is_empty()
    }

    /// When to call [`Session::tick`]. There is always a next heartbeat.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<C>> {
        let others = [self.time_requests.deadline(), self.peers.deadline(), self.parameters.deadline()];
        let others = others.into_iter().flatten();
        Some(others.fold(self.next_heartbeat, Stamp::min))
    }

    /// Asks a robot again for everything wanted, because it was restarted and has forgotten; ignored for strangers.
    pub fn peer_restarted(&mut self, now: Stamp<C>, peer: Address) {
        self.follow_clock(now);
        self.idle_until = None;
        self.peers.request_again(now, peer);
        self.time_requests.hurry(now);
    }

    /// Tells who has sent a command what became of it.
    pub fn answer(&mut self, to: Address, command: u16, result: CommandResult) {
        self.send(Message::CommandAck(CommandAck { command, result: result as u8, target: Some(to) }));
    }

    /// Sends a message of its owner's, behind what it has to say already.
    pub fn say(&mut self, message: Message) {
        self.send(message);
    }

    fn send(&mut self, message: Message) {
        self.outputs.push_back(SessionOutput::Send(message));
    }

    fn on_heartbeat(&mut self, now: Stamp<C>, from: Address, heartbeat: Heartbeat) {
        if self.peers.introduce(now, from, heartbeat) {
            self.time_requests.hurry(now);
            self.outputs.push_back(SessionOutput::PeerSeen { peer: from, heartbeat });
        }
    }

    fn on_time_sync(&mut self, now: Stamp<C>, from: Address, sync: TimeSync) {
        let is_for_us = sync.target.is_none_or(|target| self.is_us_or_all(target));
        if !is_for_us {
            return;
        }
        if sync.answer_nanos == 0 {
            self.send(Message::TimeSync(TimeSync {
                answer_nanos: answer_nanos(now),
                request_nanos: sync.request_nanos,
                target: Some(from),
            }));
        } else if let Some(sent) = self.time_requests.answered(now, from, sync.request_nanos) {
            self.outputs.push_back(SessionOutput::TimeExchanged {
                peer: from,
                sent,
                received: now,
                peer_nanos: sync.answer_nanos,
            });
        }
    }

    fn on_interval(&mut self, by: Address, wanted: SetMessageInterval) {
        let own = self.config.own;
        // Ours, or for all components of our system; "everybody" is not answered for, lest a whole class starts to send.
        if wanted.target.system != own.system || !self.is_us_or_all(wanted.target) {
            return;
        }
        if !self.config.offered.contains(&wanted.message_id) {
            self.answer(by, COMMAND_SET_MESSAGE_INTERVAL, CommandResult::Unsupported);
            return;
        }
        self.answer(by, COMMAND_SET_MESSAGE_INTERVAL, CommandResult::Accepted);
        self.outputs.push_back(SessionOutput::IntervalRequested {
            by,
            message_id: wanted.message_id,
            interval: wanted.interval,
        });
    }

    fn on_command(&mut self, by: Address, command: CommandLong) {
        let is_for_our_system = command.target.system == self.config.own.system
            && self.is_us_or_all(command.target)
            && self.served.contains(&command.command);
        // Only when meant for us alone: for a command to all components, another one may have the better answer.
        if command.target == self.config.own || is_for_our_system {
            self.outputs.push_back(SessionOutput::Commanded { by, command });
        }
    }

    fn on_ack(&mut self, now: Stamp<C>, from: Address, ack: CommandAck) {
        let is_for_us = ack.target.is_none_or(|target| self.is_us_or_all(target));
        let goes_on = [CommandResult::TemporarilyRejected, CommandResult::InProgress];
        let is_final = goes_on.iter().all(|result| *result as u8 != ack.result);
        if is_for_us && is_final && ack.command == COMMAND_SET_MESSAGE_INTERVAL {
            self.peers.request_answered(now, from);
        }
    }

    fn is_us_or_all(&self, target: Address) -> bool {
        let own = self.config.own;
        (target.system.0 == 0 || target.system == own.system)
            && (target.component == ComponentId(0) || target.component == own.component)
    }

    /// A clock of 32 bits falls when it wraps, and any clock may be set back: everything planned falls with it, so that
    /// nothing waits for a time that comes an hour later.
    fn follow_clock(&mut self, now: Stamp<C>) {
        if now < self.latest {
            self.idle_until = None;
            let fall = self.latest - now;
            self.next_heartbeat = self.next_heartbeat - fall;
            self.time_requests.set_back(fall);
            self.peers.set_back(fall);
            self.parameters.set_back(fall);
        }
        self.latest = now;
    }
}

/// Our clock in an answer; 0 would make a request of it.
fn answer_nanos<C: Clock>(now: Stamp<C>) -> i64 {
    match now.as_nanos() {
        0 => 1,
        nanos => nanos,
    }
}

/// The next time of a periodic action: in step with the last one, or from now on when whole periods were missed.
fn next_after<C: Clock>(due: Stamp<C>, period: Span, now: Stamp<C>) -> Stamp<C> {
    let next = due + period;
    if next > now { next } else { now + period }
}

//! Who is there, what time is it there, and please send me this: the conversation beside the telemetry.
//!
//! A session is one participant's part of it, for one link: heartbeats, peers, TIMESYNC, message intervals and the answers
//! to commands. It is a value without IO: it gets time and messages, it gives messages and events, and says when it wants
//! to be woken. The station, the simulated brick and the simulated camera all run the same one, each in its own clock.
//!
//! It does not estimate clock offsets (it reports exchanges), does not parse bytes, and knows no parameter.
//!
//! # Sources
//! MAVLink guide: "Heartbeat/Connection Protocol", "Time Synchronization Protocol v2", "Command Protocol", and the command
//! MAV_CMD_SET_MESSAGE_INTERVAL of common.xml.

mod peers;
mod time_requests;

use std::collections::VecDeque;

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, ComponentId, Span, Stamp};

use self::peers::Peers;
use self::time_requests::TimeRequests;
use crate::dialect::ids::COMMAND_SET_MESSAGE_INTERVAL;
use crate::message::{CommandAck, CommandLong, Heartbeat, Message, SetMessageInterval, TimeSync};

/// MAV_RESULT values that are sent or understood.
mod result {
    pub(super) const ACCEPTED: u8 = 0;
    pub(super) const TEMPORARILY_REJECTED: u8 = 1;
    pub(super) const UNSUPPORTED: u8 = 3;
    pub(super) const IN_PROGRESS: u8 = 5;
}

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
}

/// One participant's part of the conversation on one link, in its own clock `C`.
#[derive(Debug)]
pub struct Session<C: Clock> {
    config: SessionConfig,
    latest: Stamp<C>,
    next_heartbeat: Stamp<C>,
    time_requests: TimeRequests<C>,
    peers: Peers<C>,
    outputs: VecDeque<SessionOutput<C>>,
}

impl<C: Clock> Session<C> {
    /// A session that has heard nobody; its first heartbeat is due at `now`.
    #[must_use]
    pub fn new(config: SessionConfig, now: Stamp<C>) -> Self {
        Self {
            time_requests: TimeRequests::new(config.timesync_period, now),
            peers: Peers::new(config.peer_timeout),
            latest: now,
            next_heartbeat: now,
            outputs: VecDeque::new(),
            config,
        }
    }

    /// Takes a message that arrived at `now`. Our own messages, coming back from a link that echoes, are ignored.
    pub fn handle(&mut self, now: Stamp<C>, from: Address, message: &Message) {
        self.follow_clock(now);
        if from == self.config.own {
            return;
        }
        self.peers.heard(now, from);
        #[expect(
            clippy::wildcard_enum_match_arm,
            reason = "telemetry is not part of the conversation, however many kinds there are"
        )]
        match message {
            Message::Heartbeat(heartbeat) => self.on_heartbeat(now, from, *heartbeat),
            Message::TimeSync(sync) => self.on_time_sync(now, from, *sync),
            Message::SetMessageInterval(wanted) => self.on_interval(from, *wanted),
            Message::Command(command) => self.on_command(from, command),
            Message::CommandAck(ack) => self.on_ack(now, from, *ack),
            _ => {}
        }
    }

    /// Takes note that a known peer is alive, from a message at `now` that is not for this session.
    pub fn heard(&mut self, now: Stamp<C>, from: Address) {
        self.follow_clock(now);
        self.peers.heard(now, from);
    }

    /// Does what is due at `now`.
    pub fn tick(&mut self, now: Stamp<C>) {
        self.follow_clock(now);
        if now >= self.next_heartbeat {
            self.send(Message::Heartbeat(self.config.heartbeat));
            let period = self.config.heartbeat_period.max(SHORTEST_PERIOD);
            self.next_heartbeat = next_after(self.next_heartbeat, period, now);
        }
        for (peer, silence) in self.peers.take_lost(now) {
            self.outputs
                .push_back(SessionOutput::PeerLost { peer, silence });
        }
        if let Some(request_nanos) = self.time_requests.due(now) {
            self.send(Message::TimeSync(TimeSync {
                answer_nanos: 0,
                request_nanos,
                target: None,
            }));
        }
        for (target, index) in self.peers.due_requests(now, self.config.wanted.len()) {
            let (message_id, interval) = self.config.wanted[index];
            self.send(Message::SetMessageInterval(SetMessageInterval {
                target,
                message_id,
                interval: Some(interval),
            }));
        }
    }

    /// What is to be done next; `None` when nothing is left.
    pub fn poll(&mut self) -> Option<SessionOutput<C>> {
        self.outputs.pop_front()
    }

    /// When to call [`Session::tick`]. There is always a next heartbeat.
    #[must_use]
    pub fn deadline(&self) -> Option<Stamp<C>> {
        [self.time_requests.deadline(), self.peers.deadline()]
            .into_iter()
            .flatten()
            .chain([self.next_heartbeat])
            .min()
    }

    /// Asks a robot again for everything wanted, because it was restarted and has forgotten; ignored for strangers.
    pub fn peer_restarted(&mut self, now: Stamp<C>, peer: Address) {
        self.follow_clock(now);
        self.peers.request_again(now, peer);
        self.time_requests.hurry(now);
    }

    fn send(&mut self, message: Message) {
        self.outputs.push_back(SessionOutput::Send(message));
    }

    fn on_heartbeat(&mut self, now: Stamp<C>, from: Address, heartbeat: Heartbeat) {
        if self.peers.introduce(now, from, heartbeat) {
            self.time_requests.hurry(now);
            self.outputs.push_back(SessionOutput::PeerSeen {
                peer: from,
                heartbeat,
            });
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
            self.acknowledge(by, COMMAND_SET_MESSAGE_INTERVAL, result::UNSUPPORTED);
            return;
        }
        self.acknowledge(by, COMMAND_SET_MESSAGE_INTERVAL, result::ACCEPTED);
        self.outputs.push_back(SessionOutput::IntervalRequested {
            by,
            message_id: wanted.message_id,
            interval: wanted.interval,
        });
    }

    fn on_command(&mut self, from: Address, command: &CommandLong) {
        // Only when meant for us alone: for a command to all components, another one may have the better answer.
        if command.target == self.config.own {
            self.acknowledge(from, command.command, result::UNSUPPORTED);
        }
    }

    fn on_ack(&mut self, now: Stamp<C>, from: Address, ack: CommandAck) {
        let is_for_us = ack.target.is_none_or(|target| self.is_us_or_all(target));
        let is_final = !matches!(
            ack.result,
            result::TEMPORARILY_REJECTED | result::IN_PROGRESS
        );
        if is_for_us && is_final && ack.command == COMMAND_SET_MESSAGE_INTERVAL {
            self.peers.request_answered(now, from);
        }
    }

    fn acknowledge(&mut self, to: Address, command: u16, result: u8) {
        self.send(Message::CommandAck(CommandAck {
            command,
            result,
            target: Some(to),
        }));
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
            let fall = self.latest - now;
            self.next_heartbeat = self.next_heartbeat - fall;
            self.time_requests.set_back(fall);
            self.peers.set_back(fall);
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

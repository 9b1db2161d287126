//! The conversation beside the telemetry: what the sessions want done, and what they learn about clocks.

use std::ops::Bound;

use posebridge_protocol::message::Message;
use posebridge_protocol::routing::{Occurrence, Way};
use posebridge_protocol::session::SessionOutput;
use posebridge_telemetry::{Address, Event, HostClock, LinkId, LinkState, PeerId, Priority, RobotId, Stamp};

use super::Pipeline;
use super::intake::{Arrival, Arrived};
use crate::clock::align::Alignment;
use crate::clock::unwrap::Unwrapped;
use crate::link_state::{Link, Speaker};

/// A time request and its answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exchange {
    pub(super) sent: Stamp<HostClock>,
    pub(super) answer: Arrival,
    pub(super) peer_nanos: i64,
}

impl Pipeline {
    /// Lets the session of a link hear a message, as far as that is what the link is for. `from` is its sender on the first link of
    /// the group.
    ///
    /// A request that has come before was done then. What went round a loop is not said on this link; only the robot is always heard
    /// on his own, because a copy may have been quicker. But answers are waited for where the question left, and so is a sign of life.
    pub(super) fn converse(&mut self, arrival: Arrival, from: RobotId, arrived: &Arrived) {
        let message = &arrived.message;
        let is_heard = match arrived.occurrence {
            Occurrence::First => true,
            Occurrence::Detour if self.robot != Some(from) => is_answer(message),
            Occurrence::Redundant | Occurrence::Detour => !is_request(message),
            Occurrence::Echo | Occurrence::Namesake => return,
        };
        if let Some(link) = self.links.get_mut(&arrival.way.link) {
            if is_heard {
                link.session.handle(self.now, arrived.source, message);
                if let Some(voice) = &mut link.voice
                    && voice.takes(self.now, message)
                    && let Some(session) = voice.session()
                {
                    session.handle(self.now, arrived.source, message);
                }
            } else {
                link.session.heard(self.now, arrived.source);
            }
        }
        self.drain_session(arrival);
    }

    /// Does what sessions want done that were given something to say by others than their peers.
    pub(super) fn drain_sessions(&mut self, now: Stamp<HostClock>) {
        if self.links.values().all(Link::is_silent) {
            return;
        }
        let mut next = self.links.keys().next().copied();
        while let Some(link) = next {
            let peer = PeerId::default();
            let way = Way { link, peer };
            self.drain_session(Arrival { way, at: now });
            let behind = (Bound::Excluded(link), Bound::Unbounded);
            next = self.links.range(behind).next().map(|(id, _)| *id);
        }
    }

    /// Does what the session of a link wants done after it took what came so, or time.
    pub(super) fn drain_session(&mut self, arrival: Arrival) {
        let id = arrival.way.link;
        while let Some((speaker, output)) = self.links.get_mut(&id).and_then(Link::poll_conversation) {
            match output {
                // Nobody hears it; the session says it again when the link is back.
                SessionOutput::Send(_) if self.is_down(id) => {}
                SessionOutput::Send(message) => self.say_on(id, speaker, &message),
                SessionOutput::PeerSeen { peer, .. } => {
                    self.tell(Event::RobotSeen { robot: RobotId { link: id, address: peer } });
                }
                SessionOutput::PeerLost { peer, silence } => {
                    self.tell(Event::RobotLost { robot: RobotId { link: id, address: peer }, silence });
                }
                SessionOutput::TimeExchanged { peer, sent, peer_nanos, .. } => {
                    // The session's own idea of when it came is when it was handled.
                    let exchange = Exchange { sent, answer: arrival, peer_nanos };
                    self.handle_exchange(peer, exchange);
                }
                SessionOutput::Commanded { by, command } => {
                    self.commanded((id, speaker), by, &command);
                }
                SessionOutput::IntervalRequested { message_id, interval, .. } => {
                    if let Some(link) = self.links.get_mut(&id) {
                        link.publisher.set_interval(message_id, interval);
                    }
                }
                SessionOutput::ParameterWish { index, value, .. } => {
                    self.handle_wish(id, index, value);
                }
                SessionOutput::ParameterUnsupported { index, kind, .. } => {
                    self.handle_unsupported_type(id, index, kind);
                }
                SessionOutput::ParameterUnknown { asked, .. } => {
                    self.handle_unknown_parameter(id, &asked);
                }
            }
        }
    }

    fn say_on(&mut self, id: LinkId, speaker: Speaker, message: &Message) {
        let priority = priority_of(message);
        match speaker {
            Speaker::Station => self.transmit(id, message, priority),
            Speaker::Robot => self.transmit_conversation_of_robot(id, message, priority),
        }
    }

    fn is_down(&self, id: LinkId) -> bool {
        self.links.get(&id).is_none_or(|link| link.state == LinkState::Down)
    }

    pub(super) fn handle_exchange(&mut self, peer: Address, exchange: Exchange) {
        // No clock of a brick or a camera counts backwards from its power-up: a negative instant is damage.
        if exchange.peer_nanos < 0 {
            return;
        }
        // Bounds of one clock, whichever of several redundant links they came by.
        let id = self.router.first_of_group(exchange.answer.way.link);
        let from = RobotId { link: id, address: peer };
        if self.robot == Some(from) {
            self.align_brick(from, exchange);
        } else {
            self.align_observer((id, peer), exchange);
        }
    }

    fn align_brick(&mut self, robot: RobotId, exchange: Exchange) {
        let Exchange { sent, answer: Arrival { way, at }, peer_nanos } = exchange;
        let (unwrapped, alignment) = self.brick_clock.exchanged(way, sent, at, peer_nanos);
        if self.brick_clock.take_contradiction() {
            self.tell_unaligned(way.link, robot.address);
        }
        if matches!(unwrapped, Unwrapped::Restarted(_)) {
            self.brick_restarted(robot);
        }
        if let Some(Alignment { remote, host, offset, skew_ppm, uncertainty, round_trip, .. }) = alignment {
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
    }

    fn align_observer(&mut self, (id, camera): (LinkId, Address), exchange: Exchange) {
        let Exchange { sent, answer: Arrival { way, at }, peer_nanos } = exchange;
        let clock = self.observers.entry((id, camera)).or_default();
        let (unwrapped, alignment) = clock.exchanged(way, sent, at, peer_nanos);
        if clock.take_contradiction() {
            self.tell_unaligned(way.link, camera);
        }
        if matches!(unwrapped, Unwrapped::Restarted(_)) {
            self.ask_time_again(id, camera);
        }
        if let Some(alignment) = alignment {
            self.tell(Event::CameraClockAligned {
                camera,
                offset: alignment.offset,
                uncertainty: alignment.uncertainty,
                stamp: alignment.remote,
                host: alignment.host,
            });
        }
    }

    /// A participant's clock began anew: some quick exchanges say how it runs now.
    pub(super) fn ask_time_again(&mut self, id: LinkId, peer: Address) {
        let now = self.now;
        if let Some(link) = self.links.get_mut(&id) {
            link.session.peer_restarted(now, peer);
        }
    }
}

/// Whether a message asks the station for something that must not be done twice.
const fn is_request(message: &Message) -> bool {
    matches!(
        message,
        Message::SetMessageInterval(_)
            | Message::Command(_)
            | Message::CommandInt(_)
            | Message::ParamRequestList { .. }
            | Message::ParamRequestRead { .. }
            | Message::ParamSet { .. }
            | Message::ParamSetUnsupported { .. }
    )
}

/// Whether a message answers what the station asked on some link.
const fn is_answer(message: &Message) -> bool {
    if let Message::TimeSync(sync) = message {
        sync.answer_nanos != 0
    } else {
        matches!(message, Message::CommandAck(_))
    }
}

/// What a message of the session is worth on a slow link: heartbeats and time requests are said again, the others are not.
const fn priority_of(message: &Message) -> Priority {
    if matches!(message, Message::Heartbeat(_) | Message::TimeSync(_)) {
        Priority::Conversation
    } else {
        Priority::Command
    }
}

//! One MAVLink participant of the simulated world: a session, a sequence counter and a send queue.
//!
//! The brick and the camera are two of them behind one link; each schedules its own telemetry.

use posebridge_brick::Link;
use posebridge_protocol::dialect::{Encoder, ids};
use posebridge_protocol::framing::WireVersion;
use posebridge_protocol::message::{CommandLong, CommandResult, Heartbeat, Message};
use posebridge_protocol::session::{RequestedMessages, Session, SessionConfig, SessionOutput};
use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, TimeDelta, Timestamp};

/// Offset of the sequence number in a MAVLink 2 frame.
const SEQUENCE: usize = 4;

/// Any message: only the sequence number of its frame is used.
const NOT_SENT: Heartbeat = Heartbeat { vehicle_type: 0, autopilot: 0, base_mode: 0, system_status: 0 };

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct IntervalRequest {
    pub(crate) message_id: u32,
    /// `None` stops the message, zero requests the default.
    pub(crate) interval: Option<TimeDelta>,
}

impl IntervalRequest {
    pub(crate) fn interval_or(self, default: TimeDelta) -> Option<TimeDelta> {
        self.interval.map(|interval| if interval <= TimeDelta::ZERO { default } else { interval })
    }
}

#[derive(Debug)]
pub(crate) struct MavlinkNode<C: Clock> {
    own: Address,
    session: Session<C>,
    encoder: Encoder,
    outgoing: Vec<Vec<u8>>,
    /// Messages that are sent once on request.
    offered_messages: Vec<u32>,
    pub(crate) is_fix_requested: bool,
}

impl<C: Clock> MavlinkNode<C> {
    /// A participant that is powered up at `now`. All timestamps passed to it are those that its clock shows to others, wraps included:
    /// TIMESYNC replies contain them. Only the `offered` messages accept another interval.
    pub(crate) fn new(own: Address, heartbeat: Heartbeat, now: Timestamp<C>, offered: &[u32]) -> Self {
        let config = SessionConfig {
            own,
            heartbeat,
            heartbeat_period: TimeDelta::from_millis(1_000),
            timesync_period: None,
            peer_timeout: TimeDelta::from_millis(5_000),
            requested_messages: RequestedMessages::default(),
            offered_messages: offered.to_vec(),
        };
        Self {
            own,
            session: Session::new(config, now),
            encoder: Encoder::new(WireVersion::V2),
            outgoing: Vec::new(),
            offered_messages: offered.to_vec(),
            is_fix_requested: false,
        }
    }

    fn is_fix_request(&self, command: &CommandLong) -> bool {
        command.command == ids::COMMAND_REQUEST_MESSAGE
            && command.named_message() == Some(ids::VISION_POSITION_ESTIMATE)
            && self.offered_messages.contains(&ids::VISION_POSITION_ESTIMATE)
    }

    pub(crate) fn handle(&mut self, now: Timestamp<C>, from: Address, message: &Message) -> Vec<IntervalRequest> {
        self.session.handle(now, from, message);
        self.drain()
    }

    pub(crate) fn tick(&mut self, now: Timestamp<C>) -> Vec<IntervalRequest> {
        self.session.tick(now);
        self.drain()
    }

    pub(crate) fn send(&mut self, message: &Message) {
        let mut frame = Vec::new();
        self.encoder.encode(self.own, message, &mut frame);
        self.outgoing.push(frame);
    }

    /// Queues a frame that the brick SDK writes, with this participant's next sequence number.
    pub(crate) fn send_with_sdk(&mut self, write: impl FnOnce(&mut Link, &mut dyn FnMut(&[u8]))) {
        // The encoder counts for both: it encodes a frame that is not sent.
        let mut not_sent = Vec::new();
        self.encoder.encode(self.own, &Message::Heartbeat(NOT_SENT), &mut not_sent);
        let sequence = not_sent.get(SEQUENCE).copied().unwrap_or_default();
        let mut link = Link::continued(self.own.system.0, self.own.component.0, sequence);
        write(&mut link, &mut |frame| self.outgoing.push(frame.to_vec()));
    }

    pub(crate) fn next_bytes(&mut self) -> Option<Vec<u8>> {
        (!self.outgoing.is_empty()).then(|| self.take_frames().concat())
    }

    pub(crate) fn take_frames(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.outgoing)
    }

    fn drain(&mut self) -> Vec<IntervalRequest> {
        let mut requests = Vec::new();
        while let Some(output) = self.session.poll() {
            match output {
                SessionOutput::Send(message) => self.send(&message),
                SessionOutput::IntervalRequested { message_id, interval, .. } => {
                    requests.push(IntervalRequest { message_id, interval });
                }
                SessionOutput::CommandReceived { by, command, .. } => {
                    let is_for_fix = self.is_fix_request(&command);
                    self.is_fix_requested |= is_for_fix;
                    let result = if is_for_fix { CommandResult::Accepted } else { CommandResult::Unsupported };
                    self.session.acknowledge_command(by, command.command, result);
                }
                // It offers no parameters.
                SessionOutput::PeerSeen { .. }
                | SessionOutput::PeerLost { .. }
                | SessionOutput::TimeExchanged { .. }
                | SessionOutput::PlanReceived { .. }
                | SessionOutput::ParameterSetRequested { .. }
                | SessionOutput::ParameterUnsupported { .. }
                | SessionOutput::ParameterUnknown { .. } => {}
            }
        }
        requests
    }
}

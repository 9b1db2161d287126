//! The outputs of a session, its senders, and the schedule of periodic actions.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, PeerId, TimeDelta, Timestamp};

use crate::message::{CommandInt, CommandLong, Heartbeat, Message, MissionItem, PlanMessage};

/// A message or an event of a [`Session`](super::Session).
#[derive(Clone, Debug, PartialEq)]
pub enum SessionOutput<C: Clock> {
    /// Send this from our own address.
    Send(Message),
    /// The first message of a peer, or its first one after it was lost.
    PeerSeen { peer: Address, heartbeat: Heartbeat },
    /// No message of a peer within the time-out.
    PeerLost { peer: Address, silence: TimeDelta },
    /// A reply to a time request of ours.
    TimeExchanged {
        peer: Address,
        sent: Timestamp<C>,
        received: Timestamp<C>,
        /// The peer's clock in between.
        peer_nanos: i64,
    },
    /// A request to send a message at an interval; the session acknowledges it.
    IntervalRequested {
        by: Address,
        message_id: u32,
        /// `None` stops the message, zero requests our default.
        interval: Option<TimeDelta>,
    },
    /// A command to us alone, or one of the served commands to all of our system. The owner reports its result with
    /// [`Session::acknowledge_command`](super::Session::acknowledge_command);
    /// [`CommandResult::Unsupported`](crate::message::CommandResult::Unsupported) if no component accepts it.
    CommandReceived {
        by: Address,
        /// Supported or not; COMMAND_INT is converted to this form.
        command: CommandLong,
        /// The command as it came, with exact coordinates, if it was a COMMAND_INT.
        exact: Option<CommandInt>,
    },
    /// A request about the mission of a vehicle whose plans its owner keeps ([`PlanService::Owner`](super::PlanService::Owner)), who answers it.
    PlanReceived { by: SessionSender, request: PlanRequest },
    /// A request to set one of our parameters; the resulting value must be reported with
    /// [`Session::report_parameter`](super::Session::report_parameter).
    ParameterSetRequested {
        by: Address,
        /// Its index among the offered parameters.
        index: usize,
        /// May be NaN or infinite.
        value: f32,
    },
    /// A request to set one of our parameters with an unreadable type; the value must be reported as after a
    /// set request.
    ParameterUnsupported {
        by: Address,
        index: usize,
        /// MAV_PARAM_TYPE of the value.
        kind: u8,
    },
    /// A request to us alone for a parameter that we do not have; nothing is answered.
    ParameterUnknown {
        by: Address,
        /// The requested name or index, as received.
        requested: String,
    },
}

/// A message of a ground station about a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlanRequest {
    Message(PlanMessage),
    Item(MissionItem),
}

/// Shortest period, so that a zero in a configuration does not busy-loop.
pub(super) const MIN_PERIOD: TimeDelta = TimeDelta::from_millis(1);

/// The next time of a periodic action: in step with the last one, or from now on when whole periods were missed.
pub(super) fn next_period<C: Clock>(due: Timestamp<C>, period: TimeDelta, now: Timestamp<C>) -> Timestamp<C> {
    let next = due + period;
    if next > now { next } else { now + period }
}

/// The sender of a message on the session's link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SessionSender {
    pub address: Address,
    /// The peer of the link; `None` if the address is unique.
    pub peer: Option<PeerId>,
}

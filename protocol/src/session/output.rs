//! The outputs of a session, its senders, and the schedule of periodic actions.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, PeerId, TimeDelta, Timestamp};

use crate::message::{CommandLong, Heartbeat, Message};

/// What a [`Session`](super::Session) wants done or known.
#[derive(Clone, Debug, PartialEq)]
pub enum SessionOutput<C: Clock> {
    /// Send this from our own address.
    Send(Message),
    /// A peer was heard for the first time, or again after it was lost.
    PeerSeen {
        /// Who it is.
        peer: Address,
        /// Its heartbeat.
        heartbeat: Heartbeat,
    },
    /// A peer has fallen silent.
    PeerLost {
        /// Who it was.
        peer: Address,
        /// Time since it was last heard.
        silence: TimeDelta,
    },
    /// A time request of ours was answered.
    TimeExchanged {
        /// Who answered.
        peer: Address,
        /// When we asked.
        sent: Timestamp<C>,
        /// When the answer arrived.
        received: Timestamp<C>,
        /// The peer's clock in between, in nanoseconds.
        peer_nanos: i64,
    },
    /// A request to send a message at an interval; our acknowledgement is sent.
    IntervalRequested {
        /// Who asks.
        by: Address,
        /// The message's id.
        message_id: u32,
        /// The interval; `None` stops the message, zero asks for our default.
        interval: Option<TimeDelta>,
    },
    /// A command to us alone, or one to all of our system that we serve. The owner of the session reports with
    /// [`Session::acknowledge_command`](super::Session::acknowledge_command) its result;
    /// [`CommandResult::Unsupported`](crate::message::CommandResult::Unsupported) if no component accepts it.
    CommandReceived {
        /// Who commands.
        by: Address,
        /// The command, known to us or not; COMMAND_INT comes in this form, too.
        command: CommandLong,
    },
    /// A request to set one of our parameters; the resulting value must be reported with
    /// [`Session::report_parameter`](super::Session::report_parameter).
    ParameterSetRequested {
        /// Who asks.
        by: Address,
        /// Which of those that were offered.
        index: usize,
        /// The value, any bits.
        value: f32,
    },
    /// A request to set one of our parameters with an unreadable type; the value must be reported as after a
    /// set request.
    ParameterUnsupported {
        /// Who asks.
        by: Address,
        /// Which of those that were offered.
        index: usize,
        /// MAV_PARAM_TYPE of the value.
        kind: u8,
    },
    /// A request to us alone for a parameter that we do not have; nothing is answered.
    ParameterUnknown {
        /// Who asks.
        by: Address,
        /// The name or the index that was asked for, as it came.
        asked: String,
    },
}

/// Shortest period, so that a zero in a configuration does not busy-loop.
pub(super) const MIN_PERIOD: TimeDelta = TimeDelta::from_millis(1);

/// The next time of a periodic action: in step with the last one, or from now on when whole periods were missed.
pub(super) fn next_period<C: Clock>(due: Timestamp<C>, period: TimeDelta, now: Timestamp<C>) -> Timestamp<C> {
    let next = due + period;
    if next > now { next } else { now + period }
}

/// Who sent a message on the session's link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SessionSender {
    /// The address that the message names.
    pub address: Address,
    /// By which peer of the link it came; `None` if that says nothing.
    pub peer: Option<PeerId>,
}

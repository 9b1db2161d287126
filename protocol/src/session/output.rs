//! The outputs of a session.

use posebridge_telemetry::clock::Clock;
use posebridge_telemetry::{Address, TimeDelta, Timestamp};

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
        /// What it says of itself.
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
    /// Somebody asks us to send a message at an interval; it was told that we will.
    IntervalRequested {
        /// Who asks.
        by: Address,
        /// The message's id.
        message_id: u32,
        /// The interval; `None` stops the message, zero asks for our default.
        interval: Option<TimeDelta>,
    },
    /// Somebody commands us alone, or all of our system something that we serve. Whoever owns the session says with
    /// [`Session::acknowledge_command`](super::Session::acknowledge_command) what became of it; [`CommandResult::Unsupported`](crate::message::CommandResult::Unsupported) if nobody takes it.
    CommandReceived {
        /// Who commands.
        by: Address,
        /// The command, known to us or not; COMMAND_INT comes in this form, too.
        command: CommandLong,
    },
    /// Somebody wants one of our parameters to have another value; what stands afterwards must be told with
    /// [`Session::report_parameter`](super::Session::report_parameter).
    ParameterSetRequested {
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

//! Sessions between stations: ordered per direction, delayed, stalled by a pulled cable or a frozen process, ended by the lease.

use std::collections::BTreeSet;

use posebridge_fleet::{
    AnswerContent, OwnershipToken, QueryId, Reception, RobotName, StateAnswer, StateSnapshot, StationId,
};
use posebridge_telemetry::TimeDelta;

/// Virtual time, in microseconds.
pub(crate) type Micros = i64;

/// The longest delay of a message.
pub(crate) const MAX_DELAY: Micros = 50_000;
/// A process that ended is missed after this time.
pub(crate) const DEATH_DETECTION: Micros = 150_000;
/// One that cannot be reached is missed after this time.
pub(crate) const LEASE: Micros = 2_000_000;
/// A lost session is there again after this time at the earliest: its end is noticed before.
pub(crate) const MIN_RECONNECT: Micros = MAX_DELAY + 10_000;
/// The longest time until a lost session is there again.
pub(crate) const MAX_RECONNECT: Micros = 1_000_000;

/// What one station sends another.
#[derive(Clone, Debug)]
pub(crate) enum Message {
    /// The first one of a session.
    Hello(StationId),
    TokenAppeared(RobotName, OwnershipToken),
    TokenVanished(RobotName, OwnershipToken),
    /// All tokens of the sender were sent.
    AllListed,
    /// Asks for [`Message::Pong`], behind all tokens of the sender.
    Ping(u64),
    Pong(u64),
    Query(StationId, RobotName, QueryId, TimeDelta),
    Answer(StationId, RobotName, QueryId, StateAnswer),
    State(StationId, RobotName, Reception, StateSnapshot),
}

/// One direction of a session.
#[derive(Clone, Debug, Default)]
pub(crate) struct Direction {
    /// No message arrives before the last one.
    pub(crate) last_arrival: Micros,
    /// Messages that wait for the cable.
    pub(crate) stalled: Vec<Message>,
}

/// Two stations.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pair {
    /// Counts sessions; messages of an earlier one are lost.
    pub(crate) generation: u64,
    pub(crate) up_since: Option<Micros>,
    pub(crate) unreachable_since: Option<Micros>,
    pub(crate) reachable_since: Micros,
    pub(crate) directions: [Direction; 2],
    /// Tokens that each end was told of by the other, for the end of the session.
    pub(crate) listed: [BTreeSet<(RobotName, OwnershipToken)>; 2],
}

/// As a shell answers: it adds the state at a hand-over.
pub(crate) fn answer(content: AnswerContent, bytes: Vec<u8>) -> StateAnswer {
    match content {
        AnswerContent::Serving { epoch, heard_ago, silent_in } => StateAnswer::Serving { epoch, heard_ago, silent_in },
        AnswerContent::HandOver { epoch } => {
            StateAnswer::HandOver(StateSnapshot { epoch, age: TimeDelta::ZERO, bytes })
        }
        AnswerContent::Promised => StateAnswer::Promised,
        AnswerContent::NotOwner { owner, highest_epoch, state } => {
            StateAnswer::NotOwner { owner, highest_epoch, state }
        }
    }
}

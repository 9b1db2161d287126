//! What goes into the protocol and what comes out of it.

use std::fmt;

use posebridge_telemetry::TimeDelta;
use serde::{Deserialize, Serialize};

use crate::epoch::{Epoch, OwnershipToken};
use crate::event::OwnershipEvent;
use crate::names::{RobotName, StationId};

/// Numbers the queries of one station.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct QueryId(pub u64);

/// Whether a station hears a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reception {
    Heard,
    Silent,
}

/// The state of a robot's filter. The bytes are the engine's own.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StateSnapshot {
    /// Of the owner that took it.
    pub epoch: Epoch,
    /// How long before the input or output that holds it the state was taken; without the time on the wire. Clocks of different
    /// stations do not compare, so an age is passed on.
    pub age: TimeDelta,
    #[serde(with = "serde_bytes")]
    pub bytes: Vec<u8>,
}

impl fmt::Debug for StateSnapshot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { epoch, age, bytes } = self;
        write!(f, "StateSnapshot {{ epoch: {epoch}, age: {age:?}, {} bytes }}", bytes.len())
    }
}

/// Everything that a station learns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A message of the robot arrived on a link of this station.
    RobotHeard {
        robot: RobotName,
    },
    /// The last link closed on which the robot was heard here.
    RobotLinkClosed {
        robot: RobotName,
    },
    /// A token of another station; after a rejoin, of a token that was there already.
    TokenAppeared {
        robot: RobotName,
        token: OwnershipToken,
    },
    TokenVanished {
        robot: RobotName,
        token: OwnershipToken,
    },
    StationAppeared(StationId),
    StationVanished(StationId),
    /// Another station asks about a robot.
    StateQuery {
        from: StationId,
        robot: RobotName,
        id: QueryId,
        /// How long the other station has heard the robot without a break.
        heard_for: TimeDelta,
    },
    /// The answer of another station to [`Output::QueryState`].
    StateAnswer {
        from: StationId,
        robot: RobotName,
        id: QueryId,
        answer: StateAnswer,
    },
    /// Another owner published a state.
    StatePublished {
        from: StationId,
        robot: RobotName,
        reception: Reception,
        state: StateSnapshot,
    },
    /// At least one other station has answered since this was requested or since its session began, and all tokens of those that
    /// answered were given as inputs.
    FleetConfirmed,
    /// No other station is connected. That stations and tokens vanished is said by inputs of their own.
    FleetDisconnected,
    /// The program ends: everything is withdrawn, and nothing is claimed any more.
    Shutdown,
    /// Time passed; given when the deadline is reached.
    Tick,
}

/// A station's answer to a query.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StateAnswer {
    /// It owns the robot and hears it.
    Serving {
        epoch: Epoch,
        /// How long ago it heard the robot last.
        heard_ago: TimeDelta,
        /// After which time it will hand over if it hears nothing more.
        silent_in: TimeDelta,
    },
    /// It has owned the robot, does not hear it, and has stopped: the asker shall claim.
    HandOver(StateSnapshot),
    /// It has handed the robot over to somebody else a moment ago.
    Promised,
    /// It does not own the robot.
    NotOwner {
        /// The token that holds, of a third station: the asker may not be connected with that one yet.
        owner: Option<OwnershipToken>,
        /// The highest that it knows of, also of tokens that have vanished.
        highest_epoch: Option<Epoch>,
        /// The last state that it knows.
        state: Option<StateSnapshot>,
    },
}

/// What an answer is to contain: as [`StateAnswer`], where the shell adds the state at a hand-over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AnswerContent {
    Serving {
        epoch: Epoch,
        heard_ago: TimeDelta,
        silent_in: TimeDelta,
    },
    /// With the state of the robot's filter at this moment. A repeated question may get it twice.
    HandOver {
        epoch: Epoch,
    },
    Promised,
    NotOwner {
        owner: Option<OwnershipToken>,
        highest_epoch: Option<Epoch>,
        state: Option<StateSnapshot>,
    },
}

/// Whom a query is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum QueryTarget {
    Owner(StationId),
    /// Every connected station.
    Everyone,
}

/// With which state a robot is started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StartState {
    /// Nobody knows one.
    Cold,
    /// The one that this station had when it stopped; cold where it was not kept.
    Kept,
    /// That of an earlier owner.
    Received(StateSnapshot),
}

/// Everything that a station has to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    DeclareToken {
        robot: RobotName,
        epoch: Epoch,
    },
    WithdrawToken {
        robot: RobotName,
        epoch: Epoch,
    },
    QueryState {
        robot: RobotName,
        target: QueryTarget,
        id: QueryId,
        heard_for: TimeDelta,
    },
    AnswerState {
        to: StationId,
        robot: RobotName,
        id: QueryId,
        content: AnswerContent,
    },
    /// Publish the state of the robot's filter, with the reception.
    PublishState {
        robot: RobotName,
        epoch: Epoch,
        reception: Reception,
    },
    /// Ask the other stations for a sign of life, and list the tokens of those that give one as inputs; then give
    /// [`Input::FleetConfirmed`]. What the session remembers is no sign of life. Where none is connected give
    /// [`Input::FleetDisconnected`], and where none answers yet nothing.
    ConfirmFleet,
    /// Send the robot estimates of this epoch from now on.
    Start {
        robot: RobotName,
        epoch: Epoch,
        state: StartState,
    },
    /// Send no more estimates.
    Stop {
        robot: RobotName,
    },
    Event(OwnershipEvent),
}

/// What was refused of inputs, since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RefusalCounts {
    /// A robot or a token of one, because the table of robots is full.
    pub robots: u64,
    /// Another station, because their table is full.
    pub stations: u64,
    /// A token of a robot that has too many; the lowest is dropped.
    pub tokens: u64,
    /// Something in the name of this station.
    pub own_id: u64,
    /// An answer to no open query, or of another station than the one that was asked.
    pub answers: u64,
    /// A state of a station that has no token for it, or one that is too long.
    pub states: u64,
}

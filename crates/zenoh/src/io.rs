//! What goes into a session with a fleet and what comes out of it.

use posebridge_fleet::{Epoch, FleetKey, Input, QueryId, RobotName, StateQuestion, StateReply, StationId};
use zenoh::Wait as _;
use zenoh::query::Query;

/// Takes the answer to a command, or why there is none.
pub type AnswerReceiver = Box<dyn FnOnce(Result<Vec<u8>, String>) + Send + Sync>;

/// What a station says to its fleet. These are carried out in their order.
pub enum FleetCommand {
    DeclareToken {
        robot: RobotName,
        epoch: Epoch,
    },
    WithdrawToken {
        robot: RobotName,
        epoch: Epoch,
    },
    Ask {
        robot: RobotName,
        question: StateQuestion,
    },
    Answer {
        to: StationId,
        robot: RobotName,
        id: QueryId,
        reply: StateReply,
    },
    /// Expect estimates and states of a robot of another station.
    ExpectRobot(RobotName),
    /// Ask all stations for a sign of life.
    Confirm,
    /// Send a command of an operator to the robot's owner; gives the owner's answer, or why there is none.
    SendCommand {
        robot: RobotName,
        request: Vec<u8>,
        reply: AnswerReceiver,
    },
}

/// Bytes for everyone who listens; dropped while the network is too slow.
pub struct Publication {
    pub key: FleetKey,
    pub bytes: Vec<u8>,
}

/// What a station learns from its fleet.
pub enum FleetEvent {
    Ownership(Input),
    /// A camera's fix of a robot, from another station.
    Fix {
        key: FleetKey,
        bytes: Vec<u8>,
    },
    /// An operator's command from another station.
    Command {
        robot: RobotName,
        request: Vec<u8>,
        reply: CommandReply,
    },
}

/// Answers a command of another station. Without an answer the operator is told that there is none.
pub struct CommandReply(pub(crate) Query);

impl CommandReply {
    /// Sends the answer.
    pub fn send(self, answer: Vec<u8>) {
        let sent = self.0.reply(self.0.key_expr().clone(), answer).wait();
        if let Err(error) = sent {
            tracing::warn!(%error, "an answer to a command is not sent");
        }
    }
}

/// Since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SessionCounts {
    pub published: u64,
    /// Publications that the network or the session was too slow for.
    pub dropped: u64,
    /// Events that the station was too slow for.
    pub missed: u64,
    /// Messages that are none.
    pub invalid: u64,
}

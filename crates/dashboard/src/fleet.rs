//! The fleet of the station, for the page and the terminal view, and commands for robots that other stations own.

use std::fmt;
use std::sync::Arc;

use tokio::sync::oneshot;

use crate::model::FleetState;

/// The program's connection with the fleet. Clones share it.
#[derive(Clone)]
pub struct FleetSource {
    /// The fleet's name.
    pub name: String,
    /// What is known of it at present.
    pub state: Arc<dyn Fn() -> FleetState + Send + Sync>,
    /// Sends a command to the owner of a robot. Never blocks.
    pub send: Arc<dyn Fn(FleetRobotCommand) + Send + Sync>,
}

impl fmt::Debug for FleetSource {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "FleetSource({})", self.name)
    }
}

/// A command of an operator for a robot of the fleet.
#[derive(Debug)]
pub struct FleetRobotCommand {
    /// The robot's name in the fleet.
    pub robot: String,
    /// The command as a JSON object, without the robot.
    pub command: serde_json::Value,
    pub reply: FleetReply,
}

/// Tells the operator what became of a command. Dropped without an answer, it tells that there is none.
#[derive(Debug)]
pub struct FleetReply(oneshot::Sender<Result<(), String>>);

impl FleetReply {
    /// A reply and its receiver.
    pub fn pair() -> (Self, oneshot::Receiver<Result<(), String>>) {
        let (sender, receiver) = oneshot::channel();
        (Self(sender), receiver)
    }

    /// Whether the owner has accepted it, else why not.
    pub fn send(self, result: Result<(), String>) {
        // The operator may have left.
        drop(self.0.send(result));
    }
}

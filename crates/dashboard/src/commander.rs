//! Commands from this process, such as those of the terminal view.

use std::sync::Arc;

use posebridge_telemetry::{Command, Input, RobotId};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use crate::counters::{ServerCounter, ServerCounters};

/// Sends commands of this process to the station.
#[derive(Clone, Debug)]
pub struct CommandSubmitter {
    pub(crate) commands: mpsc::Sender<Input>,
    pub(crate) counts: Arc<ServerCounters>,
}

impl CommandSubmitter {
    /// Sends a command, for one robot or as one that names none, as the page's buttons do; false if too many wait or the station is ending. Never waits.
    pub fn send(&self, robot: Option<RobotId>, command: Command) -> bool {
        let input = robot.map_or(Input::Command(command), |robot| Input::RobotCommand { robot, command });
        match self.commands.try_send(input) {
            Ok(()) => {
                self.counts.increment(ServerCounter::Commands);
                true
            }
            Err(TrySendError::Full(_)) => {
                self.counts.increment(ServerCounter::CommandsFull);
                false
            }
            Err(TrySendError::Closed(_)) => false,
        }
    }
}

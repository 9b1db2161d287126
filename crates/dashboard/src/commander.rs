//! Commands of somebody in this process, such as the terminal view.

use std::sync::Arc;

use posebridge_telemetry::Command;
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use crate::counts::{Count, Counts};

/// Gives commands to the engine for somebody in this process.
#[derive(Clone, Debug)]
pub struct Commander {
    pub(crate) commands: mpsc::Sender<Command>,
    pub(crate) counts: Arc<Counts>,
}

impl Commander {
    /// Gives a command, as the page's buttons do; false if too many wait or the station is ending. Never waits.
    #[must_use]
    pub fn give(&self, command: Command) -> bool {
        match self.commands.try_send(command) {
            Ok(()) => {
                self.counts.one(Count::Commands);
                true
            }
            Err(TrySendError::Full(_)) => {
                self.counts.one(Count::CommandsFull);
                false
            }
            Err(TrySendError::Closed(_)) => false,
        }
    }
}

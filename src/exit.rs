//! How a command ends: at which stage it failed and with which exit code, or by a signal.

use anyhow::Result;

#[derive(Debug)]
pub enum Failure {
    /// It could not start: exit code 2.
    CouldNotStart(anyhow::Error),
    /// It ran and failed: exit code 1.
    Failed(anyhow::Error),
}

impl Failure {
    /// 1 ran and failed, 2 could not start.
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::CouldNotStart(_) => 2,
            Self::Failed(_) => 1,
        }
    }

    pub const fn error(&self) -> &anyhow::Error {
        match self {
            Self::CouldNotStart(error) | Self::Failed(error) => error,
        }
    }
}

pub trait ExitStage<T> {
    fn before_start(self) -> Result<T, Failure>;
    fn while_running(self) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> ExitStage<T> for Result<T, E> {
    fn before_start(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::CouldNotStart(error.into()))
    }
    fn while_running(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::Failed(error.into()))
    }
}

/// Ctrl-C and requests to terminate, listened for from the beginning: they must not get lost while links open.
pub(crate) struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

impl Signals {
    pub(crate) fn listen() -> Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    pub(crate) async fn received(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

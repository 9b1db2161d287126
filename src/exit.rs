//! Exit codes of commands and signal handling.

use anyhow::Result;

#[derive(Debug)]
pub enum Failure {
    /// Exit code 2.
    CouldNotStart(anyhow::Error),
    /// Exit code 1.
    Failed(anyhow::Error),
}

impl Failure {
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

/// Handlers of Ctrl-C and SIGTERM, installed at the start so that no signal is lost while links open.
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

//! How a command ends: at which stage it failed, and with which exit code.

/// Why a command did not end well, and at which stage.
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

    /// What went wrong.
    pub const fn error(&self) -> &anyhow::Error {
        match self {
            Self::CouldNotStart(error) | Self::Failed(error) => error,
        }
    }
}

/// Says at which stage something failed.
pub trait ExitStage<T> {
    /// It failed before anything ran.
    ///
    /// # Errors
    /// The error, as [`Failure::CouldNotStart`].
    fn before_start(self) -> Result<T, Failure>;
    /// It failed while running.
    ///
    /// # Errors
    /// The error, as [`Failure::Failed`].
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

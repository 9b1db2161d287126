//! One file per subcommand; each module's documentation is its manual.

pub mod calibrate;
pub mod completions;
pub mod config;
pub mod doctor;
pub mod export;
pub mod identify;
pub mod import;
pub mod init;
pub mod inspect;
pub mod key;
pub mod lab;
pub mod man;
pub mod play;
pub mod relay;
pub mod replay;
pub mod report;
pub mod run;
pub mod sim;
mod station_link;
pub mod tune;

use crate::cli::{Cli, Command};

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
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::CouldNotStart(_) => 2,
            Self::Failed(_) => 1,
        }
    }

    /// What went wrong.
    #[must_use]
    pub const fn error(&self) -> &anyhow::Error {
        match self {
            Self::CouldNotStart(error) | Self::Failed(error) => error,
        }
    }
}

/// Says at which stage something failed.
pub trait Stage<T> {
    /// It failed before anything ran.
    ///
    /// # Errors
    /// The error, as [`Failure::CouldNotStart`].
    fn at_start(self) -> Result<T, Failure>;
    /// It failed while running.
    ///
    /// # Errors
    /// The error, as [`Failure::Failed`].
    fn while_running(self) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> Stage<T> for Result<T, E> {
    fn at_start(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::CouldNotStart(error.into()))
    }
    fn while_running(self) -> Result<T, Failure> {
        self.map_err(|error| Failure::Failed(error.into()))
    }
}

/// Executes what the command line asks for; without a subcommand that is `run`.
///
/// # Errors
/// As the subcommand says.
pub fn execute(cli: Cli) -> Result<(), Failure> {
    match cli.command.unwrap_or(Command::Run(cli.run)) {
        Command::Run(args) => run::execute(&args),
        Command::Sim(args) => sim::execute(&args),
        Command::Play(args) => play::execute(&args),
        Command::Relay(args) => relay::execute(&args),
        Command::Replay(args) => replay::execute(&args),
        Command::Export(args) => export::execute(&args),
        Command::Import(args) => import::execute(&args),
        Command::Report(args) => report::execute(&args),
        Command::Inspect(args) => inspect::execute(&args),
        Command::Lab(args) => lab::execute(&args),
        Command::Calibrate(args) => calibrate::execute(&args),
        Command::Identify(args) => identify::execute(&args),
        Command::Tune(args) => tune::execute(&args),
        Command::Key(args) => key::execute(&args),
        Command::Doctor(args) => doctor::execute(&args),
        Command::Init(args) => init::execute(&args),
        Command::Config(args) => config::execute(&args),
        Command::Completions(args) => completions::execute(&args),
        Command::Man(args) => man::execute(&args),
    }
}

//! `posebridge completions`: a completion script for a shell, on stdout.

use clap::CommandFactory;

use super::Failure;
use crate::cli::{Cli, CompletionsArgs};

/// Prints the script.
///
/// # Errors
/// Never.
pub fn execute(args: &CompletionsArgs) -> Result<(), Failure> {
    clap_complete::generate(
        args.shell,
        &mut Cli::command(),
        "posebridge",
        &mut std::io::stdout(),
    );
    Ok(())
}

//! `posebridge completions`: a completion script for a shell, on stdout.

use clap::CommandFactory;

use super::{Failure, Stage};
use crate::cli::{Cli, CompletionsArgs};
use crate::stdout;

/// Prints the script.
///
/// # Errors
/// Standard output cannot be written.
pub fn execute(args: &CompletionsArgs) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "posebridge", &mut script);
    stdout::print(&String::from_utf8_lossy(&script)).while_running()
}

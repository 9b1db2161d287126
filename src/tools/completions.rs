//! `posebridge completions`: a completion script for a shell, on stdout.

use clap::{Args, Command};

use crate::console::print_result;
use crate::exit::{ExitStage, Failure};

/// Flags of `completions`.
#[derive(Args, Clone, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    pub shell: clap_complete::Shell,
}

/// `program` is the definition of the command line.
pub fn execute(args: &CompletionsArgs, mut program: Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "posebridge", &mut script);
    print_result(&String::from_utf8_lossy(&script)).while_running()
}

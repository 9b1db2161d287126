//! `posebridge key`: keys for signed links (docs/routing.md).

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};
use crate::station::signing::create_key;

/// Flags of `key`.
#[derive(Args, Clone, Debug)]
pub struct KeyArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: KeyAction,
}

/// What to do with keys.
#[derive(Clone, Debug, Subcommand)]
pub enum KeyAction {
    /// Create a key from random bytes of the operating system and print its name (docs/routing.md).
    New {
        /// File to write. An existing file is not overwritten.
        file: PathBuf,
    },
}

pub fn execute(args: &KeyArgs) -> Result<(), Failure> {
    let KeyAction::New { file } = &args.action;
    let key = create_key(file).before_start()?;
    print_line(&format!(
        "a new key stands in `{}`, for its owner alone (mode 0600); copy it to the other end of the link over a way that nobody reads",
        file.display()
    ));
    print_result(&format!("{}\n", key.name())).while_running()
}

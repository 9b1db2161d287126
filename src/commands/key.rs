//! `posebridge key`: keys for signed links (docs/signing.md).

use super::{Failure, Stage};
use crate::cli::{KeyAction, KeyArgs};
use crate::signing::create_key;
use crate::stderr::say;
use crate::stdout;

/// Makes a key and prints its name.
///
/// # Errors
/// The file is there already or cannot be written.
pub fn execute(args: &KeyArgs) -> Result<(), Failure> {
    let KeyAction::New { file } = &args.action;
    let key = create_key(file).at_start()?;
    say(&format!(
        "a new key stands in `{}`, for its owner alone (mode 0600); copy it to the other end of the link over a way that nobody reads",
        file.display()
    ));
    stdout::print(&format!("{}\n", key.name())).while_running()
}

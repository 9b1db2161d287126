//! `posebridge key`: keys for signed links (docs/routing.md).

use std::io::{self, BufRead, IsTerminal};
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, Subcommand};
use nix::sys::termios::{LocalFlags, SetArg, tcgetattr, tcsetattr};
use posebridge_protocol::signing::Key;

use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};
use crate::station::signing::{create_key, write_key};

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
    /// Create a key, from random bytes of the operating system or from a passphrase, and print its name (docs/routing.md).
    New {
        /// File to write. An existing file is not overwritten.
        file: PathBuf,
        /// Derive the key from a passphrase, as MAVProxy, Mission Planner and QGroundControl do. It is read from the terminal or from
        /// standard input, up to the end of the line.
        #[arg(long)]
        from_passphrase: bool,
    },
}

/// A line of standard input; a terminal does not show it.
fn read_passphrase() -> Result<String> {
    let input = io::stdin();
    let shown = input.is_terminal().then(|| tcgetattr(&input)).transpose().context("asking the terminal")?;
    if let Some(shown) = &shown {
        print_line("passphrase (it is not shown):");
        let mut hidden = shown.clone();
        hidden.local_flags.remove(LocalFlags::ECHO);
        tcsetattr(&input, SetArg::TCSAFLUSH, &hidden).context("hiding what is typed")?;
    }
    let mut line = String::new();
    let read = input.lock().read_line(&mut line);
    if let Some(shown) = &shown {
        tcsetattr(&input, SetArg::TCSAFLUSH, shown).context("showing again what is typed")?;
    }
    read.context("reading the passphrase")?;
    let passphrase = line.trim_end_matches(['\r', '\n']);
    ensure!(!passphrase.is_empty(), "the passphrase is empty");
    Ok(passphrase.to_owned())
}

pub fn execute(args: &KeyArgs) -> Result<(), Failure> {
    let KeyAction::New { file, from_passphrase } = &args.action;
    let key = if *from_passphrase {
        let passphrase = read_passphrase().before_start()?;
        let key = Key::from_passphrase(&passphrase);
        write_key(file, &key).before_start()?;
        key
    } else {
        create_key(file).before_start()?
    };
    print_line(&format!(
        "a new key stands in `{}`, for its owner alone (mode 0600); copy it to the other end of the link over a way that nobody reads",
        file.display()
    ));
    print_result(&format!("{}\n", key.name())).while_running()
}

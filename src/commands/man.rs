//! `posebridge man`: manual pages, made from the definition of the command line.

use std::path::Path;

use anyhow::{Context, Result};
use clap::{Command, CommandFactory};
use clap_mangen::Man;

use super::{Failure, Stage};
use crate::cli::{Cli, ManArgs};
use crate::stderr::say;
use crate::stdout;

/// A page: the name of its file and its text in roff.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Page {
    /// `posebridge-run.1`.
    pub file: String,
    /// The text.
    pub roff: String,
}

/// Prints the program's page, or writes all pages into a folder.
///
/// # Errors
/// A page cannot be written.
pub fn execute(args: &ManArgs) -> Result<(), Failure> {
    let pages = pages().while_running()?;
    let Some(folder) = &args.out else {
        let first = pages.first().map_or("", |page| &page.roff);
        return stdout::print(first).while_running();
    };
    write(folder, &pages).at_start()?;
    say(&format!(
        "{} pages in `{}`; read one with: man -l {}",
        pages.len(),
        folder.display(),
        folder.join("posebridge.1").display()
    ));
    Ok(())
}

fn write(folder: &Path, pages: &[Page]) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder `{}`", folder.display()))?;
    for page in pages {
        let path = folder.join(&page.file);
        std::fs::write(&path, &page.roff).with_context(|| format!("cannot write `{}`", path.display()))?;
    }
    Ok(())
}

/// The page of the program, then one of each subcommand, however deep.
///
/// # Errors
/// A page cannot be made, which would be a fault of ours.
pub fn pages() -> Result<Vec<Page>> {
    // `posebridge help` shows what the pages say.
    let mut program = Cli::command().disable_help_subcommand(true);
    program.build();
    let mut pages = Vec::new();
    add(&program, &mut pages)?;
    Ok(pages)
}

fn add(command: &Command, pages: &mut Vec<Page>) -> Result<()> {
    // Of `posebridge run` that is posebridge-run.
    let name = command.get_display_name().unwrap_or(command.get_name());
    let mut roff = Vec::new();
    Man::new(command.clone()).render(&mut roff)?;
    pages.push(Page { file: format!("{name}.1"), roff: String::from_utf8(roff).context(name.to_owned())? });
    for subcommand in command.get_subcommands() {
        add(subcommand, pages)?;
    }
    Ok(())
}

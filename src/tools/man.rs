//! `posebridge man` and `posebridge completions`: manual pages and scripts for shells, from the definition of the command line.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::builder::PossibleValuesParser;
use clap::{Arg, Args, Command, Id};
use clap_mangen::Man;
use posebridge_protocol::bricks::BRICK_PROTOCOLS;
use posebridge_sim::impairment::PROFILES;

use crate::config::ROBOTS;
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// Flags of `man`.
#[derive(Args, Clone, Debug)]
pub struct ManArgs {
    /// Write the pages of the program and of every command into this folder instead of printing the program's page.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Flags of `completions`.
#[derive(Args, Clone, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    pub shell: clap_complete::Shell,
}

/// Values that a shell offers for an argument, in whichever command it stands. The program itself takes others as well, such as files.
const OFFERED_VALUES: &[(&str, ListValues)] = &[
    ("filter", filters),
    ("filters", filters),
    ("compare", filters),
    ("estimators", filters),
    ("brick", || BRICK_PROTOCOLS.iter().map(|protocol| protocol.name).collect()),
    ("impair", impairments),
    ("profile", impairments),
    ("profiles", impairments),
    ("scenario", || posebridge_sim::BUNDLED.iter().map(|(name, _)| *name).collect()),
    ("scenarios", || posebridge_sim::montecarlo::SCENARIOS.iter().map(|(name, _)| *name).collect()),
];

type ListValues = fn() -> Vec<&'static str>;

/// The same for the positional argument of `init`.
const ROBOT_OF_INIT: &str = "robot";

fn filters() -> Vec<&'static str> {
    posebridge_estimator::FILTERS.iter().map(|entry| entry.name).collect()
}

fn impairments() -> Vec<&'static str> {
    PROFILES.iter().map(|(name, _)| *name).collect()
}

fn offer_values(command: Command) -> Command {
    let is_init = command.get_name() == "init";
    let ids: Vec<(Id, bool)> = command.get_arguments().map(|arg| (arg.get_id().clone(), is_a_name(arg))).collect();
    let mut command = command;
    for (id, is_a_name) in ids {
        let listed = OFFERED_VALUES.iter().find(|(name, _)| id == *name).map(|(_, values)| values());
        let robots = || ROBOTS.iter().map(|robot| robot.name).collect();
        let values = listed.or_else(|| (is_init && id == ROBOT_OF_INIT).then(robots));
        if let Some(values) = values.filter(|_| is_a_name) {
            command = command.mut_arg(id, |arg| arg.value_parser(PossibleValuesParser::new(values)));
        }
    }
    command.mut_subcommands(offer_values)
}

/// Not a file, and not one of values that are listed already.
fn is_a_name(arg: &Arg) -> bool {
    arg.get_value_parser().type_id() == std::any::TypeId::of::<String>()
}

pub fn print_completions(args: &CompletionsArgs, program: Command) -> Result<(), Failure> {
    let mut program = offer_values(program);
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "posebridge", &mut script);
    print_result(&String::from_utf8_lossy(&script)).while_running()
}

/// File name and roff text of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ManPage {
    /// Such as `posebridge-run.1`.
    pub file: String,
    pub roff: String,
}

/// Prints the page of the program, or writes all pages into a folder.
pub fn execute(args: &ManArgs, program: Command) -> Result<(), Failure> {
    let pages = pages(program).while_running()?;
    let Some(folder) = &args.out else {
        let first = pages.first().map_or("", |page| &page.roff);
        return print_result(first).while_running();
    };
    write(folder, &pages).before_start()?;
    print_line(&format!(
        "{} pages in `{}`; read one with: man -l {}",
        pages.len(),
        folder.display(),
        folder.join("posebridge.1").display()
    ));
    Ok(())
}

fn write(folder: &Path, pages: &[ManPage]) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder `{}`", folder.display()))?;
    for page in pages {
        let path = folder.join(&page.file);
        std::fs::write(&path, &page.roff).with_context(|| format!("cannot write `{}`", path.display()))?;
    }
    Ok(())
}

/// The page of a program, then one for each subcommand, recursively.
pub fn pages(program: Command) -> Result<Vec<ManPage>> {
    // `posebridge help` shows the same text.
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let mut pages = Vec::new();
    add(&program, &mut pages)?;
    Ok(pages)
}

fn add(command: &Command, pages: &mut Vec<ManPage>) -> Result<()> {
    // Of `posebridge run` that is posebridge-run.
    let name = command.get_display_name().unwrap_or(command.get_name());
    let mut roff = Vec::new();
    Man::new(command.clone()).render(&mut roff)?;
    pages.push(ManPage { file: format!("{name}.1"), roff: String::from_utf8(roff).context(name.to_owned())? });
    for subcommand in command.get_subcommands() {
        add(subcommand, pages)?;
    }
    Ok(())
}

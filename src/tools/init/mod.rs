//! `posebridge init`: writes a commented configuration for a robot.
//!
//! The file is `config/default.toml` with the robot's own file laid into it ([`template`]). It is loaded as any configuration is before it is
//! written, so that what stands there runs. Nothing is opened or changed but that file.

mod choose;
mod guess;

use std::fs::OpenOptions;
use std::io::{ErrorKind, IsTerminal, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::Args;

use super::doctor::SystemRoots;
use crate::config::{self, BundledRobot, Config, TemplateLink, list_of_robots, template};
use crate::console::{print_line, print_result};
use crate::exit::{ExitStage, Failure};

/// Flags of `init`.
#[derive(Args, Clone, Debug)]
pub struct InitArgs {
    /// The robot that yours is most like; without a name you are asked.
    pub robot: Option<String>,
    /// Call the robot on this link, e.g. serial:///dev/ttyUSB0?baud=115200, instead of guessing from the ports that are there.
    #[arg(long, value_name = "URL", conflicts_with = "listen")]
    pub link: Option<String>,
    /// Wait for the robot on this link, e.g. udp://0.0.0.0:14550.
    #[arg(long, value_name = "URL")]
    pub listen: Option<String>,
    /// Where to write the configuration; - prints it.
    #[arg(long, value_name = "FILE", default_value = "posebridge.toml")]
    pub out: PathBuf,
    /// Write over a file that is there already.
    #[arg(long)]
    pub force: bool,
}

/// The robots, from the table.
pub fn robots_help() -> String {
    format!("Robots:\n{}", list_of_robots())
}

/// The name that stands for standard output.
const STDOUT: &str = "-";

/// Writes the file and says how to run it.
///
/// # Errors
/// No robot was named, the link makes no sense, or the file is there already or cannot be written.
pub fn execute(args: &InitArgs) -> Result<(), Failure> {
    let robot = robot(args).before_start()?;
    let link = link(args, robot).before_start()?;
    let is_stdout = args.out.as_os_str() == STDOUT;
    let file = if is_stdout { "FILE".to_owned() } else { args.out.display().to_string() };
    let text = template(robot, &link, &file);
    check(&text).before_start()?;
    if is_stdout {
        return print_result(&text).while_running();
    }
    write(args, &text).before_start()?;
    print_line(&format!(
        "wrote `{file}`: {}, at {} ({})\nrun it with: posebridge run --config {file}",
        robot.name, link.url, link.origin
    ));
    Ok(())
}

fn robot(args: &InitArgs) -> Result<BundledRobot> {
    if let Some(name) = &args.robot {
        return Ok(BundledRobot::from_name(name)?);
    }
    let (stdin, mut stderr) = (std::io::stdin(), std::io::stderr());
    if stdin.is_terminal() && stderr.is_terminal() {
        return choose::prompt(&mut stdin.lock(), &mut stderr);
    }
    bail!(
        "name the robot that yours is most like, for example `posebridge init nxt-56mm`; there are:\n{}",
        list_of_robots()
    )
}

fn link(args: &InitArgs, robot: BundledRobot) -> Result<TemplateLink> {
    let given = |url: &str, is_listening| TemplateLink {
        url: url.to_owned(),
        is_listening,
        origin: "as given to `posebridge init`".to_owned(),
        notes: Vec::new(),
    };
    if let Some(url) = &args.link {
        return Ok(given(url, false));
    }
    if let Some(url) = &args.listen {
        return Ok(given(url, true));
    }
    let own: Config = toml::from_str(robot.text).context(robot.name)?;
    let usual = own.links.first().ok_or_else(|| anyhow!("config/robots/{}.toml names no link", robot.name))?;
    Ok(guess::guess(usual, &SystemRoots::host()))
}

/// What is written is a configuration that can run: its own loader says so.
fn check(text: &str) -> Result<()> {
    let loaded = config::load_text("of posebridge init", text, &[])?;
    loaded.config.targets()?;
    loaded.config.station_config()?;
    loaded.config.dashboard.checked()?;
    Ok(())
}

/// Writes a new file, or over one if that is asked for; what stands there is never lost by a disk that is full.
fn write(args: &InitArgs, text: &str) -> Result<()> {
    let path = &args.out;
    let name = path.display();
    if args.force && path.exists() {
        ensure!(path.is_file(), "`{name}` is no file");
        return replace(path, text).with_context(|| format!("cannot write `{name}`"));
    }
    let mut file = match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            bail!("`{name}` is there already: name another file with --out, or write over it with --force")
        }
        Err(error) => return Err(error).with_context(|| format!("cannot write `{name}`")),
    };
    let written = file.write_all(text.as_bytes());
    if written.is_err() {
        // Half a configuration is none.
        drop(std::fs::remove_file(path));
    }
    written.with_context(|| format!("cannot write `{name}`"))
}

fn replace(path: &Path, text: &str) -> Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    std::fs::write(&beside, text)?;
    std::fs::rename(&beside, path)?;
    Ok(())
}

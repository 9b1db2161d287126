//! Flags of `init` and `man`: what makes files for a new computer.

use std::path::PathBuf;

use clap::Args;

use crate::config::list_of_robots;

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

/// Flags of `man`.
#[derive(Args, Clone, Debug)]
pub struct ManArgs {
    /// Write the pages of the program and of every subcommand into this folder, instead of printing the program's.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// The robots, from the table.
pub(super) fn robots_help() -> String {
    format!("Robots:\n{}", list_of_robots())
}

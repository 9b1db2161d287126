//! `posebridge import`: a telemetry log or a run of a descriptor as a recording of ours.

use std::fs::File;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;

use super::recording::{self, StationOptions};
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;

/// Flags of `import`.
#[derive(Args, Clone, Debug)]
pub struct ImportArgs {
    /// A telemetry log (*.tlog, *.tlog.gz) or a recording's descriptor (*.toml).
    pub file: PathBuf,
    /// Where to write the recording; a file that is there already is not touched.
    #[arg(long, value_name = "FILE.mcap")]
    pub out: PathBuf,
    /// What to read of a descriptor's data. For a telemetry log --set takes keys of the station's configuration.
    #[command(flatten)]
    pub data: DataFlags,
    /// The station's configuration for a telemetry log: its address, robot, filter; without it the default one.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// The robot of a telemetry log: a robot profile or a recording's descriptor.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
}

/// Imports.
///
/// # Errors
/// The file cannot be read or makes no sense, or the recording cannot be written.
pub fn execute(args: &ImportArgs) -> Result<(), Failure> {
    let out = create(args).before_start()?;
    let station =
        StationOptions { config: args.config.as_deref(), robot: args.robot.as_deref(), settings: &args.data.settings };
    let imported = recording::import(&args.file, &args.data, station, out);
    if imported.is_err() {
        // Half a recording would be taken for a whole one.
        drop(std::fs::remove_file(&args.out));
    }
    let (_, account) = imported.while_running()?;
    for note in &account.notes {
        print_line(note);
    }
    print_line(&format!("wrote `{}`: {} inputs", args.out.display(), account.inputs));
    Ok(())
}

fn create(args: &ImportArgs) -> Result<File> {
    // What cannot be read is reported before an empty file is made.
    drop(crate::station::input_file::InputFile::open(&args.file)?);
    File::create_new(&args.out).with_context(|| format!("creating `{}`", args.out.display()))
}

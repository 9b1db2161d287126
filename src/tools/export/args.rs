//! Flags of `export`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::flags::DataFlags;
use crate::tools::import::StationOptions;

/// Flags of `export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// A recording (*.mcap), a telemetry log (*.tlog, *.tlog.gz) or a recording's descriptor (*.toml).
    pub recording: PathBuf,
    /// What to write; several with commas.
    #[arg(long = "format", value_enum, value_delimiter = ',', required = true)]
    pub formats: Vec<Format>,
    /// The folder for the files; it is made.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Estimator, instead of the recording's.
    #[arg(long, value_name = "NAME")]
    pub filter: Option<String>,
    /// Another robot for a recording or a telemetry log; --set goes over it.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
    /// Truth written by `posebridge sim --truth`, instead of the one that a recording of ours may hold.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// A key of a link that was signed, instead of the file that held it when it was recorded; may be repeated.
    #[arg(long = "key", value_name = "FILE")]
    pub keys: Vec<PathBuf>,
}

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// A wide file per stream: estimates, innovations, observations, links.
    Csv,
    /// Trajectories of truth and estimate at the same stamps, for evo.
    Tum,
    /// A telemetry log: what came and what the engine sends.
    Tlog,
    /// A recording of ours.
    Mcap,
}

/// The station that a telemetry log is read with.
pub(super) fn station(args: &ExportArgs) -> StationOptions<'_> {
    StationOptions { config: None, robot: args.robot.as_deref(), settings: &args.data.settings }
}

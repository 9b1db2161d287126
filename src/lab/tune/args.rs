//! The flags of `posebridge tune`.

use std::path::PathBuf;

use crate::config::Setting;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `tune`.
#[derive(clap::Args, Clone, Debug)]
pub struct TuneArgs {
    /// Descriptor (config/recordings/*.toml), or recording (*.mcap), which is one run named after its file. Can be repeated.
    #[arg(long = "recording", value_name = "FILE", required_unless_present = "sim")]
    pub recordings: Vec<PathBuf>,
    /// Tune on the runs whose names begin with this text. Can be repeated. Default: the usual runs of the descriptor.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Vec<String>,
    /// Held-out runs, by the beginning of their names. If the tuned parameters are worse on them, the initial ones are kept. Can
    /// be repeated.
    #[arg(long = "hold-out", value_name = "PREFIX")]
    pub hold_out: Vec<String>,
    /// Folder for the relative paths of a descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Give the filter every n-th fix and score it on the others. Default: as in the descriptor.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot or one parameter of the filter before tuning, as in `replay`, or one key of the configuration of
    /// a posebridge recording. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
    /// For recordings without fixes: give the filter a position from the ground truth at this interval, in seconds, with the
    /// noise noise.fix_position_m.
    #[arg(long, value_name = "SECONDS", group = "drawn")]
    pub fixes_from_truth: Option<f64>,
    /// Tune on simulated drives instead: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", group = "drawn", conflicts_with_all = ["recordings", "run", "hold_out", "use_every", "settings"])]
    pub sim: Option<String>,
    /// Number of simulated drives to tune on. The same number is held out.
    #[arg(long, value_name = "N", default_value_t = 4, conflicts_with = "recordings", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Parameter to tune: a key of [robot.noise], or filter.KEY. Can be repeated. Default: all parameters that the data
    /// determine.
    #[arg(long = "param", value_name = "KEY")]
    pub params: Vec<String>,
    /// The filter.
    #[arg(long, value_name = "NAME", default_value = "pose")]
    pub filter: String,
    /// Start with the parameters wrong by this factor, as an exercise.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub start_factor: f64,
    /// Seed of the simulated drives and of the noise of fixes from the ground truth.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drawn")]
    pub seed: u64,
    /// Write a robot profile with the tuned noise, for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub out_profile: Option<PathBuf>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

//! Flags of `tune`.

use std::path::PathBuf;

use crate::config::Setting;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `tune`.
#[derive(clap::Args, Clone, Debug)]
pub struct TuneArgs {
    /// A recording's descriptor (config/recordings/*.toml) or a recording (*.mcap), which is one run by the name of its file; may be
    /// repeated.
    #[arg(long = "recording", value_name = "FILE", required_unless_present = "sim")]
    pub recordings: Vec<PathBuf>,
    /// Runs to tune on: all whose names begin so; may be repeated. Without it the descriptor's usual ones.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Vec<String>,
    /// Runs that are only scored, before and after; if the tuned numbers are worse on them, those to start from are kept. May be
    /// repeated.
    #[arg(long = "hold-out", value_name = "PREFIX")]
    pub hold_out: Vec<String>,
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Use every n-th fix and score on the rest, instead of what the descriptor says.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot's table or a tunable of the filter before tuning, as for `replay`, or of the configuration of a
    /// recording of ours; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
    /// Give the filter a position from the truth every this many seconds, with the noise of noise.fix_position_m: for recordings
    /// without fixes.
    #[arg(long, value_name = "SECONDS", group = "drawn")]
    pub fixes_from_truth: Option<f64>,
    /// Tune on simulated drives instead: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", group = "drawn", conflicts_with_all = ["recordings", "run", "hold_out", "use_every", "settings"])]
    pub sim: Option<String>,
    /// Simulated drives to tune on; as many more are held out.
    #[arg(long, value_name = "N", default_value_t = 4, conflicts_with = "recordings", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// A parameter to tune: a key of [robot.noise], or filter.KEY; may be repeated. Without it, all parameters that the data determine.
    #[arg(long = "param", value_name = "KEY")]
    pub params: Vec<String>,
    /// The filter.
    #[arg(long, value_name = "NAME", default_value = "pose")]
    pub filter: String,
    /// Start with the tuned parameters too large by this factor: an exercise.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub start_factor: f64,
    /// Seed of simulated drives and of the noise of fixes from the truth.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drawn")]
    pub seed: u64,
    /// Write the robot with the tuned noise as a profile for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub out_profile: Option<PathBuf>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

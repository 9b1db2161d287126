//! Flags of `lab thermometer`.

use std::path::PathBuf;

use clap::Args;

use crate::config::Setting;
use crate::lab::experiments::live::LiveArgs;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `lab thermometer`.
#[derive(Args, Clone, Debug)]
#[command(group = clap::ArgGroup::new("real").multiple(true).args(["recordings", "link", "listen"]))]
pub struct LabThermometerArgs {
    /// A descriptor (config/recordings/*.toml) with temperatures, or recordings of ours (*.mcap; each of their thermometers is a run),
    /// instead of the simulated sensor.
    #[arg(long = "recording", value_name = "FILE", num_args = 1..)]
    pub recordings: Vec<PathBuf>,
    /// A live robot, whose step the recordings foretell.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Where the descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Runs to identify the sensor on; without it all.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "real")]
    pub identify: Vec<String>,
    /// Runs to predict, each by the identified ones without itself; without it all.
    #[arg(long, value_name = "RUN", num_args = 1.., requires = "real")]
    pub predict: Vec<String>,
    /// The runs are of one sensor in the same surroundings: a step the same way has the very same dynamics.
    #[arg(long, requires = "real")]
    pub same_sensor: bool,
    /// Set one key of a descriptor's robot, or of the configuration of a recording or a live robot, e.g.
    /// robot.noise.temperature_k=0.05; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real")]
    pub settings: Vec<Setting>,
    /// Runs over which the bounds of the simulated sensor are counted.
    #[arg(long, value_name = "N", default_value_t = 1_000, conflicts_with = "real", value_parser = clap::value_parser!(u32).range(10..=100_000))]
    pub runs: u32,
    /// Seed of the simulated sensor.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real")]
    pub seed: u64,
    /// What it leaves behind.
    #[command(flatten)]
    pub output: OutputArgs,
}

impl LabThermometerArgs {
    pub(super) fn is_real(&self) -> bool {
        !self.recordings.is_empty() || self.live.is_requested()
    }
}

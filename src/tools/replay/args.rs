//! Flags of `replay`.

use std::path::PathBuf;

use clap::Args;

use crate::flags::{SessionFlags, positive};

/// Flags of `replay`.
#[derive(Args, Clone, Debug)]
pub struct ReplayArgs {
    /// What to replay.
    #[command(flatten)]
    pub session: SessionFlags,
    /// Estimators to run, side by side; may be repeated.
    #[arg(long = "filter", visible_alias = "estimator", value_name = "NAME")]
    pub filters: Vec<String>,
    /// Replay as fast as it was recorded (1), or faster by this factor; without it as fast as possible.
    #[arg(long, value_name = "FACTOR", value_parser = positive)]
    pub speed: Option<f64>,
    /// Write every event as a line of text.
    #[arg(long, value_name = "FILE")]
    pub events: Option<PathBuf>,
    /// Write the robot with what the last estimator that learns has learned about it, as a profile for `run --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub save_calibration: Option<PathBuf>,
    /// Find the most likely path of each run as well, from its wheels, gyro and fixes; takes time on long runs.
    #[arg(long, conflicts_with_all = ["from", "to"])]
    pub smooth: bool,
    /// Write the picture here: of the last run and the last estimator.
    #[arg(long, value_name = "FILE.svg")]
    pub figure: Option<PathBuf>,
    /// Print one JSON object (docs/reports.md) instead of tables.
    #[arg(long)]
    pub json: bool,
}

//! Flags of `run`.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;

use super::link_flags::LinkFlags;
use crate::config::PLOTJUGGLER_ADDRESS;
use crate::flags::{ConfigFlags, DashboardFlags, positive};

/// Flags of `run`.
#[derive(Args, Clone, Debug, Default)]
pub struct RunArgs {
    /// Configuration.
    #[command(flatten)]
    pub config: ConfigFlags,
    /// Links, in their order.
    #[command(flatten)]
    pub links: LinkFlags,
    /// Show robot and estimator to ground stations on this link, e.g. udp://127.0.0.1:14550 or tcp://127.0.0.1:5760; may be repeated,
    /// beside the other links (docs/ground-stations.md).
    #[arg(long = "gcs", value_name = "URL")]
    pub ground_stations: Vec<String>,
    /// What the brick of the first link speaks: mavlink, or a protocol of its own (docs/protocols/mavlink.md).
    #[arg(long, value_name = "PROTOCOL")]
    pub brick: Option<String>,
    /// Take the robot from this file's `[robot]` table: a robot profile or a recording's descriptor.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// Filter to use; see `posebridge config schema`.
    #[arg(long, value_name = "NAME")]
    pub filter: Option<String>,
    /// Seed of the simulated brick, instead of its scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Start this number of simulated bricks instead of one, side by side, each with wheels and a seed of its own; they call the
    /// station on one UDP port.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=250))]
    pub robots: Option<u8>,
    /// End when the simulated brick has driven its path so often; without it the brick drives on until Ctrl-C.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub laps: Option<u32>,
    /// Folder for recording and pictures, instead of one named after the time.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Do not record.
    #[arg(long)]
    pub no_record: bool,
    /// Write a telemetry log (.tlog) beside the recording, for other ground stations.
    #[arg(long, conflicts_with = "no_record")]
    pub tlog: bool,
    /// Write every event as a line of text.
    #[arg(long, value_name = "FILE")]
    pub events: Option<PathBuf>,
    /// The dashboard.
    #[command(flatten)]
    pub page: DashboardFlags,
    /// What is shown besides.
    #[command(flatten)]
    pub views: ViewFlags,
    /// At the end write the robot with what was learned about it, as a profile for --robot.
    #[arg(long, value_name = "FILE.toml")]
    pub save_calibration: Option<PathBuf>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub duration: Option<f64>,
    /// End when no link has brought a byte for this many seconds, once one has.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub until_silent: Option<f64>,
}

/// What is shown besides the page.
#[derive(Args, Clone, Debug, Default)]
pub struct ViewFlags {
    /// Show map, pose, innovations, links and events in this terminal (docs/dashboard.md); q ends the run, ? explains the other keys.
    #[arg(long)]
    pub tui: bool,
    /// Send what happens as JSON to PlotJuggler's UDP server there, by default 127.0.0.1:9870 (docs/dashboard.md).
    #[arg(
        long,
        value_name = "IP:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = PLOTJUGGLER_ADDRESS
    )]
    pub plotjuggler: Option<SocketAddr>,
}

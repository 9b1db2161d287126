//! Flags that several commands share, and the values that flags take.

use std::net::SocketAddr;
use std::path::PathBuf;

use clap::Args;
use posebridge_estimator::params::ParamError;
use posebridge_estimator::{PARAMS, Params};

use crate::config::Setting;

/// Flags that change the configuration.
#[derive(Args, Clone, Debug, Default)]
pub struct ConfigFlags {
    /// Configuration file; without it the embedded default (`posebridge config print`).
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Set one key of the configuration, e.g. robot.track_width_m=0.112; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
}

/// Flags that choose what to read of a recording of a real robot.
#[derive(Args, Clone, Debug)]
pub struct DataFlags {
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Which runs of a descriptor: all whose names begin so.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Option<String>,
    /// Use every n-th fix and score on the rest, instead of what the descriptor says; 0 uses none.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot's table, e.g. track_width_m=0.155 or noise.fix_position_m=0.02, or a tunable of the filter, e.g.
    /// filter.gate_prob=0.99; may be repeated. For a recording of ours: a key of its configuration.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
}

/// Which recording goes through the engine, which part of it counts, and what is changed.
#[derive(Args, Clone, Debug)]
pub struct SessionFlags {
    /// A recording (*.mcap), a telemetry log (*.tlog) or a recording's descriptor (*.toml).
    pub recording: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Lay the `[robot]` and `[filter]` of this profile over those of the recording; --set goes over both.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
    /// Set one tunable of the filter, e.g. gate_prob=0.99, over everything else; may be repeated.
    #[arg(long = "param", value_name = "KEY=VALUE", value_parser = a_param)]
    pub params: Vec<Setting>,
    /// Truth written by `posebridge sim --truth`, instead of what the recording itself holds.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// A key of a link that was signed, instead of the file that held it when it was recorded; may be repeated.
    #[arg(long = "key", value_name = "FILE")]
    pub keys: Vec<PathBuf>,
    /// Count from this number of seconds after the beginning; the filter is given all that came before, too.
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub from: Option<f64>,
    /// End this number of seconds after the beginning; nothing later is given to the filter.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub to: Option<f64>,
}

/// The one link of a brick to its station.
#[derive(Args, Clone, Debug)]
#[group(required = true, multiple = false)]
pub struct StationLink {
    /// Wait for the station on this link, e.g. pty:brick.tty or tcp://127.0.0.1:5760.
    #[arg(long, value_name = "URL")]
    pub listen: Option<String>,
    /// Call the station on this link, e.g. udp://127.0.0.1:14550.
    #[arg(long, value_name = "URL")]
    pub link: Option<String>,
}

/// Whether there is a page, and where (docs/dashboard.md).
#[derive(Args, Clone, Debug, Default)]
pub struct DashboardFlags {
    /// Serve the dashboard there, e.g. 0.0.0.0:4680 for other computers, which open one of the addresses that are printed, with
    /// their token; port 0 takes a free one.
    #[arg(long, value_name = "IP:PORT", conflicts_with = "no_dashboard")]
    pub dashboard: Option<SocketAddr>,
    /// Serve no dashboard.
    #[arg(long)]
    pub no_dashboard: bool,
    /// Open the dashboard in a browser.
    #[arg(long, conflicts_with = "no_dashboard")]
    pub open: bool,
    /// Serve the page's files from this folder instead of from the program: for editing them.
    #[arg(long, value_name = "DIR", conflicts_with = "no_dashboard")]
    pub ui_dir: Option<PathBuf>,
}

/// A number of more than zero.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number),
        _ => Err("must be a number of more than zero".to_owned()),
    }
}

/// A number of zero or more.
fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(number) if number.is_finite() && number >= 0.0 => Ok(number),
        _ => Err("must be a number of zero or more".to_owned()),
    }
}

/// `KEY=VALUE` of a tunable of the filters, as a setting of the configuration.
fn a_param(text: &str) -> Result<Setting, String> {
    let setting = Setting::parse(text)?;
    let (key, value) = (setting.path.join("."), setting.value.to_string());
    let value: f64 = value.parse().map_err(|_not_a_number| format!("`{key}`: `{value}` is no number"))?;
    Params::default().set(&key, value).map_err(|error| {
        let known: Vec<&str> = PARAMS.iter().map(|param| param.key).collect();
        if matches!(error, ParamError::Unknown { .. }) {
            format!("{error}; there are: {}", known.join(", "))
        } else {
            error.to_string()
        }
    })?;
    Ok(Setting { path: vec!["filter".to_owned(), key], value: toml::Value::Float(value) })
}

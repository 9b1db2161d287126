//! Every flag of the program, and nothing else.

mod dashboard;
mod init;
mod lab;
mod views;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use posebridge_estimator::params::ParamError;
use posebridge_estimator::{PARAMS, Params};
use posebridge_link::TRANSPORTS;
use posebridge_sim::impairment::PROFILES;

use crate::commands::relay::RelayEnds;
use crate::config::Setting;
use crate::link_flags::LinkFlags;

pub use dashboard::DashboardFlags;
pub use init::{InitArgs, ManArgs};
pub use lab::{LabAccuracyArgs, LabArgs, LabExperiment, LabLinksArgs};
pub use views::ViewFlags;

/// Ground station for robots that are too weak to filter for themselves.
///
/// Without a subcommand it runs the station with a simulated brick on a pseudo-terminal.
#[derive(Debug, Parser)]
#[command(
    name = "posebridge",
    version,
    about,
    long_about,
    args_conflicts_with_subcommands = true,
    after_long_help = links_help()
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Without a subcommand: the flags of `run`.
    #[command(flatten, next_help_heading = "Without a command, the options of `run`")]
    pub run: RunArgs,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the station: telemetry in, pose estimates back, everything recorded.
    #[command(after_long_help = links_help())]
    Run(RunArgs),
    /// Run the simulated brick as a process of its own.
    #[command(after_long_help = plain_links_help())]
    Sim(SimArgs),
    /// Play a recording of a real robot out of a link, as a brick would.
    #[command(after_long_help = plain_links_help())]
    Play(PlayArgs),
    /// Pass bytes between two links as a bad link would: late, in pieces, damaged, or not at all.
    ///
    /// The first link is the brick's end, the second the station's.
    #[command(after_long_help = relay_help())]
    Relay(RelayArgs),
    /// Run the estimators over a recording, offline.
    Replay(ReplayArgs),
    /// Write a recording as CSV, as trajectories for evo, as a telemetry log or as a recording of ours (docs/export.md).
    Export(crate::commands::export::ExportArgs),
    /// Make a recording of ours from a telemetry log or a run of a descriptor (docs/import.md).
    Import(crate::commands::import::ImportArgs),
    /// Make a page of a recording that needs nothing else: path, errors, innovations with verdicts, links, clock (docs/report.md).
    Report(crate::commands::report::ReportArgs),
    /// Say what a file carries: messages, rates, losses, gaps, clocks, senders (docs/inspect.md).
    Inspect(crate::commands::inspect::InspectArgs),
    /// Run an experiment: simulated, and those of the papers on a recording or a live robot as well.
    Lab(LabArgs),
    /// Measure a robot: wheels and track, tag and camera, gyro and accelerometers (docs/lab/calibrate.md).
    Calibrate(crate::commands::calibrate::CalibrateArgs),
    /// Find what a sensor's noise is from a rest or a straight run, and how late a camera speaks (docs/lab/identify.md).
    Identify(crate::commands::identify::IdentifyArgs),
    /// Find a robot's noise parameters by the likelihood of the innovations (docs/lab/tune.md).
    Tune(crate::commands::tune::TuneArgs),
    /// Make a key for signed links.
    Key(KeyArgs),
    /// Find out why a robot cannot be heard: ports, permissions, programs in the way, what a link carries.
    Doctor(DoctorArgs),
    /// Write a commented configuration for a robot (docs/quick-start-robot.md).
    #[command(after_long_help = init::robots_help())]
    Init(InitArgs),
    /// Print, check or describe the configuration.
    Config(ConfigArgs),
    /// Print a completion script for a shell (docs/install.md).
    Completions(CompletionsArgs),
    /// Print the manual page, or write the pages of all subcommands (docs/install.md).
    Man(ManArgs),
}

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
    /// What the brick of the first link speaks: mavlink, or a protocol of its own (docs/protocols/README.md).
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

/// How the simulated brick steers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SteerBy {
    /// By its own dead reckoning.
    Odometry,
    /// By the estimate that comes back.
    Estimate,
}

/// What the simulated brick speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BrickKind {
    /// MAVLink 2, on one link with the camera.
    Mavlink,
    /// The telegrams of a LEGO NXT as it comes out of the box.
    Nxt,
    /// A LEGO NXT whose program pushes compact MAVLink frames.
    NxtPush,
    /// The commands of a LEGO EV3 as it comes out of the box.
    Ev3,
}

/// The camera's own link to the station, where brick and camera do not share one.
#[derive(Args, Clone, Debug, Default)]
#[group(multiple = false)]
pub struct CameraLink {
    /// Wait for the station on this link for the camera of a LEGO brick, which cannot share the brick's.
    #[arg(long, value_name = "URL")]
    pub camera_listen: Option<String>,
    /// Call the station on this link for the camera of a LEGO brick.
    #[arg(long, value_name = "URL")]
    pub camera_link: Option<String>,
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

/// Flags of `sim`.
#[derive(Args, Clone, Debug)]
pub struct SimArgs {
    /// A bundled scenario's name (square, circle, figure-eight, waypoints, straight, rough, thermometer) or a TOML file.
    #[arg(default_value = "square")]
    pub scenario: String,
    /// The link to the station.
    #[command(flatten)]
    pub link: StationLink,
    /// What the brick speaks, instead of what the scenario says (docs/simulated-bricks.md).
    #[arg(long, value_enum, value_name = "KIND")]
    pub brick: Option<BrickKind>,
    /// The camera's link, where it has one of its own.
    #[command(flatten)]
    pub camera: CameraLink,
    /// Play the eye of a camera program, which calls this link: the corners of the tag in each image go there as lines of JSON, and the
    /// simulated camera sends no fixes (docs/protocols/camera-json.md).
    #[arg(long, value_name = "URL")]
    pub images_listen: Option<String>,
    /// Tell this UDP address once per second that there is an EV3, as one on a network does, e.g. udp://127.0.0.1:3015; it has to listen
    /// on a TCP port of four digits.
    #[arg(long, value_name = "URL", requires = "listen")]
    pub announce: Option<String>,
    /// Seed, instead of the scenario's.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Laps, instead of the scenario's.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub laps: Option<u32>,
    /// By what to steer, instead of what the scenario says.
    #[arg(long, value_enum)]
    pub steer: Option<SteerBy>,
    /// Write the truth to this CSV file at the end; it never goes over the link.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
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

/// Flags of `play`.
#[derive(Args, Clone, Debug)]
pub struct PlayArgs {
    /// A recording's descriptor (config/recordings/*.toml).
    pub descriptor: PathBuf,
    /// The link to the station.
    #[command(flatten)]
    pub link: StationLink,
    /// What to read.
    #[command(flatten)]
    pub data: DataFlags,
    /// How much faster than real time; other than 1 the station cannot align the clocks, which a recording with one clock does not need.
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR", value_parser = positive)]
    pub speed: f64,
    /// Begin at once instead of when the station has been heard.
    #[arg(long)]
    pub at_once: bool,
}

/// Flags of `relay`.
#[derive(Args, Clone, Debug)]
pub struct RelayArgs {
    /// Both links.
    #[command(flatten)]
    pub ends: RelayEnds,
    /// What the link between them is like: a bundled profile's name or a TOML file (docs/impairment.md).
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    pub impair: String,
    /// Seed of its randomness.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Record what reached the station (link 0) and the brick (link 1); `posebridge replay` estimates from the former.
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// End after this many seconds.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub duration: Option<f64>,
    /// Print one JSON object at the end instead of a table.
    #[arg(long)]
    pub json: bool,
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
    /// Count from so many seconds behind the beginning; the filter is given all that came before, too.
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub from: Option<f64>,
    /// End so many seconds behind the beginning; nothing later is given to the filter.
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    pub to: Option<f64>,
}

/// Flags of `replay`.
#[derive(Args, Clone, Debug)]
pub struct ReplayArgs {
    /// What to replay.
    #[command(flatten)]
    pub session: SessionFlags,
    /// Estimators to run, side by side; may be repeated.
    #[arg(long = "filter", visible_alias = "estimator", value_name = "NAME")]
    pub filters: Vec<String>,
    /// As fast as it was recorded (1), or so many times faster; without it as fast as possible.
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
    /// Print one JSON object (docs/replay-json.md) instead of tables.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `key`.
#[derive(Args, Clone, Debug)]
pub struct KeyArgs {
    /// What to do.
    #[command(subcommand)]
    pub action: KeyAction,
}

/// What to do with keys.
#[derive(Clone, Debug, Subcommand)]
pub enum KeyAction {
    /// Make a new key, from random bytes of the operating system, and print its name (docs/signing.md).
    New {
        /// Where to write it; a file that is there already is not touched.
        file: PathBuf,
    },
}

/// Flags of `doctor`.
#[derive(Args, Clone, Debug)]
pub struct DoctorArgs {
    /// Listen on these links and name what is heard: serial, tcp or udp, e.g. serial:///dev/ttyUSB0.
    #[arg(value_name = "URL")]
    pub links: Vec<String>,
    /// Check this configuration file, and whether its links open.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Listen this long on each link, and at each speed of a serial port that is tried.
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = up_to_an_hour)]
    pub listen_for: f64,
    /// Print one JSON object (docs/doctor.md) instead of lines.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `config`.
#[derive(Args, Clone, Debug)]
pub struct ConfigArgs {
    /// What to do with it.
    #[command(subcommand)]
    pub action: ConfigAction,
}

/// What to do with the configuration.
#[derive(Clone, Debug, Subcommand)]
pub enum ConfigAction {
    /// Print every key with its value and where it comes from.
    Print(ConfigFlags),
    /// Check a configuration and say nothing if it is good.
    Check(ConfigFlags),
    /// Print the JSON schema.
    Schema,
    /// Print every parameter of the filters: those of `[filter]`, which ground stations can set while a station runs.
    Params,
}

/// Flags of `completions`.
#[derive(Args, Clone, Debug)]
pub struct CompletionsArgs {
    /// The shell.
    pub shell: clap_complete::Shell,
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

/// A number of seconds of more than zero and up to an hour.
fn up_to_an_hour(text: &str) -> Result<f64, String> {
    match positive(text) {
        Ok(seconds) if seconds <= 3_600.0 => Ok(seconds),
        _ => Err("must be a number of seconds of more than zero, up to 3600".to_owned()),
    }
}

/// The profiles, and the kinds of link, from their tables.
fn relay_help() -> String {
    let names: Vec<&str> = PROFILES.iter().map(|(name, _)| *name).collect();
    format!("Profiles:\n  none, {}\n\n{}", names.join(", "), plain_links_help())
}

/// The kinds of link, from the table.
fn links_help() -> String {
    format!(
        "Links:\n  sim://NAME             a simulated brick of our own, on a pseudo-terminal (sim://square)\n{}",
        transports_help()
    )
}

/// The kinds of link of a command that has no simulated brick of its own.
fn plain_links_help() -> String {
    format!("Links:\n{}", transports_help())
}

fn transports_help() -> String {
    use std::fmt::Write as _;
    let mut help = String::new();
    for transport in TRANSPORTS {
        // Writing to a String cannot fail.
        let _ = writeln!(help, "  {}\n      {}", transport.example(), transport.summary());
        for option in transport.options() {
            let _ = writeln!(help, "      ?{}={}  {}", option.name, option.kind.default_text(), option.help);
        }
    }
    help
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_help_of_run_lists_every_scheme_with_its_options() {
        let mut program = Cli::command();
        let run = program.find_subcommand_mut("run").expect("it is there");
        // The terminal's width may break lines, so only words are compared.
        let help = run.render_long_help().to_string();
        let words: Vec<_> = help.split_whitespace().collect();
        let starts = TRANSPORTS.iter().map(|transport| {
            words.iter().position(|word| *word == transport.example()).expect("every transport has its example there")
        });
        let starts: Vec<usize> = starts.chain([words.len()]).collect();
        for (transport, block) in TRANSPORTS.iter().zip(starts.windows(2)) {
            let lines = &words[block[0]..block[1]];
            for option in transport.options() {
                let wanted = format!("?{}={}", option.name, option.kind.default_text());
                let scheme = transport.scheme();
                assert!(lines.contains(&wanted.as_str()), "{wanted} of {scheme} in:\n{help}");
            }
        }
    }
}

//! The command line: every command of the program, and what executes it.

use clap::{ColorChoice, CommandFactory, FromArgMatches, Parser, Subcommand};
use posebridge_link::TRANSPORTS;
use posebridge_sim::impairment::PROFILES;

use crate::console::set_colour;
use crate::examples::add_examples;
use crate::exit::Failure;
#[cfg(feature = "lab")]
use crate::lab::{self, calibrate::CalibrateArgs, experiments::LabArgs, identify::IdentifyArgs, tune::TuneArgs};
use crate::station::args::RunArgs;
#[cfg(feature = "camera")]
use crate::tools::camera::CameraArgs;
use crate::tools::config::ConfigArgs;
use crate::tools::dialect::DialectArgs;
use crate::tools::doctor::DoctorArgs;
use crate::tools::export::ExportArgs;
use crate::tools::import::ImportArgs;
use crate::tools::init::{InitArgs, robots_help};
use crate::tools::inspect::InspectArgs;
use crate::tools::key::KeyArgs;
use crate::tools::man::{CompletionsArgs, ManArgs};
use crate::tools::merge::MergeArgs;
use crate::tools::play::PlayArgs;
use crate::tools::relay::RelayArgs;
use crate::tools::replay::ReplayArgs;
use crate::tools::report::ReportArgs;
use crate::tools::sim::SimArgs;
use crate::{station, tools};

/// Ground station for robots that are too weak to filter for themselves.
///
/// Without a command it runs the station with a simulated robot on a pseudo-terminal.
#[derive(Debug, Parser)]
#[command(
    name = "posebridge",
    version,
    about,
    long_about,
    args_conflicts_with_subcommands = true,
    max_term_width = 80,
    after_long_help = links_help()
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Colours in results.
    #[arg(long, global = true, value_name = "WHEN", default_value_t = ColorChoice::Auto)]
    pub color: ColorChoice,
    /// Without a subcommand: the flags of `run`.
    #[command(flatten, next_help_heading = "Without a command, the options of `run`")]
    pub run: RunArgs,
}

impl Cli {
    /// Parses the program's arguments; prints the help or an error and exits where there is nothing to execute.
    pub fn from_args() -> Self {
        Self::from_arg_matches(&program().get_matches()).unwrap_or_else(|error| error.exit())
    }
}

/// The whole command line with its help.
pub fn program() -> clap::Command {
    add_examples(Cli::command())
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the station: receive telemetry, estimate poses, send them back, record everything.
    #[command(after_long_help = links_help())]
    Run(RunArgs),
    /// Run the simulated robot as a separate process.
    #[command(after_long_help = plain_links_help())]
    Sim(SimArgs),
    /// Send a recording of a real robot through a link, as the robot would.
    #[command(after_long_help = plain_links_help())]
    Play(PlayArgs),
    /// Forward bytes between two links and impair them: delay, fragmentation, damage, loss.
    ///
    /// The first link goes to the robot, the second to the station.
    #[command(after_long_help = relay_help())]
    Relay(RelayArgs),
    /// Run estimators on a recording.
    Replay(ReplayArgs),
    /// Export a recording to CSV, trajectories for evo, a telemetry log or a posebridge recording (docs/recordings.md).
    Export(ExportArgs),
    /// Convert a telemetry log or a run of a descriptor into a posebridge recording (docs/recordings.md).
    Import(ImportArgs),
    /// Make one recording of those of the stations of a fleet (docs/recordings.md).
    Merge(MergeArgs),
    /// Write a self-contained HTML page about a recording: path, errors, innovations, links, clock (docs/reports.md).
    Report(ReportArgs),
    /// Show what a file contains: messages, rates, losses, gaps, clocks, senders (docs/recordings.md).
    Inspect(InspectArgs),
    /// Run an experiment: simulated, or those of the papers on a recording or a live robot.
    #[cfg(feature = "lab")]
    Lab(LabArgs),
    /// Calibrate a robot: wheels and track, tag and camera, gyro and accelerometers (docs/lab/calibration.md).
    #[cfg(feature = "lab")]
    Calibrate(CalibrateArgs),
    /// Identify sensor noise, camera delay and step responses (docs/lab/calibration.md).
    #[cfg(feature = "lab")]
    Identify(IdentifyArgs),
    /// Find the noise parameters of a robot by maximum likelihood of the innovations (docs/lab/calibration.md).
    #[cfg(feature = "lab")]
    Tune(TuneArgs),
    /// Print tags, and find them in pictures (docs/camera.md).
    #[cfg(feature = "camera")]
    Camera(CameraArgs),
    /// Print the station's own MAVLink messages for other programs: pymavlink, Wireshark, C (docs/protocols/mavlink.md).
    Dialect(DialectArgs),
    /// Create a key for signed links.
    Key(KeyArgs),
    /// Find out why no data arrive from a robot: ports, permissions, programs that hold a port, bytes on a link.
    Doctor(DoctorArgs),
    /// Write a commented configuration for a robot (docs/getting-started.md).
    #[command(after_long_help = robots_help())]
    Init(InitArgs),
    /// Print, check or describe the configuration.
    Config(ConfigArgs),
    /// Print a completion script for a shell (docs/getting-started.md).
    Completions(CompletionsArgs),
    /// Print the manual page, or write the pages of all subcommands (docs/getting-started.md).
    Man(ManArgs),
}

/// Without a subcommand executes `run`.
pub fn execute(cli: Cli) -> Result<(), Failure> {
    set_colour(cli.color);
    match cli.command.unwrap_or(Command::Run(cli.run)) {
        Command::Run(args) => station::run::execute(&args),
        Command::Sim(args) => tools::sim::execute(&args),
        Command::Play(args) => tools::play::execute(&args),
        Command::Relay(args) => tools::relay::execute(&args),
        Command::Replay(args) => tools::replay::execute(&args),
        Command::Export(args) => tools::export::execute(&args),
        Command::Import(args) => tools::import::execute(&args),
        Command::Merge(args) => tools::merge::execute(&args),
        Command::Report(args) => tools::report::execute(&args),
        Command::Inspect(args) => tools::inspect::execute(&args),
        #[cfg(feature = "lab")]
        Command::Lab(args) => lab::experiments::execute(&args),
        #[cfg(feature = "lab")]
        Command::Calibrate(args) => lab::calibrate::execute(&args),
        #[cfg(feature = "lab")]
        Command::Identify(args) => lab::identify::execute(&args),
        #[cfg(feature = "lab")]
        Command::Tune(args) => lab::tune::execute(&args),
        #[cfg(feature = "camera")]
        Command::Camera(args) => tools::camera::execute(&args),
        Command::Dialect(args) => tools::dialect::execute(&args),
        Command::Key(args) => tools::key::execute(&args),
        Command::Doctor(args) => tools::doctor::execute(&args),
        Command::Init(args) => tools::init::execute(&args),
        Command::Config(args) => tools::config::execute(&args),
        Command::Completions(args) => tools::man::print_completions(&args, program()),
        Command::Man(args) => tools::man::execute(&args, program()),
    }
}

fn relay_help() -> String {
    let names: Vec<&str> = PROFILES.iter().map(|(name, _)| *name).collect();
    format!("Profiles:\n  none, {}\n\n{}", names.join(", "), plain_links_help())
}

fn links_help() -> String {
    format!(
        "Links:\n  sim://NAME             a simulated brick of our own, on a pseudo-terminal (sim://square)\n{}",
        transports_help()
    )
}

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
                let expected = format!("?{}={}", option.name, option.kind.default_text());
                let scheme = transport.scheme();
                assert!(lines.contains(&expected.as_str()), "{expected} of {scheme} in:\n{help}");
            }
        }
    }
}

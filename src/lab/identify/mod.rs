//! `posebridge identify`: a sensor's noise, a camera's delay, the step response of a sensor or a motor, and the drive of a car
//! before a wall.
//!
//! Without a recording each experiment looks at something simulated whose numbers are known, and says how far it was off.
//! docs/lab/calibration.md, section 7, has the equations.

mod experiments;
mod report;
mod source;
mod step;
mod step_args;
mod step_dataset;
mod step_report;
mod step_simulated;
mod step_source;
mod wall;

use anyhow::Result;
use posebridge_lab::noise_identification::DelaySearch;

use self::report::{Findings, write_findings};
use self::source::{ExperimentSource, FixTimeSource, SourceArgs};
use crate::exit::{ExitStage, Failure};
use crate::tools::experiment_output::OutputArgs;

/// Flags of `identify`.
#[derive(clap::Args, Clone, Debug)]
pub struct IdentifyArgs {
    /// What to identify.
    #[command(subcommand)]
    pub what: IdentifyExperiment,
}

/// What can be identified.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum IdentifyExperiment {
    /// Gyro of a robot that rests: bias, white noise, step, angle random walk, random walk of the bias, Allan deviation.
    Rest(NoiseArgs),
    /// Encoder speed of a robot that drives straight: R of each wheel.
    Straight(NoiseArgs),
    /// Camera of a robot that turns to and fro: its delay against the wheels.
    Delay(DelayArgs),
    /// A sensor or a motor that answers a step: gain, dead time, lags and their number, each with a sigma, up and down told apart.
    Step(step_args::StepArgs),
    /// A car that drives at a wall: d and m of its drive, steady speed, rise time and measured dt, each with a sigma.
    Wall(wall::WallArgs),
}

/// Flags of `identify rest` and `identify straight`.
#[derive(clap::Args, Clone, Debug)]
pub struct NoiseArgs {
    /// What to look at.
    #[command(flatten)]
    pub source: SourceArgs,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Flags of `identify delay`.
#[derive(clap::Args, Clone, Debug)]
pub struct DelayArgs {
    /// What to look at.
    #[command(flatten)]
    pub source: SourceArgs,
    /// Take a fix for seen when its stamp says so, or when it arrived.
    #[arg(long, value_enum, default_value = "arrival")]
    pub by: FixTimeSource,
    /// The largest delay that is looked at, in seconds; the smallest is a quarter of it, before zero.
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    pub most: f64,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Identifies.
///
/// # Errors
/// The recording or the scenario cannot be had, it does not determine what is asked for, or an output cannot be written.
pub fn execute(args: &IdentifyArgs) -> Result<(), Failure> {
    match &args.what {
        IdentifyExperiment::Rest(args) => run(&args.source, &args.output, &source::REST, experiments::rest),
        IdentifyExperiment::Straight(args) => run(&args.source, &args.output, &source::STRAIGHT, experiments::straight),
        IdentifyExperiment::Delay(args) => {
            let search = DelaySearch { from_s: -0.25 * args.most, to_s: args.most };
            run(&args.source, &args.output, &source::DELAY, |data| experiments::delay(data, args.by, &search))
        }
        IdentifyExperiment::Step(args) => step::execute(args),
        IdentifyExperiment::Wall(args) => wall::execute(args),
    }
}

fn run(
    source: &SourceArgs,
    output: &OutputArgs,
    asked: &ExperimentSource,
    experiment: impl FnOnce(&source::ExperimentData) -> Result<Findings>,
) -> Result<(), Failure> {
    let data = source.read(asked, output)?;
    let folder = output.folder()?;
    let findings = experiment(&data).while_running()?;
    write_findings(output, &folder, &findings, &data.name)
}

//! `posebridge identify`: a sensor's noise, a camera's delay, the step response of a sensor or a motor, and the drive of a car before a
//! wall.
//!
//! Without a recording each experiment uses a simulation with known parameters and reports its error. docs/lab/calibration.md, section
//! 7, has the equations.

mod noise;
mod report;
mod step;
mod step_dataset;
mod wall;

use anyhow::Result;
use posebridge_lab::noise_identification::DelaySearch;
use posebridge_report::report::Report;

use self::noise::{ExperimentSource, FixTimeSource, SourceArgs};
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
    /// Gyro of a resting robot: bias, white noise, resolution, angle random walk, bias random walk, Allan deviation.
    Rest(NoiseArgs),
    /// Encoder speeds of a robot that drives straight: the noise variance R of each wheel.
    Straight(NoiseArgs),
    /// Camera of a robot that turns left and right: its delay relative to the wheels.
    Delay(DelayArgs),
    /// Step response of a sensor or a motor: gain, dead time, number of lags and their time constants, each with a sigma,
    /// separately for up and down.
    Step(step_dataset::StepArgs),
    /// Car that drives towards a wall: d and m of its drive, steady speed, rise time and measured dt, each with a sigma.
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
    /// Time of a fix: its timestamp or its arrival.
    #[arg(long, value_enum, default_value = "arrival")]
    pub by: FixTimeSource,
    /// Largest delay to search, in seconds. The search starts at minus a quarter of it.
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    pub most: f64,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub fn execute(args: &IdentifyArgs) -> Result<(), Failure> {
    match &args.what {
        IdentifyExperiment::Rest(args) => run(&args.source, &args.output, &noise::REST, noise::rest),
        IdentifyExperiment::Straight(args) => run(&args.source, &args.output, &noise::STRAIGHT, noise::straight),
        IdentifyExperiment::Delay(args) => {
            let search = DelaySearch { from_s: -0.25 * args.most, to_s: args.most };
            run(&args.source, &args.output, &noise::DELAY, |data| noise::delay(data, args.by, &search))
        }
        IdentifyExperiment::Step(args) => step::execute(args),
        IdentifyExperiment::Wall(args) => wall::execute(args),
    }
}

fn run(
    source: &SourceArgs,
    output: &OutputArgs,
    requested: &ExperimentSource,
    experiment: impl FnOnce(&noise::ExperimentData) -> Result<Report>,
) -> Result<(), Failure> {
    let data = source.read(requested, output)?;
    let folder = output.folder()?;
    output.write_outcome(&folder, &experiment(&data).while_running()?)
}

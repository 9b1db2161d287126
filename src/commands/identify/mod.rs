//! `posebridge identify`: what a sensor's noise is, how late a camera speaks, how a sensor or a motor answers a step, and what drives a
//! car before a wall.
//!
//! Without a recording each experiment looks at something simulated whose numbers are known, and says how far it was off.
//! docs/lab/identify.md has the equations.

mod experiments;
mod report;
mod source;
mod step;
mod step_report;
mod step_simulated;
mod step_source;
mod wall;

use std::path::Path;

use anyhow::Result;
use posebridge_analysis::noise_identification::DelaySearch;

use self::report::Findings;
use self::source::{Clock, Experiment, SourceArgs};
use crate::commands::lab::outcome::{Outcome, OutputArgs};
use crate::commands::{Failure, Stage};

/// Flags of `identify`.
#[derive(clap::Args, Clone, Debug)]
pub struct IdentifyArgs {
    /// What to identify.
    #[command(subcommand)]
    pub what: What,
}

/// What can be identified.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum What {
    /// Gyro of a robot that rests: bias, white noise, step, angle random walk, random walk of the bias, Allan deviation.
    Rest(NoiseArgs),
    /// Encoder speed of a robot that drives straight: R of each wheel.
    Straight(NoiseArgs),
    /// Camera of a robot that turns to and fro: its delay against the wheels.
    Delay(DelayArgs),
    /// A sensor or a motor that answers a step: gain, dead time, lags and their number, each with a sigma, up and down told apart.
    Step(step::StepArgs),
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
    pub by: Clock,
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
/// The recording or the scenario cannot be had, it tells nothing of what is asked for, or an output cannot be written.
pub fn execute(args: &IdentifyArgs) -> Result<(), Failure> {
    match &args.what {
        What::Rest(args) => run(&args.source, &args.output, &source::REST, experiments::rest),
        What::Straight(args) => run(&args.source, &args.output, &source::STRAIGHT, experiments::straight),
        What::Delay(args) => {
            let search = DelaySearch { from_s: -0.25 * args.most, to_s: args.most };
            run(&args.source, &args.output, &source::DELAY, |seen| experiments::delay(seen, args.by, &search))
        }
        What::Step(args) => step::execute(args),
        What::Wall(args) => wall::execute(args),
    }
}

fn run(
    source: &SourceArgs,
    output: &OutputArgs,
    asked: &Experiment,
    experiment: impl FnOnce(&source::Seen) -> Result<Findings>,
) -> Result<(), Failure> {
    let seen = source.read(asked, output)?;
    let folder = output.folder()?;
    let findings = experiment(&seen).while_running()?;
    deliver(output, &folder, &findings, &seen.name)
}

/// Prints and writes what was found of something.
fn deliver(output: &OutputArgs, folder: &Path, findings: &Findings, of: &str) -> Result<(), Failure> {
    let text = report::text(findings, of);
    let outcome =
        Outcome { name: findings.name, page: report::page(findings, &text), json: report::json(findings, of), text };
    output.deliver(folder, &outcome)
}

//! `posebridge identify`: a sensor's noise, a camera's delay, the step response of a sensor or a motor, and the drive of a car before a
//! wall.
//!
//! Without a recording each experiment uses a simulation with known parameters and reports its error. docs/lab/calibration.md, section
//! 7, has the equations.

mod noise;
mod step;
mod step_dataset;
mod wall;

use anyhow::{Result, ensure};
use posebridge_lab::noise_identification::DelaySearch;
use posebridge_report::chart::Plot;
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use serde_json::json;

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

/// Checks `--from` and `--to`; returns the end.
fn end_of_interval(from_s: f64, to_s: Option<f64>) -> Result<f64> {
    let until_s = to_s.unwrap_or(f64::INFINITY);
    ensure!(from_s < until_s, "--from is {from_s} and --to is {until_s}: nothing lies between them");
    Ok(until_s)
}

struct Quantity {
    /// The run, if there are several.
    of: Option<String>,
    name: String,
    unit: &'static str,
    value: Option<f64>,
    sigma: Option<f64>,
    truth: Option<f64>,
}

impl Quantity {
    /// Without a value it is not significantly different from zero.
    fn new(
        name: impl Into<String>,
        unit: &'static str,
        value: impl Into<Option<f64>>,
        sigma: impl Into<Option<f64>>,
    ) -> Self {
        Self { of: None, name: name.into(), unit, value: value.into(), sigma: sigma.into(), truth: None }
    }

    fn for_run(self, run: impl Into<Option<String>>) -> Self {
        Self { of: run.into(), ..self }
    }

    fn with_truth(self, truth: Option<f64>) -> Self {
        Self { truth, ..self }
    }
}

/// `name` is the command's words joined, `run` where the data come from.
fn report(
    name: &'static str,
    title: &str,
    run: &str,
    quantities: &[Quantity],
    notes: &[String],
    plots: &[Plot],
) -> Report {
    let mut report = Report::new(name, format!("{title}: {run}"));
    let six = Format::new(Unit::None, 6);
    let label = |quantity: &Quantity| match &quantity.of {
        Some(of) => format!("{of}: {}", quantity.name),
        None => quantity.name.clone(),
    };
    let table = Table::of(quantities)
        .text("", "quantity", label)
        .data("of", |quantity| json!(quantity.of))
        .data("name", |quantity| json!(quantity.name))
        .number("value", "value", six, |quantity| quantity.value)
        .number("sigma", "sigma", six, |quantity| quantity.sigma)
        .text("unit", "unit", |quantity| quantity.unit.to_owned())
        .number("truth", "truth", six, |quantity| quantity.truth);
    report.table("quantities", &table);
    report.list(notes.iter().cloned());
    for plot in plots {
        report.chart(plot, plot.title.as_str());
    }
    report.data("experiment", json!(name));
    report.data("run", json!(run));
    report.data("notes", json!(notes));
    report
}

//! `posebridge lab`: experiments. None needs a robot or a link; those of the papers take a recording or a live robot as well.

pub mod accuracy;
mod accuracy_runs;
mod again;
mod bounds;
mod estimators;
pub mod indirect;
pub mod links;
mod links_pose;
mod links_report;
pub mod live;
pub mod nxt_square;
pub mod recorded;
pub mod thermometer;
pub mod wall;

pub use estimators::{Estimator, EstimatorResult, UnknownEstimator};

use clap::{Args, Subcommand};

use self::accuracy::{LabAccuracyArgs, accuracy_help};
use self::links::LabLinksArgs;
use crate::exit::Failure;

/// Flags of `lab`.
#[derive(Args, Clone, Debug)]
pub struct LabArgs {
    /// Which experiment.
    #[command(subcommand)]
    pub experiment: LabExperiment,
}

/// The experiments.
#[derive(Clone, Debug, Subcommand)]
pub enum LabExperiment {
    /// Run every estimator over the Monte-Carlo scenarios: errors, and whether the claimed ones are right.
    ///
    /// Prints one table per scenario and writes the page lab-accuracy.html with its picture.
    /// docs/lab/accuracy.md describes --json.
    #[command(after_long_help = accuracy_help())]
    Accuracy(LabAccuracyArgs),
    /// Align clocks and drive laps over links that delay, lose and damage, in virtual time.
    ///
    /// Prints a table of the clocks and one of the poses, and writes the page lab-links.html with its picture.
    /// docs/impairment.md describes --json.
    Links(LabLinksArgs),
    /// Run the filters of paper 1 on its square, on exported sensor data, on recordings or a live robot: errors, order, R, figures.
    NxtSquare(nxt_square::LabNxtSquareArgs),
    /// Tell what a slow thermometer will show in the end, simulated or recorded, and how it is identified (docs/lab/thermometer.md).
    Thermometer(thermometer::LabThermometerArgs),
    /// Paper 3: identify a car before a wall, and stop it there by readings, lines and filters; or foretell a recorded or a live
    /// robot's readings.
    Wall(wall::LabWallArgs),
    /// Paper 4: a square by wheels alone, and with accelerometers by the indirect filter, fed forward and back; simulated, recorded or
    /// live.
    Indirect(indirect::LabIndirectArgs),
}

/// Runs an experiment.
///
/// # Errors
/// As the experiment says.
pub fn execute(args: &LabArgs) -> Result<(), Failure> {
    match &args.experiment {
        LabExperiment::Accuracy(args) => accuracy::execute(args),
        LabExperiment::Links(args) => links::execute(args),
        LabExperiment::NxtSquare(args) => nxt_square::execute(args),
        LabExperiment::Thermometer(args) => thermometer::execute(args),
        LabExperiment::Wall(args) => wall::execute(args),
        LabExperiment::Indirect(args) => indirect::execute(args),
    }
}

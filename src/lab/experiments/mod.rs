//! `posebridge lab`: experiments. None needs a robot or a link; those of the papers take a recording or a live robot as well.

pub mod accuracy;
mod estimators;
pub mod indirect;
mod indirect_drive;
mod indirect_map;
pub mod links;
pub mod live;
pub mod nxt_square;
pub mod recorded;
pub mod thermometer;
pub mod wall;

pub use estimators::{Estimator, UnknownEstimator};

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
    /// Run every filter on the Monte-Carlo scenarios: errors and consistency.
    ///
    /// Prints one table per scenario and writes the page lab-accuracy.html with its picture.
    /// docs/lab/accuracy.md describes --json.
    #[command(after_long_help = accuracy_help())]
    Accuracy(LabAccuracyArgs),
    /// Align clocks and drive laps over impaired links, in virtual time.
    ///
    /// Prints a table of the clocks and one of the poses, and writes the page lab-links.html with its picture.
    /// docs/impairment.md describes --json.
    Links(LabLinksArgs),
    /// Paper 1: its filters on a simulated square, exported sensor data, recordings or a live robot.
    NxtSquare(nxt_square::LabNxtSquareArgs),
    /// Paper 2: predict the final value of a slow thermometer, simulated or recorded (docs/lab/thermometer.md).
    Thermometer(thermometer::LabThermometerArgs),
    /// Paper 3: identify a car that drives towards a wall and stop it by readings, lines and filters, or predict the readings of
    /// a recorded or live robot.
    Wall(wall::LabWallArgs),
    /// Paper 4: a square by odometry, and with accelerometers by the indirect filter, feed-forward and feedback; simulated,
    /// recorded or live.
    Indirect(indirect::LabIndirectArgs),
}

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

//! `posebridge lab`: experiments. None needs a robot or a link; those of the papers take a recording or a live robot as well.

pub mod accuracy;
mod accuracy_json;
mod accuracy_runs;
mod again;
mod bounds;
mod estimators;
pub mod indirect;
pub mod links;
mod links_clock;
mod links_pose;
mod links_report;
pub mod live;
pub mod nxt_square;
pub mod outcome;
pub mod recorded;
pub mod thermometer;
pub mod wall;

pub use estimators::{Estimator, UnknownEstimator, Verdict};

use super::Failure;
use crate::cli::{LabArgs, LabExperiment};

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

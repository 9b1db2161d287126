//! `posebridge lab indirect`: paper 4's square, by wheels alone and with the indirect filter.
//!
//! Every run is one round of the square, simulated or driven by a real robot; what differs between the rows is who looks at which
//! sensors. docs/lab/indirect.md is the lesson.

mod recorded;
mod report;
mod rounds;

use std::path::PathBuf;

use posebridge_sim::montecarlo::{MAX_RUNS, Scenario};

use super::recorded::RecordedArgs;
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::lab::drives;
use crate::tools::experiment_output::OutputArgs;

/// The square as it comes with the program.
const SQUARE: &str = include_str!("../../../../config/scenarios/lab/indirect.toml");

/// Flags of `lab indirect`.
#[derive(clap::Args, Clone, Debug)]
pub struct LabIndirectArgs {
    /// Robot, sensors and square, as a TOML file; without it config/scenarios/lab/indirect.toml.
    #[arg(long, value_name = "FILE.toml", conflicts_with = "real_robot")]
    pub scenario: Option<PathBuf>,
    /// Rounds, instead of what the scenario says.
    #[arg(long, value_name = "N", conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_RUNS)))]
    pub runs: Option<u32>,
    /// Base seed, instead of the scenario's.
    #[arg(long, value_name = "N", conflicts_with = "real_robot")]
    pub seed: Option<u64>,
    /// A real robot.
    #[command(flatten)]
    pub real: RecordedArgs,
    /// Where the results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// Runs the experiment.
///
/// # Errors
/// The scenario or a recording cannot be read or makes no sense, or an output cannot be written.
pub fn execute(args: &LabIndirectArgs) -> Result<(), Failure> {
    if let Some(drives) = args.real.drives(&args.output, recorded::TASK)? {
        let found = drives.with_exit_stage(recorded::rounds_of(&drives))?;
        let folder = args.output.folder()?;
        return args.output.write_outcome(&folder, &report::of_recordings(&drives, &found));
    }
    let scenario = scenario(args).before_start()?;
    let runs = args.runs.unwrap_or(scenario.runs);
    let folder = args.output.folder()?;
    let bar = progress_bar(u64::from(runs), "rounds").before_start()?;
    let found = rounds::drive_all(&scenario, runs, || bar.inc(1));
    bar.finish_and_clear();
    args.output.write_outcome(&folder, &report::of_scenario(&scenario, runs, &found))
}

fn scenario(args: &LabIndirectArgs) -> anyhow::Result<Scenario> {
    let scenario = match &args.scenario {
        None => Scenario::from_toml(SQUARE)?,
        Some(path) => drives::load_scenario(&path.to_string_lossy())?.1,
    };
    Ok(args.seed.map_or(scenario.clone(), |seed| scenario.with_seed(seed)))
}

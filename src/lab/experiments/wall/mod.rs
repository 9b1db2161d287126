//! `posebridge lab wall`: the car of paper 3 before a wall, on the simulated car, on a recording or on a live robot.
//!
//! Simulated: step tests, identification of the drive, validation of the filter on the step's own readings, and approaches with every
//! distance estimator, on board and over a link. On a recording: the step by hand and by fit, and the prediction of each reading from
//! earlier ones. docs/lab/wall.md is the lesson.

mod approaches;
mod extra_columns;
mod motor_column;
mod pictures;
mod population;
pub(in crate::lab) mod recorded;
mod simulated;
pub(in crate::lab) mod steps;
mod table;

use std::path::{Path, PathBuf};

use anyhow::Context;
use posebridge_sim::wall::{DEFAULT_SCENE, WallScene};

use self::recorded::RunSelection;
use super::live::LiveArgs;
use super::recorded::rerun_command;
use crate::config::load_link_profile;
use crate::exit::{ExitStage, Failure};
use crate::text_file::read_text;
use crate::tools::experiment_output::OutputArgs;

/// Flags of `lab wall`.
#[derive(clap::Args, Clone, Debug)]
pub struct LabWallArgs {
    /// Car, sensor and path, as a TOML file. Default: those of the paper (config/scenarios/lab/wall.toml).
    #[arg(long, value_name = "FILE.toml", conflicts_with = "real_robot")]
    pub scene: Option<PathBuf>,
    /// Number of simulated step tests to identify the drive from.
    #[arg(long, value_name = "N", default_value_t = 100, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub steps: u32,
    /// Number of simulated approaches of each kind.
    #[arg(long, value_name = "N", default_value_t = 100, conflicts_with = "real_robot", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub runs: u32,
    /// Base seed. Default: that of the scene.
    #[arg(long, value_name = "N", conflicts_with = "real_robot")]
    pub seed: Option<u64>,
    /// Link profile for the approaches with the filter on the host: a bundled one by name, or a TOML file (docs/impairment.md).
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "bluetooth-spp", conflicts_with = "real_robot")]
    pub profile: String,
    /// Descriptor, e.g. config/recordings/tof-wall.toml, posebridge recording, or table with the columns time and distance.
    /// Default: the simulated car.
    #[arg(long, value_name = "FILE.toml|FILE.mcap|FILE.csv", group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// What to read of it.
    #[command(flatten)]
    pub selection: RunSelection,
    /// Column of a distance that another program has filtered. Default: kf_mm, kf, kalman_mm or kalman, if one exists.
    #[arg(long, value_name = "COLUMN", requires = "recording")]
    pub kalman_column: Option<String>,
    /// Where the results go.
    #[command(flatten)]
    pub output: OutputArgs,
}

pub fn execute(args: &LabWallArgs) -> Result<(), Failure> {
    if let Some(prepared) = real(args)? {
        let folder = args.output.folder()?;
        let live = args.live.is_requested();
        let command = rerun_command(live.then_some(prepared.descriptor.as_str()));
        let report = recorded::run(&prepared, command).while_running()?;
        return args.output.write_outcome(&folder, &report);
    }
    let prepared = simulated::SimulatedSetup {
        scene: scene(args.scene.as_deref(), args.seed).before_start()?,
        steps: args.steps,
        runs: args.runs,
        profile_name: args.profile.clone(),
        link: load_link_profile(&args.profile).before_start()?,
    };
    let folder = args.output.folder()?;
    let report = simulated::run(&prepared).while_running()?;
    args.output.write_outcome(&folder, &report)
}

fn real(args: &LabWallArgs) -> Result<Option<recorded::RecordedRuns>, Failure> {
    let prepare = |path: &Path| recorded::prepare(path, &args.selection, args.kalman_column.as_deref());
    if let Some(recording) = args.live.record(&args.output, None, &args.selection.settings, recorded::TASK)? {
        return prepare(&recording).map(Some).while_running();
    }
    args.recording.as_deref().map(prepare).transpose().before_start()
}

/// The scene of a file, or that of the paper; `seed` overrides its seed.
pub(in crate::lab) fn scene(file: Option<&Path>, seed: Option<u64>) -> anyhow::Result<WallScene> {
    let scene = match file {
        None => WallScene::from_toml(DEFAULT_SCENE)?,
        Some(path) => {
            let name = path.display();
            let text = read_text(path).with_context(|| format!("reading the scene `{name}`"))?;
            WallScene::from_toml(&text).with_context(|| format!("scene `{name}`"))?
        }
    };
    Ok(seed.map_or(scene, |seed| scene.with_seed(seed)))
}

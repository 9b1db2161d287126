//! The runs that are tuned on or held out.

use std::path::Path;

use anyhow::{Result, ensure};
use posebridge_lab::tuning::{SyntheticFixes, fixes_from_truth};
use posebridge_sim::montecarlo::Drive;
use posebridge_telemetry::{Observation, TimeDelta};

use super::args::TuneArgs;
use super::own;
use super::run::{RunReference, RunSet, TuneRun};
use crate::config::RobotFile;
use crate::flags::DataFlags;
use crate::lab::calibrate::source::check_same_robot;
use crate::lab::drives::{self, filter_config, known_drive};
use crate::tools::dataset::{DataSet, RobotRun, report_bad_rows};
use crate::tools::own_recording;

/// All runs, which are of one robot, and that robot as the first training run describes it.
pub(super) struct TuneDataset {
    pub(super) runs: Vec<TuneRun>,
    pub(super) robot: RobotFile,
    /// Whence they come, for the profile.
    pub(super) source: String,
}

impl TuneDataset {
    /// Reads recordings or draws drives.
    ///
    /// # Errors
    /// One cannot be read or makes no sense, or nothing is left to tune on.
    pub(super) fn load(args: &TuneArgs) -> Result<Self> {
        let material = match &args.sim {
            Some(asked) => simulated(args, asked)?,
            None => recorded(args)?,
        };
        ensure!(material.training().next().is_some(), "no run is left to tune on: --hold-out takes them all");
        Ok(material)
    }

    /// The runs that the search sees.
    pub(super) fn training(&self) -> impl Iterator<Item = &TuneRun> {
        self.runs.iter().filter(|run| run.set == RunSet::Training)
    }
}

fn recorded(args: &TuneArgs) -> Result<TuneDataset> {
    let mut runs = Vec::new();
    let mut robot = None;
    let mut known = Vec::new();
    for path in &args.recordings {
        known.extend(all_runs(args, path)?);
    }
    check_prefixes(args, &known)?;
    for path in &args.recordings {
        let trained = named(args, path, &args.run)?;
        let held_out = if args.hold_out.is_empty() { Vec::new() } else { named(args, path, &args.hold_out)? };
        let trained = trained.into_iter().filter(|name| !held_out.contains(name));
        let sets = trained.map(|name| (name, RunSet::Training)).collect::<Vec<_>>();
        let held_out = held_out.iter().map(|name| (name.clone(), RunSet::HeldOut));
        for (name, set) in sets.into_iter().chain(held_out) {
            if own_recording::is_own(path) {
                let (run, its_robot) = own::load(args, path, set)?;
                if set == RunSet::Training {
                    robot.get_or_insert(its_robot);
                }
                runs.push(run);
                continue;
            }
            let flags = flags(args, Some(name.clone()));
            let loaded = DataSet::open(path, &flags)?.load(&name, &flags)?;
            report_bad_rows(&loaded);
            if set == RunSet::Training {
                robot.get_or_insert_with(|| loaded.robot.clone());
            }
            runs.push(run_from_recording(args, loaded, set)?);
        }
    }
    check_same_robot(runs.iter().map(|run: &TuneRun| (run.name.as_str(), &run.config.geometry)))?;
    let paths: Vec<String> = args.recordings.iter().map(|path| path.display().to_string()).collect();
    Ok(TuneDataset { runs, robot: robot.unwrap_or_default(), source: paths.join(", ") })
}

fn flags(args: &TuneArgs, run: Option<String>) -> DataFlags {
    DataFlags { data: args.data.clone(), run, use_every: args.use_every, settings: args.settings.clone() }
}

/// Every run of a descriptor; a recording of ours is one.
fn all_runs(args: &TuneArgs, path: &Path) -> Result<Vec<String>> {
    if own_recording::is_own(path) {
        return Ok(vec![own::name_of(path)]);
    }
    Ok(DataSet::open(path, &flags(args, None))?.descriptor.runs)
}

/// The runs that begin with one of the prefixes; the usual ones without a prefix.
fn named(args: &TuneArgs, path: &Path, prefixes: &[String]) -> Result<Vec<String>> {
    if prefixes.is_empty() && !own_recording::is_own(path) {
        return Ok(DataSet::open(path, &flags(args, None))?.runs);
    }
    let mut runs = all_runs(args, path)?;
    runs.retain(|name| prefixes.is_empty() || prefixes.iter().any(|prefix| name.starts_with(prefix.as_str())));
    Ok(runs)
}

/// A prefix that fits no run is a slip of the pen.
fn check_prefixes(args: &TuneArgs, known: &[String]) -> Result<()> {
    for prefix in args.run.iter().chain(&args.hold_out) {
        ensure!(
            known.iter().any(|name| name.starts_with(prefix.as_str())),
            "no run begins with `{prefix}`; there are: {}",
            known.join(", ")
        );
    }
    Ok(())
}

fn run_from_recording(args: &TuneArgs, loaded: RobotRun, set: RunSet) -> Result<TuneRun> {
    let mut run = loaded.run;
    let config = loaded.filter_config;
    let mut observations: Vec<Observation> = run.observations.iter().map(|timed| timed.observation).collect();
    if let Some(every_s) = args.fixes_from_truth {
        ensure!(
            every_s.is_finite() && every_s > 0.0,
            "--fixes-from-truth is {every_s}, must be a number of seconds of more than zero"
        );
        ensure!(!run.truth.is_empty(), "run `{}` has no truth for --fixes-from-truth", run.name);
        let truth: Vec<_> = run.truth.iter().map(|truth| (truth.time, truth.position)).collect();
        let glimpses = SyntheticFixes {
            every: TimeDelta::from_secs_f64(every_s),
            sigma_m: config.noise.fix_position_m,
            seed: args.seed,
        };
        observations.extend(fixes_from_truth(&truth, &glimpses));
        // Stable: at one instant the wheels come before the camera.
        observations.sort_by_key(|observation| observation.stamp);
    }
    run.observations.clear();
    Ok(TuneRun { name: run.name.clone(), set, observations, config, reference: RunReference::Recorded(Box::new(run)) })
}

fn simulated(args: &TuneArgs, asked: &str) -> Result<TuneDataset> {
    let scenario = drives::load_scenario(asked)?.1.with_seed(args.seed);
    let robot = RobotFile { name: format!("simulated, {asked}"), ..RobotFile::default() };
    let drives = (0..2 * args.runs).map(|run| {
        let set = if run < args.runs { RunSet::Training } else { RunSet::HeldOut };
        run_from_drive(&scenario.drive(run), format!("run {run}"), set)
    });
    let runs: Vec<TuneRun> = drives.collect();
    let used_geometry = runs.first().map(|run| run.config.geometry);
    let robot = used_geometry.map_or(robot.clone(), |geometry| RobotFile {
        left_wheel_radius_m: geometry.left_wheel_radius.0,
        right_wheel_radius_m: geometry.right_wheel_radius.0,
        track_width_m: geometry.track_width.0,
        ticks_per_turn: std::f64::consts::TAU / geometry.tick.0,
        ..robot
    });
    Ok(TuneDataset { runs, robot, source: format!("sim {asked}, seed {}", args.seed) })
}

fn run_from_drive(drive: &Drive, name: String, set: RunSet) -> TuneRun {
    let arrivals = drive.arrivals.iter();
    TuneRun {
        name,
        set,
        observations: arrivals.map(|arrival| arrival.observation).collect(),
        config: filter_config(&drive.prior),
        reference: RunReference::Simulated(Box::new(known_drive(drive))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Cli, Command};
    use clap::Parser as _;

    const WHEELS: &str = r#"
source = "written by this test"
licence = "-"

[robot]
left_wheel_radius_m = 0.1
right_wheel_radius_m = 0.1
track_width_m = 0.2
ticks_per_turn = 360.0

[files.wheels]
path = "wheels.csv"
header_lines = 1
time = { column = "t_s" }

[[wheels]]
file = "wheels"
counting = "absolute"
left = { column = "left", unit = "ticks" }
right = { column = "right", unit = "ticks" }
"#;

    #[test]
    fn the_robot_is_that_of_the_runs_that_were_tuned_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        std::fs::write(path("wheels.csv"), "t_s,left,right\n0,0,0\n1,9,9\n2,18,18\n").unwrap();
        for (name, sigma) in [("held", 0.01), ("trained", 0.02)] {
            let known = format!("[robot.calibration]\ntrack_scale = {{ value = 0.0, sigma = {sigma} }}\n");
            let run = format!("name = \"{name}\"\ndefault_run = \"{name}\"\n");
            let text = run + WHEELS + &known + &format!("[[runs]]\nname = \"{name}\"\n");
            std::fs::write(path(&format!("{name}.toml")), text).unwrap();
        }
        let (held, trained) = (path("held.toml"), path("trained.toml"));
        let data = folder.path().display().to_string();
        let line = [
            "posebridge",
            "tune",
            "--data",
            &data,
            "--hold-out",
            "held",
            "--recording",
            &held,
            "--recording",
            &trained,
        ];
        let Some(Command::Tune(args)) = Cli::try_parse_from(line).unwrap().command else {
            panic!("tune was asked for")
        };
        let material = TuneDataset::load(&args).unwrap();
        let sets: Vec<RunSet> = material.runs.iter().map(|run| run.set).collect();
        assert_eq!(sets, [RunSet::HeldOut, RunSet::Training]);
        assert_eq!(material.robot.calibration.track_scale.sigma, 0.02);
    }
}

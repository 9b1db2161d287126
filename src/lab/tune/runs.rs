//! The flags of `posebridge tune`, and the runs that they choose: training runs and withheld ones.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use posebridge_estimator::{Filter, FilterConfig, FilterEntry};
use posebridge_lab::accuracy::{ReferenceDrive, run_drive, score};
use posebridge_lab::statistics::RunningMean;
use posebridge_lab::tuning::{
    RunFit, SyntheticFixes, TimeBlocks, fit_in_blocks, fit_run, fixes_from_truth, offline_params,
};
use posebridge_recording::dataset::{DatasetRun, WithheldFix};
use posebridge_report::metrics::{add_to_tallies, summarise};
use posebridge_report::{PoseError, SourceTally};
use posebridge_sim::montecarlo::Drive;
use posebridge_telemetry::{BrickClock, Calibration, Estimate, Observation, ObservationKind, TimeDelta, Timestamp};

use crate::config::{RobotFile, Setting};
use crate::flags::DataFlags;
use crate::lab::drives::{self, filter_config, known_drive};
use crate::lab::source::{self, SourceRun, check_same_robot};
use crate::tools::dataset::DataSet;
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;
use crate::tools::score::{EstimateSource, Scorer};

/// Flags of `tune`.
#[derive(clap::Args, Clone, Debug)]
pub struct TuneArgs {
    /// Descriptor (config/recordings/*.toml), or recording (*.mcap), which is one run named after its file. Can be repeated.
    #[arg(long = "recording", value_name = "FILE", required_unless_present = "sim")]
    pub recordings: Vec<PathBuf>,
    /// Tune on the runs whose names begin with this text. Can be repeated. Default: the usual runs of the descriptor.
    #[arg(long = "run", value_name = "PREFIX")]
    pub run: Vec<String>,
    /// Held-out runs, by the beginning of their names. If the tuned parameters are worse on them, the initial ones are kept. Can
    /// be repeated.
    #[arg(long = "hold-out", value_name = "PREFIX")]
    pub hold_out: Vec<String>,
    /// Folder for the relative paths of a descriptor. Default: POSEBRIDGE_DATA, or else the descriptor's folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Give the filter every n-th fix and score it on the others. Default: as in the descriptor.
    #[arg(long, value_name = "N")]
    pub use_every: Option<usize>,
    /// Set one key of the robot or one parameter of the filter before tuning, as in `replay`, or one key of the configuration of
    /// a posebridge recording. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
    /// For recordings without fixes: give the filter a position from the ground truth at this interval, in seconds, with the
    /// noise noise.fix_position_m.
    #[arg(long, value_name = "SECONDS", group = "drawn")]
    pub fixes_from_truth: Option<f64>,
    /// Tune on simulated drives instead: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", group = "drawn", conflicts_with_all = ["recordings", "run", "hold_out", "use_every", "settings"])]
    pub sim: Option<String>,
    /// Number of simulated drives to tune on. The same number is held out.
    #[arg(long, value_name = "N", default_value_t = 4, conflicts_with = "recordings", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub runs: u32,
    /// Parameter to tune: a key of [robot.noise], or filter.KEY. Can be repeated. Default: all parameters that the data
    /// determine.
    #[arg(long = "param", value_name = "KEY")]
    pub params: Vec<String>,
    /// The filter.
    #[arg(long, value_name = "NAME", default_value = "pose")]
    pub filter: String,
    /// Start with the parameters wrong by this factor, as an exercise.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub start_factor: f64,
    /// Seed of the simulated drives and of the noise of fixes from the ground truth.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drawn")]
    pub seed: u64,
    /// Write a robot profile with the tuned noise, for `run --robot` and `replay --robot`.
    #[arg(long, value_name = "FILE.toml")]
    pub out_profile: Option<PathBuf>,
    /// What to leave.
    #[command(flatten)]
    pub output: OutputArgs,
}

/// All runs, of one robot, and that robot as described by the first training run.
pub(super) struct TuneDataset {
    pub(super) runs: Vec<TuneRun>,
    pub(super) robot: RobotFile,
    /// Origin of the runs, for the profile.
    pub(super) source: String,
}

impl TuneDataset {
    /// Reads recordings or simulates drives.
    pub(super) fn load(args: &TuneArgs) -> Result<Self> {
        let material = match &args.sim {
            Some(requested) => simulated(args, requested)?,
            None => recorded(args)?,
        };
        ensure!(material.training().next().is_some(), "no run is left to tune on: --hold-out takes them all");
        Ok(material)
    }

    pub(super) fn training(&self) -> impl Iterator<Item = &TuneRun> {
        self.runs.iter().filter(|run| run.set == RunSet::Training)
    }
}

fn recorded(args: &TuneArgs) -> Result<TuneDataset> {
    let mut runs: Vec<TuneRun> = Vec::new();
    let mut robot = None;
    let sources = args.recordings.iter().map(|path| Ok((path, run_names(args, path)?)));
    let sources: Vec<(&PathBuf, RunNames)> = sources.collect::<Result<_>>()?;
    let known: Vec<&str> = sources.iter().flat_map(|(_, names)| &names.all).map(String::as_str).collect();
    for prefix in args.run.iter().chain(&args.hold_out) {
        // Probably a typing error.
        ensure!(
            known.iter().any(|name| name.starts_with(prefix.as_str())),
            "no run begins with `{prefix}`; there are: {}",
            known.join(", ")
        );
    }
    for (path, RunNames { all, usual }) in &sources {
        let named = |prefixes: &[String]| -> Vec<&String> {
            all.iter().filter(|name| prefixes.iter().any(|prefix| name.starts_with(prefix.as_str()))).collect()
        };
        let held_out = named(&args.hold_out);
        let mut trained = if args.run.is_empty() { usual.iter().collect() } else { named(&args.run) };
        trained.retain(|name| !held_out.contains(name));
        let trained = trained.into_iter().map(|name| (name, RunSet::Training));
        for (name, set) in trained.chain(held_out.into_iter().map(|name| (name, RunSet::HeldOut))) {
            let loaded = source::load_run(path, Some(name), &run_flags(args, path, name))?;
            if set == RunSet::Training {
                robot.get_or_insert(loaded.robot.clone());
            }
            runs.push(run_from_source(args, path, loaded, set)?);
        }
    }
    check_same_robot(runs.iter().map(|run| (run.name.as_str(), &run.config.geometry)))?;
    let paths: Vec<String> = args.recordings.iter().map(|path| path.display().to_string()).collect();
    Ok(TuneDataset { runs, robot: robot.unwrap_or_default(), source: paths.join(", ") })
}

fn flags(args: &TuneArgs) -> DataFlags {
    DataFlags { data: args.data.clone(), run: None, use_every: args.use_every, settings: args.settings.clone() }
}

/// Of a recording, `--use-every` chooses later.
fn run_flags(args: &TuneArgs, path: &Path, name: &str) -> DataFlags {
    if own_recording::is_own(path) {
        return DataFlags { use_every: None, ..flags(args) };
    }
    DataFlags { run: Some(name.to_owned()), ..flags(args) }
}

struct RunNames {
    all: Vec<String>,
    /// The default runs of a descriptor.
    usual: Vec<String>,
}

fn run_names(args: &TuneArgs, path: &Path) -> Result<RunNames> {
    if own_recording::is_own(path) {
        let only = vec![path.display().to_string()];
        return Ok(RunNames { all: only.clone(), usual: only });
    }
    let data = DataSet::open(path, &flags(args))?;
    Ok(RunNames { all: data.descriptor.runs, usual: data.runs })
}

/// Of a recording, the fixes between every `--use-every`th are withheld for the score.
fn run_from_source(args: &TuneArgs, path: &Path, loaded: SourceRun, set: RunSet) -> Result<TuneRun> {
    let SourceRun { name, config, mut observations, dataset: mut run, .. } = loaded;
    if own_recording::is_own(path) {
        ensure!(
            args.fixes_from_truth.is_none(),
            "`{name}` has no truth for --fixes-from-truth: recordings of ours are tuned by the fixes of their camera"
        );
        (observations, run.withheld) = split(&observations, args.use_every.unwrap_or(1));
    }
    if let Some(every_s) = args.fixes_from_truth {
        ensure!(
            every_s.is_finite() && every_s > 0.0,
            "--fixes-from-truth is {every_s}, must be a number of seconds of more than zero"
        );
        ensure!(!run.truth.is_empty(), "run `{name}` has no truth for --fixes-from-truth");
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
    Ok(TuneRun { name, set, observations, config, reference: RunReference::Recorded(Box::new(run)) })
}

fn simulated(args: &TuneArgs, requested: &str) -> Result<TuneDataset> {
    let scenario = drives::load_scenario(requested)?.1.with_seed(args.seed);
    let robot = RobotFile { name: format!("simulated, {requested}"), ..RobotFile::default() };
    let drives = (0..2 * args.runs).map(|run| {
        let set = if run < args.runs { RunSet::Training } else { RunSet::HeldOut };
        run_from_drive(&scenario.drive(run), format!("run {run}"), set)
    });
    let runs: Vec<TuneRun> = drives.collect::<Result<_>>()?;
    let used_geometry = runs.first().map(|run| run.config.geometry);
    let robot = used_geometry.map_or(robot.clone(), |geometry| robot.with_geometry(&geometry));
    Ok(TuneDataset { runs, robot, source: format!("sim {requested}, seed {}", args.seed) })
}

fn run_from_drive(drive: &Drive, name: String, set: RunSet) -> Result<TuneRun> {
    let arrivals = drive.arrivals.iter();
    Ok(TuneRun {
        name,
        set,
        observations: arrivals.map(|arrival| arrival.observation).collect(),
        config: filter_config(&drive.prior)?,
        reference: RunReference::Simulated(Box::new(known_drive(drive))),
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RunSet {
    Training,
    HeldOut,
}

pub(super) enum RunReference {
    Recorded(Box<DatasetRun>),
    Simulated(Box<ReferenceDrive>),
}

pub(super) struct TuneRun {
    pub(super) name: String,
    pub(super) set: RunSet,
    pub(super) observations: Vec<Observation>,
    pub(super) config: FilterConfig,
    pub(super) reference: RunReference,
}

pub(super) struct RunScore {
    pub(super) name: String,
    pub(super) set: RunSet,
    /// As in the search: with the filter's adaptation disabled.
    pub(super) fit: RunFit,
    /// Of the online filter, against truth or withheld fixes.
    pub(super) position_rms_m: Option<f64>,
    /// Of the online filter.
    pub(super) sources: Vec<SourceTally>,
}

impl TuneRun {
    /// Likelihood of the run, with the filter's adaptation disabled.
    pub(super) fn fit(&self, entry: &FilterEntry, mut config: FilterConfig) -> RunFit {
        config.params = offline_params(config.params);
        fit_run(&self.observations, (entry.build)(&config).as_mut())
    }

    pub(super) fn fit_in_blocks(
        &self,
        entry: &FilterEntry,
        mut config: FilterConfig,
        blocks: &TimeBlocks,
    ) -> Vec<RunFit> {
        config.params = offline_params(config.params);
        fit_in_blocks(&self.observations, (entry.build)(&config).as_mut(), blocks)
    }

    /// Squared position errors of the online filter, m², for each time block; empty without known positions.
    pub(super) fn squares_in_blocks(
        &self,
        entry: &FilterEntry,
        config: &FilterConfig,
        blocks: &TimeBlocks,
    ) -> Vec<RunningMean> {
        let mut live = (entry.build)(config);
        let mut squares = vec![RunningMean::default(); blocks.count()];
        let mut add = |stamp, error: &PoseError| {
            if let Some(squares) = squares.get_mut(blocks.index(stamp)) {
                squares.add(error.position_m().powi(2));
            }
        };
        match &self.reference {
            RunReference::Simulated(known) => {
                run_drive(
                    known,
                    live.as_mut(),
                    |_, _| (),
                    |_, truth, estimate| {
                        if let Some(estimate) = estimate.filter(|estimate| estimate.validity.position) {
                            add(truth.time, &PoseError::of_estimate(estimate, truth.pose));
                        }
                    },
                );
            }
            RunReference::Recorded(run) => {
                let mut scorer = Scorer::new(run, &config.calibration);
                for observation in &self.observations {
                    live.observe(observation);
                    let scored_count = scorer.errors.len();
                    scorer.on_observation(&observation.measurement, observation.stamp, &FilterEstimates(&*live));
                    for error in scorer.errors.iter().skip(scored_count) {
                        add(observation.stamp, error);
                    }
                }
            }
        }
        squares
    }

    /// Likelihood as in the search, and error of the online filter.
    pub(super) fn score(&self, entry: &FilterEntry, config: FilterConfig) -> RunScore {
        let mut live = (entry.build)(&config);
        let (position_rms_m, sources) = match &self.reference {
            RunReference::Simulated(known) => {
                let score = score(known, live.as_mut());
                (score.position_rms_m(), score.sources)
            }
            RunReference::Recorded(run) => self.score_against(run, &config.calibration, live.as_mut()),
        };
        RunScore { name: self.name.clone(), set: self.set, fit: self.fit(entry, config), position_rms_m, sources }
    }

    fn score_against(
        &self,
        run: &DatasetRun,
        prior: &Calibration,
        live: &mut dyn Filter,
    ) -> (Option<f64>, Vec<SourceTally>) {
        let mut scorer = Scorer::new(run, prior);
        let mut sources = Vec::new();
        for observation in &self.observations {
            add_to_tallies(&mut sources, &live.observe(observation));
            scorer.on_observation(&observation.measurement, observation.stamp, &FilterEstimates(&*live));
        }
        scorer.finish(&FilterEstimates(&*live));
        (summarise(&scorer.errors).position_rms_m, sources)
    }
}

/// Adapts a filter to the scoring interface.
struct FilterEstimates<'a>(&'a dyn Filter);

impl EstimateSource for FilterEstimates<'_> {
    fn estimate_at(&self, stamp: Timestamp<BrickClock>) -> Option<Estimate> {
        self.0.estimate_at(stamp)
    }
    fn calibration(&self) -> Option<Calibration> {
        self.0.calibration()
    }
    fn latest(&self) -> Option<Timestamp<BrickClock>> {
        self.0.latest_time()
    }
}

/// Splits off withheld fixes: all but the first of `every` fixes; all for zero.
fn split(observations: &[Observation], every: usize) -> (Vec<Observation>, Vec<WithheldFix>) {
    let mut shown = Vec::new();
    let mut withheld = Vec::new();
    let mut fixes = 0_usize;
    for observation in observations {
        let ObservationKind::Fix(fix) = observation.measurement else {
            shown.push(*observation);
            continue;
        };
        if every > 0 && fixes.is_multiple_of(every) {
            shown.push(*observation);
        } else {
            withheld.push(WithheldFix { time: observation.stamp, fix });
        }
        fixes += 1;
    }
    withheld.sort_by_key(|withheld| withheld.time);
    (shown, withheld)
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;
    use crate::cli::{Cli, Command};

    const WHEELS: &str = concat!(
        "source = \"written by this test\"\nlicence = \"-\"\n\n[robot]\nleft_wheel_radius_m = 0.1\nright_wheel_radius_m = 0.1\n",
        "track_width_m = 0.2\nticks_per_turn = 360.0\n",
        include_str!("../../../tests/data/wheels-csv.toml")
    );

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

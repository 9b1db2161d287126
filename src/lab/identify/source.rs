//! What is looked at: a run of a recording, a live robot that is recorded first, or a simulated drive whose truth is known.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_sim::montecarlo::Scenario;
use posebridge_telemetry::{DriveGeometry, Observation};

use crate::config::{Overlay, Setting};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::drives;
use crate::lab::experiments::live::{LiveArgs, LiveRobot};
use crate::tools::dataset::{DataSet, report_bad_rows};
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;

/// The source of an experiment's drive without `--recording`.
pub(super) struct ExperimentSource {
    /// The instructions for a person with a live robot.
    instruction: &'static str,
    /// What is simulated without a robot.
    scenario: &'static str,
}

/// A rest.
pub(super) const REST: ExperimentSource = ExperimentSource {
    instruction: "leave the robot standing, its motors off; ten minutes tell the walk of a gyro's bias, too",
    scenario: include_str!("scenarios/rest.toml"),
};
/// A straight run.
pub(super) const STRAIGHT: ExperimentSource = ExperimentSource {
    instruction: "drive the robot straight on at an even speed; --from and --to cut off how it starts and stops",
    scenario: include_str!("scenarios/straight.toml"),
};
/// A delay.
pub(super) const DELAY: ExperimentSource = ExperimentSource {
    instruction: "let the robot turn to and fro before the camera for half a minute",
    scenario: include_str!("scenarios/delay.toml"),
};

/// By which instant a fix is taken for seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum FixTimeSource {
    /// By its stamp.
    Stamp,
    /// By its arrival.
    Arrival,
}

/// Flags that say what to look at.
#[derive(clap::Args, Clone, Debug)]
pub struct SourceArgs {
    /// A recording's descriptor (config/recordings/*.toml) or a recording (*.mcap); without it a simulated drive.
    #[arg(long, value_name = "FILE", group = "real_robot")]
    pub recording: Option<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Which run of a descriptor: the first whose name begins so.
    #[arg(long, value_name = "PREFIX", requires = "recording")]
    pub run: Option<String>,
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Set one key of the robot's table, as for `replay`, or of the configuration of a recording of ours; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real_robot")]
    pub settings: Vec<Setting>,
    /// Simulate this instead of the bundled experiment: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "real_robot")]
    pub sim: Option<String>,
    /// Seed of a simulated drive.
    #[arg(long, value_name = "N", default_value_t = 1, conflicts_with = "real_robot")]
    pub seed: u64,
    /// Use data from this number of seconds after the first observation on.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,
    /// Use data up to this number of seconds after the first observation.
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
}

/// An observation and when it arrived.
pub(super) struct ArrivedObservation {
    /// By the clock of the stamps; `None` where it is unknown.
    pub(super) arrival_s: Option<f64>,
    pub(super) observation: Observation,
}

/// The data of the run.
pub(super) struct ExperimentData {
    pub(super) name: String,
    pub(super) observations: Vec<ArrivedObservation>,
    pub(super) geometry: DriveGeometry,
    /// What is true, of a simulated drive.
    pub(super) scenario: Option<Scenario>,
}

impl SourceArgs {
    /// Records the live robot, telling its person what to do, reads the recording, or draws the drive.
    ///
    /// # Errors
    /// It cannot be recorded or read, makes no sense, or nothing lies between --from and --to.
    pub(super) fn read(&self, experiment: &ExperimentSource, output: &OutputArgs) -> Result<ExperimentData, Failure> {
        let robot = LiveRobot { file: None, settings: &self.settings };
        if let Some(live) = self.live.record(output, robot, experiment.instruction)? {
            // The keys that are set stand in the recording.
            return read_own(&live, &[]).and_then(|data| self.crop(data)).while_running();
        }
        let data = match &self.recording {
            Some(path) if own_recording::is_own(path) => self.load_own(path),
            Some(path) => self.load_descriptor(path),
            None => self.simulate(experiment.scenario),
        };
        data.and_then(|data| self.crop(data)).before_start()
    }

    /// As far as --from and --to let it.
    fn crop(&self, mut data: ExperimentData) -> Result<ExperimentData> {
        let first_s =
            data.observations.iter().map(|one| one.observation.stamp.as_secs_f64()).fold(f64::INFINITY, f64::min);
        let until_s = self.to.unwrap_or(f64::INFINITY);
        ensure!(self.from < until_s, "--from is {} and --to is {until_s}: nothing lies between them", self.from);
        data.observations.retain(|one| {
            let at_s = one.observation.stamp.as_secs_f64() - first_s;
            self.from <= at_s && at_s <= until_s
        });
        ensure!(!data.observations.is_empty(), "no observation of `{}` lies between --from and --to", data.name);
        Ok(data)
    }

    fn load_own(&self, path: &Path) -> Result<ExperimentData> {
        ensure!(
            self.run.is_none(),
            "--run chooses from a descriptor's data; `{}` is a recording of ours",
            path.display()
        );
        read_own(path, &self.settings)
    }

    fn load_descriptor(&self, path: &Path) -> Result<ExperimentData> {
        let flags = DataFlags {
            data: self.data.clone(),
            run: self.run.clone(),
            // Every fix is looked at: none needs to be withheld.
            use_every: Some(1),
            settings: self.settings.clone(),
        };
        let data = DataSet::open(path, &flags)?;
        let name = data.runs.first().context("the descriptor has no run")?;
        let loaded = data.load(name, &flags)?;
        report_bad_rows(&loaded);
        let timed = loaded.run.observations.iter();
        Ok(ExperimentData {
            name: loaded.run.name.clone(),
            observations: timed
                .map(|timed| ArrivedObservation {
                    arrival_s: Some(timed.arrival.as_secs_f64()),
                    observation: timed.observation,
                })
                .collect(),
            geometry: loaded.filter_config.geometry,
            scenario: None,
        })
    }

    fn simulate(&self, bundled: &str) -> Result<ExperimentData> {
        let (name, scenario) = match &self.sim {
            None => ("bundled experiment".to_owned(), Scenario::from_toml(bundled)?),
            Some(asked) => drives::load_scenario(asked)?,
        };
        let scenario = scenario.with_seed(self.seed);
        let drive = scenario.drive(0);
        let arrivals = drive.arrivals.iter();
        Ok(ExperimentData {
            name: format!("{name}, seed {}", self.seed),
            observations: arrivals
                .map(|arrival| ArrivedObservation {
                    arrival_s: Some(drive.time_at(arrival.step).as_secs_f64()),
                    observation: arrival.observation,
                })
                .collect(),
            geometry: drive.prior.geometry,
            scenario: Some(scenario),
        })
    }
}

fn read_own(path: &Path, settings: &[Setting]) -> Result<ExperimentData> {
    let overlay = Overlay { robot: None, settings };
    let run = own_recording::read(path, overlay)?;
    let arrived = run.observations.iter().enumerate().map(|(index, observation)| {
        let arrivals = run.arrivals.as_ref();
        ArrivedObservation {
            arrival_s: arrivals.and_then(|all| Some(all.get(index)?.as_secs_f64())),
            observation: *observation,
        }
    });
    Ok(ExperimentData {
        observations: arrived.collect(),
        geometry: run.config.geometry,
        name: run.name,
        scenario: None,
    })
}

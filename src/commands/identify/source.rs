//! What is looked at: a run of a recording, or a simulated drive whose truth is known.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_sim::montecarlo::Scenario;
use posebridge_telemetry::{DriveGeometry, Observation};

use crate::cli::DataFlags;
use crate::config::Setting;
use crate::data::{DataSet, tell_bad_rows};
use crate::drawn;

/// What the experiments look at without a recording.
pub(super) const REST: &str = include_str!("scenarios/rest.toml");
/// The same for a straight run.
pub(super) const STRAIGHT: &str = include_str!("scenarios/straight.toml");
/// The same for a delay.
pub(super) const DELAY: &str = include_str!("scenarios/delay.toml");

/// By which instant a fix is taken for seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Clock {
    /// By its stamp.
    Stamp,
    /// By its arrival.
    Arrival,
}

/// Flags that say what to look at.
#[derive(clap::Args, Clone, Debug)]
pub struct SourceArgs {
    /// A recording's descriptor (config/recordings/*.toml); without it a simulated drive.
    #[arg(long, value_name = "FILE.toml")]
    pub recording: Option<PathBuf>,
    /// Which run of it: the first whose name begins so.
    #[arg(long, value_name = "PREFIX", requires = "recording")]
    pub run: Option<String>,
    /// Where a descriptor's relative paths start; else POSEBRIDGE_DATA, else the descriptor's own folder.
    #[arg(long, value_name = "DIR", env = "POSEBRIDGE_DATA")]
    pub data: Option<PathBuf>,
    /// Set one key of the robot's table, as for `replay`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse)]
    pub settings: Vec<Setting>,
    /// Simulate this instead of the bundled experiment: a scenario of `lab accuracy`, or a TOML file.
    #[arg(long, value_name = "NAME|FILE.toml", conflicts_with = "recording")]
    pub sim: Option<String>,
    /// Seed of a simulated drive.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Look from so many seconds after the first observation on.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub from: f64,
    /// Look no further than so many seconds after the first observation.
    #[arg(long, value_name = "SECONDS")]
    pub to: Option<f64>,
}

/// An observation and when it arrived.
pub(super) struct Arrived {
    pub(super) arrival_s: f64,
    pub(super) observation: Observation,
}

/// What was seen.
pub(super) struct Seen {
    pub(super) name: String,
    pub(super) arrived: Vec<Arrived>,
    pub(super) geometry: DriveGeometry,
    /// What is true, of a simulated drive.
    pub(super) scenario: Option<Scenario>,
}

impl SourceArgs {
    /// Reads the recording or draws the drive.
    ///
    /// # Errors
    /// It cannot be read or makes no sense, or nothing lies between --from and --to.
    pub(super) fn read(&self, bundled: &str) -> Result<Seen> {
        let mut seen = match &self.recording {
            Some(path) => self.recorded(path)?,
            None => self.simulated(bundled)?,
        };
        let first_s = seen
            .arrived
            .iter()
            .map(|one| one.observation.stamp.as_secs_f64())
            .fold(f64::INFINITY, f64::min);
        let until_s = self.to.unwrap_or(f64::INFINITY);
        ensure!(
            self.from < until_s,
            "--from is {} and --to is {until_s}: nothing lies between them",
            self.from
        );
        seen.arrived.retain(|one| {
            let at_s = one.observation.stamp.as_secs_f64() - first_s;
            self.from <= at_s && at_s <= until_s
        });
        ensure!(
            !seen.arrived.is_empty(),
            "no observation of `{}` lies between --from and --to",
            seen.name
        );
        Ok(seen)
    }

    fn recorded(&self, path: &Path) -> Result<Seen> {
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
        tell_bad_rows(&loaded);
        let timed = loaded.run.observations.iter();
        Ok(Seen {
            name: loaded.run.name.clone(),
            arrived: timed
                .map(|timed| Arrived {
                    arrival_s: timed.arrival.as_secs_f64(),
                    observation: timed.observation,
                })
                .collect(),
            geometry: loaded.filter_config.geometry,
            scenario: None,
        })
    }

    fn simulated(&self, bundled: &str) -> Result<Seen> {
        let (name, scenario) = match &self.sim {
            None => (
                "bundled experiment".to_owned(),
                Scenario::from_toml(bundled)?,
            ),
            Some(asked) => drawn::scenario(asked)?,
        };
        let scenario = scenario.with_seed(self.seed);
        let drive = scenario.drive(0);
        let arrivals = drive.arrivals.iter();
        Ok(Seen {
            name: format!("{name}, seed {}", self.seed),
            arrived: arrivals
                .map(|arrival| Arrived {
                    arrival_s: drive.stamp(arrival.step).as_secs_f64(),
                    observation: arrival.observation,
                })
                .collect(),
            geometry: drive.told.geometry,
            scenario: Some(scenario),
        })
    }
}

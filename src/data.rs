//! Recordings of real robots as the commands need them: descriptor, robot, runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use posebridge_estimator::{FilterConfig, StartPose};
use posebridge_recording::dataset::{self, Descriptor, LoadOptions};
use posebridge_telemetry::World;

use crate::cli::DataFlags;
use crate::config::{FilterSection, ProfileFilter, RobotFile, Setting, filter_config};
use crate::stderr::say;

/// A descriptor with the runs that were asked for.
pub struct DataSet {
    /// The descriptor.
    pub descriptor: Descriptor,
    /// Names of the runs.
    pub runs: Vec<String>,
    root: PathBuf,
}

/// One run with the robot that made it.
pub struct RobotRun {
    /// What was recorded.
    pub run: dataset::Run,
    /// The robot, as the descriptor and the flags describe it.
    pub robot: RobotFile,
    /// The robot's filter configuration, start included.
    pub filter_config: FilterConfig,
}

impl DataSet {
    /// Reads a descriptor and chooses its runs.
    ///
    /// # Errors
    /// The file cannot be read or makes no sense, or no run has such a name.
    pub fn open(path: &Path, flags: &DataFlags) -> Result<Self> {
        let name = path.display();
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("reading the descriptor `{name}`"))?;
        let descriptor =
            Descriptor::from_toml(&text).with_context(|| format!("descriptor `{name}`"))?;
        let prefix = flags
            .run
            .clone()
            .unwrap_or_else(|| descriptor.default_run.clone());
        let runs: Vec<String> = descriptor
            .select(&prefix)
            .into_iter()
            .map(str::to_owned)
            .collect();
        if runs.is_empty() {
            bail!(
                "no run of `{name}` begins with `{prefix}`; there are: {}",
                descriptor.runs.join(", ")
            );
        }
        let own_folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Ok(Self {
            descriptor,
            runs,
            root: flags.data.clone().unwrap_or(own_folder),
        })
    }

    /// Loads one run.
    ///
    /// # Errors
    /// A file is missing or a column is not there, or the robot's table makes no sense.
    pub fn load(&self, run: &str, flags: &DataFlags) -> Result<RobotRun> {
        let (robot, filter) = self.robot_and_filter(run, &flags.settings)?;
        let geometry = robot.geometry()?;
        let options = LoadOptions {
            run,
            geometry,
            use_every: flags.use_every,
        };
        let mut open = |relative: &Path| std::fs::read(self.root.join(relative));
        let run = dataset::load(&self.descriptor, options, &mut open).with_context(|| {
            format!(
                "recording `{}` in `{}`",
                self.descriptor.name,
                self.root.display()
            )
        })?;
        ensure!(
            !run.observations.is_empty(),
            "run `{}` holds no observation",
            run.name
        );
        let mut config = filter_config(&robot, &filter, world_of(&run))?;
        let start = run.start.map(|start| StartPose {
            pose: start.pose,
            position_sigma_m: start.position_sigma_m,
            heading_sigma_rad: start.heading_sigma_rad,
        });
        config.start = start.or(config.start);
        Ok(RobotRun {
            run,
            robot,
            filter_config: config,
        })
    }

    /// The robot and the tunables of a run, with the flags laid over them.
    fn robot_and_filter(
        &self,
        run: &str,
        settings: &[Setting],
    ) -> Result<(RobotFile, FilterSection)> {
        let robot: RobotFile = self
            .descriptor
            .robot_for(run)
            .try_into()
            .with_context(|| format!("robot of run `{run}`"))?;
        let tunables: ProfileFilter = self
            .descriptor
            .filter
            .clone()
            .try_into()
            .context("[filter]")?;
        let is_name = |setting: &Setting| setting.path == ["filter", "name"];
        ensure!(
            tunables.name.is_none() && !settings.iter().any(is_name),
            "`filter.name` does not belong to a recording: choose the filter with --filter"
        );
        let filter = FilterSection {
            params: tunables.params,
            ..FilterSection::default()
        };
        let mut all = toml::Table::try_from(&robot)?;
        let mut tunables = toml::Table::try_from(&filter)?;
        for setting in settings {
            let failed = |why: String| anyhow!("`--set {setting}`: {why}");
            match setting.path.split_first() {
                Some((section, key)) if section == "filter" => Setting {
                    path: key.to_vec(),
                    value: setting.value.clone(),
                }
                .lay_over(&mut tunables)
                .map_err(failed)?,
                _ => setting.lay_over(&mut all).map_err(failed)?,
            }
        }
        let robot = all
            .try_into()
            .with_context(|| format!("robot of run `{run}`"))?;
        let filter = tunables.try_into().context("[filter]")?;
        Ok((robot, filter))
    }
}

/// The places that a recording tells.
fn world_of(run: &dataset::Run) -> World {
    World {
        landmarks: run.landmarks.iter().copied().collect(),
        beacons: run.beacons.iter().copied().collect(),
        walls: Vec::new(),
    }
}

/// Names the rows that could not be used; they are counted and do not end the run.
pub fn tell_bad_rows(robot_run: &RobotRun) -> u64 {
    let bad = &robot_run.run.bad_rows;
    for row in &bad.named {
        say(&format!("{}: {row}", robot_run.run.name));
    }
    for (reason, count) in &bad.counts {
        say(&format!(
            "{}: {count} rows: {}",
            robot_run.run.name,
            reason.name()
        ));
    }
    bad.total() as u64
}

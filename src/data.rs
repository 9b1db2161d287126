//! Recordings of real robots as the commands need them: descriptor, robot, runs.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use posebridge_estimator::{FilterConfig, Params, StartPose};
use posebridge_recording::dataset::{self, Descriptor, LoadOptions};

use crate::cli::DataFlags;
use crate::config::RobotFile;
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
        let mut table = self.descriptor.robot_for(run);
        let mut params = Params::default();
        for setting in &flags.settings {
            if let ([section, key], Some(value)) = (setting.path.as_slice(), number(&setting.value))
                && section == "filter"
            {
                params.set(key, value)?;
                continue;
            }
            setting
                .lay_over(&mut table)
                .map_err(|why| anyhow::anyhow!("`--set {setting}`: {why}"))?;
        }
        let robot: RobotFile = table
            .try_into()
            .with_context(|| format!("robot of run `{run}`"))?;
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
        let start = run.start.map(|start| StartPose {
            pose: start.pose,
            position_sigma_m: start.position_sigma_m,
            heading_sigma_rad: start.heading_sigma_rad,
        });
        let filter_config = FilterConfig {
            geometry,
            noise: robot.noise()?,
            start,
            params,
            calibration: posebridge_telemetry::Calibration::default(),
            world: std::sync::Arc::default(),
        };
        Ok(RobotRun { run, filter_config })
    }
}

fn number(value: &toml::Value) -> Option<f64> {
    value
        .as_float()
        .or(value.as_integer().map(|whole| whole as f64))
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

//! Drives of a real robot for the experiments on a square: recordings of ours, or a live robot that is recorded first.

use std::path::PathBuf;

use anyhow::{Context, Result};
use posebridge_estimator::FilterConfig;
use posebridge_lab::recorded_drive::{DriveEndReference, RecordedDrive};

use super::again;
use super::live::{LiveArgs, LiveRobot};
use crate::config::{Overlay, Setting};
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_all;
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;

/// Flags that choose drives of a real robot.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct RecordedArgs {
    /// Evaluate recordings of a real robot (`posebridge run` writes them), each one drive, instead of simulated drives.
    #[arg(long = "recording", value_name = "FILE.mcap", num_args = 1.., group = "real_robot")]
    pub recordings: Vec<PathBuf>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Who knows where a recorded drive ended; without it the fixes, and the start where there are none.
    #[arg(long, value_enum, requires = "real_robot")]
    pub judge: Option<EndReference>,
    /// The robot, instead of that of the recording or of the simulation: a robot profile, as config/robots/nxt-56mm.toml.
    #[arg(long, value_name = "FILE.toml", requires = "real_robot")]
    pub robot: Option<PathBuf>,
    /// Set one key of the recording's configuration, e.g. robot.track_width_m=0.112; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real_robot")]
    pub settings: Vec<Setting>,
}

/// Who knows where a drive ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum EndReference {
    /// The camera: its fixes are held back from the filters that they score.
    Fixes,
    /// The start: the path was closed.
    Start,
}

impl EndReference {
    const fn end_reference(self) -> DriveEndReference {
        match self {
            Self::Fixes => DriveEndReference::Fixes,
            Self::Start => DriveEndReference::Start,
        }
    }
}

/// One recorded drive.
pub(super) struct RobotDrive {
    /// The file.
    pub(super) name: String,
    pub(super) drive: RecordedDrive,
    /// The configuration of the filters, the start included.
    pub(super) config: FilterConfig,
}

/// Drives of one or of several recordings.
pub(super) struct RobotDrives {
    pub(super) drives: Vec<RobotDrive>,
    is_live: bool,
}

impl RecordedArgs {
    /// Records the live robot, telling it the `task`, or reads the recordings; `None` if neither was asked for.
    ///
    /// # Errors
    /// A recording cannot be made, read or scored; the message names it and says what is missing.
    pub(super) fn drives(&self, output: &OutputArgs, task: &str) -> Result<Option<RobotDrives>, Failure> {
        let robot = LiveRobot { file: self.robot.as_deref(), settings: &self.settings };
        if let Some(recording) = self.live.record(output, robot, task)? {
            // Robot and settings stand in the recording.
            let read = self.read(&[recording], Overlay::default());
            let drives = read.while_running()?;
            let is_live = true;
            return Ok(Some(RobotDrives { drives, is_live }));
        }
        if self.recordings.is_empty() {
            return Ok(None);
        }
        let overlay = Overlay { robot: self.robot.as_deref(), settings: &self.settings };
        let drives = self.read(&self.recordings, overlay).before_start()?;
        let is_live = false;
        Ok(Some(RobotDrives { drives, is_live }))
    }

    fn read(&self, recordings: &[PathBuf], overlay: Overlay<'_>) -> Result<Vec<RobotDrive>> {
        let judge = self.judge.map(EndReference::end_reference);
        let one = |path: &PathBuf| -> Result<RobotDrive> {
            let run = own_recording::read(path, overlay)?;
            let drive = RecordedDrive::new(&run.observations, &run.config, judge)
                .with_context(|| format!("recording `{}`", run.name))?;
            Ok(RobotDrive { config: drive.configure(&run.config), drive, name: run.name })
        };
        let bar = progress_bar(recordings.len() as u64, "recordings")?;
        let read = run_all(recordings, one, || bar.inc(1));
        bar.finish_and_clear();
        read.into_iter().collect()
    }
}

impl RobotDrives {
    /// Says at which stage something failed: a live robot has driven already.
    pub(super) fn with_exit_stage<T>(&self, result: Result<T>) -> Result<T, Failure> {
        if self.is_live { result.while_running() } else { result.before_start() }
    }

    /// The names of the files.
    pub(super) fn names(&self) -> Vec<&str> {
        self.drives.iter().map(|drive| drive.name.as_str()).collect()
    }

    /// The command that gives the same again.
    pub(super) fn command(&self) -> String {
        let live = self.names().first().copied();
        again::rerun_command(live.filter(|_| self.is_live))
    }

    /// The reference, in words for people.
    pub(super) fn reference_name(&self) -> &'static str {
        let is_closed = |drive: &RobotDrive| drive.drive.end_reference == DriveEndReference::Start;
        let closed = self.drives.iter().filter(|drive| is_closed(drive)).count();
        match closed {
            0 => "fixes that no filter was given",
            count if count == self.drives.len() => "the start: every drive is taken to end where it began",
            _ => "fixes that no filter was given, and the start where there are none",
        }
    }
}

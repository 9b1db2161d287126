//! Drives of a real robot for the experiments on a square: posebridge recordings, descriptors of foreign ones, or a live robot that is
//! recorded first.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use posebridge_estimator::FilterConfig;
use posebridge_lab::recorded_drive::{DriveEndReference, RecordedDrive};
use posebridge_telemetry::Observation;

use super::live::LiveArgs;
use crate::config::{Overlay, Setting};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::lab::parallel::run_with_bar;
use crate::tools::dataset::{DataSet, report_bad_rows};
use crate::tools::experiment_output::OutputArgs;
use crate::tools::own_recording;

/// Flags that choose drives of a real robot.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct RecordedArgs {
    /// Evaluate recordings of a real robot from `posebridge run`, one drive each, or descriptors (*.toml) of foreign ones, each run a
    /// drive, instead of simulated drives.
    #[arg(long = "recording", value_name = "FILE", num_args = 1.., group = "real_robot", conflicts_with = "live_robot")]
    pub recordings: Vec<PathBuf>,
    /// Read the runs of a descriptor whose names begin with this text. Default: its default run.
    #[arg(long = "run", value_name = "PREFIX", requires = "recordings")]
    pub run: Option<String>,
    /// A live robot.
    #[command(flatten)]
    pub live: LiveArgs,
    /// Reference for the end of a recorded drive. Default: the camera, or else the start.
    #[arg(long, value_enum, requires = "real_robot")]
    pub judge: Option<EndReference>,
    /// Robot profile to use instead of the robot of the recording or of the simulation, e.g. config/robots/nxt-56mm.toml.
    #[arg(long, value_name = "FILE.toml", requires = "real_robot")]
    pub robot: Option<PathBuf>,
    /// Set one key of the recording's configuration, e.g. robot.track_width_m=0.112. Can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = Setting::parse, requires = "real_robot")]
    pub settings: Vec<Setting>,
}

/// Reference for the end of a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum EndReference {
    /// The camera: its fixes are not given to the filters that they score.
    Fixes,
    /// The start: the path is closed.
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

pub(super) struct RobotDrive {
    pub(super) name: String,
    pub(super) drive: RecordedDrive,
    /// The filter's configuration with the start.
    pub(super) config: FilterConfig,
}

pub(super) struct RobotDrives {
    pub(super) drives: Vec<RobotDrive>,
    is_live: bool,
}

impl RecordedArgs {
    /// Records the live robot after printing `task`, or reads the recordings; `None` if neither was requested.
    /// `data` is the folder of a descriptor's files, by default POSEBRIDGE_DATA, or else the descriptor's own.
    pub(super) fn drives(
        &self,
        output: &OutputArgs,
        task: &str,
        data: Option<&Path>,
    ) -> Result<Option<RobotDrives>, Failure> {
        if let Some(recording) = self.live.record(output, self.robot.as_deref(), &self.settings, task)? {
            // Robot and settings stand in the recording.
            let drives = self.read(&[recording], Overlay::default(), None).while_running()?;
            return Ok(Some(RobotDrives { drives, is_live: true }));
        }
        if self.recordings.is_empty() {
            return Ok(None);
        }
        let overlay = Overlay { robot: self.robot.as_deref(), settings: &self.settings };
        let drives = self.read(&self.recordings, overlay, data).before_start()?;
        Ok(Some(RobotDrives { drives, is_live: false }))
    }

    fn read(&self, recordings: &[PathBuf], overlay: Overlay<'_>, data: Option<&Path>) -> Result<Vec<RobotDrive>> {
        let one = |path: &PathBuf| -> Result<Vec<RobotDrive>> {
            if !own_recording::is_own(path) {
                return self.read_descriptor(path, data);
            }
            ensure!(self.run.is_none(), "--run chooses from a descriptor; `{}` is a recording of ours", path.display());
            let run = own_recording::read(path, overlay)?;
            Ok(vec![self.drive(run.name, &run.observations, &run.config)?])
        };
        let drives = run_with_bar(recordings, "recordings", one)?.into_iter().collect::<Result<Vec<_>>>()?;
        Ok(drives.into_iter().flatten().collect())
    }

    fn read_descriptor(&self, path: &Path, data: Option<&Path>) -> Result<Vec<RobotDrive>> {
        ensure!(self.robot.is_none(), "`{}` describes its robot; change keys of it by --set", path.display());
        let flags = DataFlags {
            data: data.map(Path::to_owned).or_else(|| std::env::var_os("POSEBRIDGE_DATA").map(PathBuf::from)),
            run: self.run.clone(),
            // Which fixes the filters get is chosen by this experiment.
            use_every: Some(1),
            settings: self.settings.clone(),
        };
        let set = DataSet::open(path, &flags)?;
        let one = |name: &String| -> Result<RobotDrive> {
            let loaded = set.load(name, &flags)?;
            report_bad_rows(&loaded);
            let observations: Vec<_> = loaded.run.observations.iter().map(|timed| timed.observation).collect();
            self.drive(format!("{}, {name}", path.display()), &observations, &loaded.filter_config)
        };
        set.runs.iter().map(one).collect()
    }

    fn drive(&self, name: String, observations: &[Observation], config: &FilterConfig) -> Result<RobotDrive> {
        let end_reference = self.judge.map(EndReference::end_reference);
        let drive =
            RecordedDrive::new(observations, config, end_reference).with_context(|| format!("recording `{name}`"))?;
        Ok(RobotDrive { config: drive.configure(config), drive, name })
    }
}

impl RobotDrives {
    /// Assigns the exit stage of an error: a live robot has already driven.
    pub(super) fn with_exit_stage<T>(&self, result: Result<T>) -> Result<T, Failure> {
        if self.is_live { result.while_running() } else { result.before_start() }
    }

    pub(super) fn names(&self) -> Vec<&str> {
        self.drives.iter().map(|drive| drive.name.as_str()).collect()
    }

    /// The command line that reproduces the result.
    pub(super) fn command(&self) -> String {
        let live = self.names().first().copied();
        rerun_command(live.filter(|_| self.is_live))
    }

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

/// Flags of the live recording. The recording contains their effect.
const LIVE_ROBOT_FLAGS: [&str; 6] = ["--link", "--listen", "--duration", "--config", "--robot", "--set"];

/// The output folder, which does not affect a page.
const OUTPUT_FLAG: &str = "--out";
/// The output format; takes no value.
const JSON_FLAG: &str = "--json";

/// The arguments of this process that affect a page, with a live robot replaced by its recording.
pub(super) fn rerun_command(live_recording: Option<&str>) -> String {
    let args = std::env::args_os().skip(1);
    let args: Vec<String> = args.map(|arg| arg.to_string_lossy().into_owned()).collect();
    command_line(&args, live_recording)
}

fn command_line(args: &[String], live_recording: Option<&str>) -> String {
    let mut words = vec!["posebridge".to_owned()];
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        let (flag, has_value) = match arg.split_once('=') {
            Some((flag, _)) => (flag, true),
            None => (arg.as_str(), false),
        };
        let is_of_live = live_recording.is_some() && LIVE_ROBOT_FLAGS.contains(&flag);
        let is_left_out = is_of_live || flag == OUTPUT_FLAG;
        if !is_left_out && flag != JSON_FLAG {
            words.push(quoted(arg));
        }
        if is_left_out && !has_value {
            args.next();
        }
    }
    if let Some(recording) = live_recording {
        words.extend(["--recording".to_owned(), quoted(recording)]);
    }
    words.join(" ")
}

fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_./:=,+@%?".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command_line_of(args: &[&str], live_recording: Option<&str>) -> String {
        let args: Vec<String> = args.iter().map(|arg| (*arg).to_owned()).collect();
        command_line(&args, live_recording)
    }

    #[test]
    fn a_command_is_told_as_it_was_typed_and_fits_through_a_shell() {
        let args = ["lab", "wall", "--out", "o", "--json", "--run", "step one", "--set", "a=it's"];
        assert_eq!(command_line_of(&args, None), r"posebridge lab wall --run 'step one' --set 'a=it'\''s'");
    }

    #[test]
    fn the_recording_takes_the_place_of_the_live_robot() {
        let args = [
            "lab",
            "indirect",
            "--link",
            "tcp://a:1",
            "--judge",
            "start",
            "--duration=6",
            "--set",
            "robot.track_width_m=0.1",
            "--out",
            "o",
        ];
        assert_eq!(
            command_line_of(&args, Some("o/live.mcap")),
            "posebridge lab indirect --judge start --recording o/live.mcap"
        );
    }
}

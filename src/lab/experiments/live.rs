//! A live robot for an experiment: recorded by the engine of `posebridge run`, then evaluated like any other recording.
//!
//! The recording is kept, so that an experiment can be repeated with other flags and without the robot.

use std::path::{Path, PathBuf};

use anyhow::anyhow;
use posebridge_link::ConnectRole;

use crate::config::Setting;
use crate::console::print_line;
use crate::exit::{ExitStage, Failure};
use crate::flags::{ConfigFlags, DashboardFlags, DataFlags, LinkFlag, LinkFlags, positive};
use crate::station::args::RunArgs;
use crate::station::run;
use crate::tools::experiment_output::OutputArgs;

/// File name in the output folder.
const RECORDING: &str = "live.mcap";

/// Flags that let an experiment listen to a live robot. One of the group `real_robot`: recorded data and live ones exclude each
/// other. And of `live_robot`, by itself: how it is recorded is no question about a recording.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct LiveArgs {
    /// Record a live robot first: connect to it on this link (docs/links.md). The recording is live.mcap in the output folder.
    #[arg(long, value_name = "URL", groups = ["real_robot", "live_robot"])]
    pub link: Option<String>,
    /// Record a live robot first: wait for it to connect on this link.
    #[arg(long, value_name = "URL", groups = ["real_robot", "live_robot"])]
    pub listen: Option<String>,
    /// Stop recording the live robot after this number of seconds. Default: at Ctrl-C.
    #[arg(long, value_name = "SECONDS", value_parser = positive, requires = "live_robot")]
    pub duration: Option<f64>,
    /// Configuration of the station that records the live robot. Default: the built-in one.
    #[arg(long, value_name = "FILE", requires = "live_robot")]
    pub config: Option<PathBuf>,
}

impl LiveArgs {
    pub const fn is_requested(&self) -> bool {
        self.link.is_some() || self.listen.is_some()
    }

    /// Prints the instructions and records the robot into the output folder; returns the recording. `None` if no live robot was
    /// requested. `robot` is a profile.
    pub fn record(
        &self,
        output: &OutputArgs,
        robot: Option<&Path>,
        settings: &[Setting],
        task: &str,
    ) -> Result<Option<PathBuf>, Failure> {
        if !self.is_requested() {
            return Ok(None);
        }
        let folder = output.folder()?;
        let recording = folder.join(RECORDING);
        if recording.exists() {
            return Err(anyhow!(
                "`{name}` is there already and is never overwritten: give another folder with --out, or evaluate it with \
                 `--recording {name}`",
                name = recording.display()
            ))
            .before_start();
        }
        let end = self
            .duration
            .map_or_else(|| "Ctrl-C when done".to_owned(), |seconds| format!("it ends after {seconds} s or at Ctrl-C"));
        print_line(&format!("recording `{}`: {task}; {end}", recording.display()));
        let sources = run::record(&self.run_args(folder, robot, settings), RECORDING)?;
        print_line(&format!("heard\n{}", sources.trim_end()));
        Ok(Some(recording))
    }

    /// The recording of the live robot, which is made first, or the one that was named. `data` contains the keys that are set; runs and
    /// fixes can only be selected in a descriptor.
    pub fn or_named(
        &self,
        named: Option<&Path>,
        output: &OutputArgs,
        data: &DataFlags,
        task: &str,
    ) -> Result<PathBuf, Failure> {
        self.reject_data_flags(data)?;
        let live = self.record(output, None, &data.settings, task)?;
        live.or_else(|| named.map(Path::to_owned))
            .ok_or_else(|| anyhow!("name a recording, or give --link or --listen"))
            .before_start()
    }

    /// Rejects selections: a live robot has one run, and all of it is used.
    pub fn reject_data_flags(&self, data: &DataFlags) -> Result<(), Failure> {
        if self.is_requested() && (data.run.is_some() || data.use_every.is_some()) {
            let why = "--run and --use-every choose from a descriptor's data, not from a live robot's";
            return Err(anyhow!(why)).before_start();
        }
        Ok(())
    }

    fn links(&self) -> Vec<LinkFlag> {
        let named = [(&self.link, ConnectRole::Dial), (&self.listen, ConnectRole::Listen)];
        let link_flags = named.into_iter().filter_map(|(url, role)| {
            let url = url.clone()?;
            Some(LinkFlag { url, role })
        });
        link_flags.collect()
    }

    fn run_args(&self, folder: PathBuf, robot: Option<&Path>, settings: &[Setting]) -> RunArgs {
        RunArgs {
            config: ConfigFlags { config: self.config.clone(), settings: settings.to_vec() },
            links: LinkFlags(self.links()),
            robot: robot.map(Path::to_owned),
            out: Some(folder),
            duration: self.duration,
            page: DashboardFlags { no_dashboard: true, ..DashboardFlags::default() },
            ..RunArgs::default()
        }
    }
}

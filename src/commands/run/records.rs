//! What a session writes while it runs: its folder, the recording, the telemetry log.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_link::HostTimer;

use crate::cli::RunArgs;
use crate::config::Config;
use crate::failures::Failures;
use crate::tasks::desk::header;
use crate::tasks::recorder::{Kept, Recorder};
use crate::tasks::tlog_recorder::{TlogRecorder, TlogWritten};

/// What was written down while a session ran.
#[derive(Default)]
pub(super) struct Recorded {
    /// The recordings and what they hold.
    pub(super) inputs: Vec<(PathBuf, Kept)>,
    /// The telemetry log.
    pub(super) tlog: Option<TlogWritten>,
}

pub(super) fn output_folder(args: &RunArgs, config: &Config, timer: &HostTimer) -> Result<PathBuf> {
    let folder = match &args.out {
        Some(folder) => folder.clone(),
        None => Path::new(&config.record.directory).join(format!("run-{}", timer.utc_start() / 1_000)),
    };
    std::fs::create_dir_all(&folder).with_context(|| format!("creating the folder `{}`", folder.display()))?;
    Ok(folder)
}

pub(super) fn start_recorder(
    args: &RunArgs,
    config: &Config,
    timer: &HostTimer,
    path: &Path,
    failures: &mut Failures,
) -> Result<Option<Recorder>> {
    if args.no_record || !config.record.enabled {
        return Ok(None);
    }
    let started = Recorder::start_limited(path, &header(config, timer)?, config.record.limits());
    unless_it_was_made("recording", started, path, failures)
}

/// A file that cannot be begun is told once and costs the exit code, not the run: a robot may steer by us. One that is there
/// already is a slip of who started the run, and cheap to mend before the robot drives.
fn unless_it_was_made<T>(what: &str, started: Result<T>, path: &Path, failures: &mut Failures) -> Result<Option<T>> {
    match started {
        Ok(started) => Ok(Some(started)),
        Err(error) if path.exists() => Err(error),
        Err(error) => {
            let reason = format!("{error:#}");
            tracing::error!(error = reason, "there is no {what}; the run goes on");
            failures.note::<()>(Err(error.context(format!("the {what} is not whole"))));
            Ok(None)
        }
    }
}

/// The telemetry log beside the recording, if it is asked for.
pub(super) fn start_tlog(
    args: &RunArgs,
    config: &Config,
    timer: &HostTimer,
    recording: &Path,
    failures: &mut Failures,
) -> Result<Option<TlogRecorder>> {
    if args.no_record || !(args.tlog || config.record.tlog) {
        return Ok(None);
    }
    let path = recording.with_extension("tlog");
    let links = config.pipeline()?.links;
    let floor_bytes = config.record.limits().floor_bytes;
    let started = TlogRecorder::start(&path, timer.utc_start(), &links, floor_bytes);
    unless_it_was_made("telemetry log", started, &path, failures)
}

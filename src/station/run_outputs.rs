//! What a session writes while it runs: its folder, the recording, the telemetry log.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_link::HostTimer;

use super::args::RunArgs;
use super::deferred_errors::DeferredErrors;
use super::recorder::{Recorder, RecordingTotals};
use super::recording_files::header;
use super::tlog_writer::{TlogRecorder, TlogWritten};
use crate::config::Config;

/// What was written down while a session ran.
#[derive(Default)]
pub(super) struct RecordedFiles {
    /// The recordings and what they hold.
    pub(super) inputs: Vec<(PathBuf, RecordingTotals)>,
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
    failures: &mut DeferredErrors,
) -> Result<Option<Recorder>> {
    if args.no_record || !config.record.enabled {
        return Ok(None);
    }
    let started = Recorder::start_limited(path, &header(config, timer)?, config.record.limits());
    or_continue_without("recording", started, path, failures)
}

/// A file that cannot be begun is reported once and costs the exit code, not the run: a robot may steer by us. One that is there
/// already is a slip of who started the run, and cheap to mend before the robot drives.
fn or_continue_without<T>(
    what: &str,
    started: Result<T>,
    path: &Path,
    failures: &mut DeferredErrors,
) -> Result<Option<T>> {
    match started {
        Ok(started) => Ok(Some(started)),
        Err(error) if path.exists() => Err(error),
        Err(error) => {
            let reason = format!("{error:#}");
            tracing::error!(error = reason, "there is no {what}; the run goes on");
            failures.record::<()>(Err(error.context(format!("the {what} is not whole"))));
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
    failures: &mut DeferredErrors,
) -> Result<Option<TlogRecorder>> {
    if args.no_record || !(args.tlog || config.record.tlog) {
        return Ok(None);
    }
    let path = recording.with_extension("tlog");
    let links = config.station_config()?.links;
    let floor_bytes = config.record.limits().min_free_bytes;
    let started = TlogRecorder::start(&path, timer.utc_start(), &links, floor_bytes);
    or_continue_without("telemetry log", started, &path, failures)
}

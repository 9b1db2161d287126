//! Output files of a run: names, recording header, and start of recording and telemetry log.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posebridge_link::HostTimer;
use posebridge_recording::container::{FORMAT, RecordingHeader};
use posebridge_recording::ros2::BAG_SUFFIX;

use super::args::{McapProfile, RunArgs};
use super::bag_recorder::BagRecorder;
use super::recorder::{Recorder, RecordingTotals};
use super::side_file::WrittenSideFile;
use super::tlog_writer::TlogRecorder;
use crate::config::Config;
use crate::exit::DeferredErrors;

const MAX_NAMES: u32 = 10_000;

/// File name of a run's first recording; later ones have a number before the dot.
pub const RECORDING: &str = "recording.mcap";

/// `name` in the folder if it is unused and `first` is 1; else with the first free number before its dot. Returns the number as well.
pub(super) fn unused_path(folder: &Path, name: &str, first: u32) -> Result<(PathBuf, u32)> {
    let (stem, ending) = name.split_once('.').unwrap_or((name, ""));
    let numbers = first..first.saturating_add(MAX_NAMES);
    let mut numbered = numbers.map(|number| match number {
        ..=1 => (folder.join(name), number),
        _ => (folder.join(format!("{stem}-{number}.{ending}")), number),
    });
    numbered
        .find(|(path, _)| !path.exists())
        .with_context(|| format!("no free name for {name} in {}", folder.display()))
}

/// The header of a recording of this configuration; `utc_start_micros` is the date at the host clock's zero.
pub fn header(config: &Config, utc_start_micros: u64) -> Result<RecordingHeader> {
    Ok(RecordingHeader {
        format: FORMAT,
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        utc_start_micros,
        config_toml: toml::to_string(config).context("writing the configuration into the recording")?,
        links: config.links.iter().map(|link| link.url.clone()).collect(),
    })
}

/// Message about a file: its name comes first, because long texts are truncated on the way to a ground station.
pub(super) fn done_message(what: &str, path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().display();
    let folder = path.parent().unwrap_or(path).display();
    format!("{what} {name} in {folder}")
}

#[derive(Default)]
pub(super) struct RecordedFiles {
    pub(super) inputs: Vec<(PathBuf, RecordingTotals)>,
    pub(super) tlog: Option<WrittenSideFile>,
    pub(super) bag: Option<WrittenSideFile>,
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
    if args.record.no_record || !config.record.enabled {
        return Ok(None);
    }
    let started = Recorder::start(path, &header(config, timer.utc_start())?, config.record.limits());
    or_continue_without("recording", started, path, failures)
}

/// An error while creating a file is deferred and affects the exit code, not the run, because a robot may be steering by this station.
/// An existing file is an error at once: a user's mistake that is easy to correct before the drive.
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

pub(super) fn start_tlog(
    args: &RunArgs,
    config: &Config,
    timer: &HostTimer,
    recording: &Path,
    failures: &mut DeferredErrors,
) -> Result<Option<TlogRecorder>> {
    if args.record.no_record || !(args.record.tlog || config.record.tlog) {
        return Ok(None);
    }
    let path = recording.with_extension("tlog");
    let links = config.station_config()?.links;
    let floor_bytes = config.record.limits().min_free_bytes;
    let started = TlogRecorder::create(&path, timer.utc_start(), &links, floor_bytes);
    or_continue_without("telemetry log", started, &path, failures)
}

pub(super) fn start_bag(
    args: &RunArgs,
    config: &Config,
    timer: &HostTimer,
    recording: &Path,
    failures: &mut DeferredErrors,
) -> Result<Option<BagRecorder>> {
    let Some(McapProfile::Ros2) = args.record.mcap else {
        return Ok(None);
    };
    let stem = recording.file_stem().unwrap_or_default().to_string_lossy();
    let path = recording.with_file_name(format!("{stem}{BAG_SUFFIX}"));
    let started = BagRecorder::create(&path, timer.utc_start(), config.record.limits().min_free_bytes);
    or_continue_without("ROS 2 bag", started, &path, failures)
}

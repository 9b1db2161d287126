//! `posebridge import`: converts foreign files to posebridge recordings, so that all commands for recordings support them.
//! A telemetry log or a descriptor's run becomes the inputs of a station, with a configuration in the header. docs/recordings.md states
//! what is kept and what is lost.

pub(in crate::tools) mod message_log;
mod timeline;
mod tlog;

use std::fs::File;
use std::io::{Cursor, Seek, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use posebridge_recording::container::{RecordingHeader, RecordingWriter};
use posebridge_telemetry::{Address, Arena, Input, Point2};

use self::tlog::timed_frames;
use super::dataset::{self, DataSet, RobotRun};
use crate::config::{self, Config, NumberedPlace, RobotFile, RobotProfile, RobotStart, Setting, WorldConfig};
use crate::console::{print_line, print_lines};
use crate::exit::{ExitStage, Failure};
use crate::flags::DataFlags;
use crate::station::input_file::{InputFile, InputKind};
use crate::station::recorded_session::{MemoryLimit, own_bytes};
use crate::station::recording_files::header;

pub use tlog::{InputSink, TlogSource};

/// Flags of `import`.
#[derive(Args, Clone, Debug)]
pub struct ImportArgs {
    /// A telemetry log (*.tlog, *.tlog.gz), a ROS 2 bag (*.mcap, or its folder), a recording's descriptor (*.toml) or messages of
    /// `export --messages` (*.mcap).
    pub file: PathBuf,
    /// Recording to write; of messages a telemetry log (*.tlog). An existing file is not overwritten.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// What to read of a descriptor's data. For a telemetry log --set takes keys of the station's configuration.
    #[command(flatten)]
    pub data: DataFlags,
    /// Configuration of the station for a telemetry log: address, robot, filter. Default: the built-in one.
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Robot of a telemetry log or of a bag: a robot profile or the descriptor of a recording.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
}

pub fn execute(args: &ImportArgs) -> Result<(), Failure> {
    let kind = InputFile::open(&args.file).before_start()?.kind;
    let out = create(args).before_start()?;
    if kind == InputKind::Messages {
        let written = message_log::write_frames(&args.file, out);
        if written.is_err() {
            drop(std::fs::remove_file(&args.out));
        }
        print_line(&format!("wrote `{}`: {} frames", args.out.display(), written.while_running()?));
        return Ok(());
    }
    let station =
        StationOptions { config: args.config.as_deref(), robot: args.robot.as_deref(), settings: &args.data.settings };
    let imported = import(&args.file, &args.data, station, out);
    if imported.is_err() {
        // Half a recording would be taken for a whole one.
        drop(std::fs::remove_file(&args.out));
    }
    let (_, account) = imported.while_running()?;
    print_lines(&account.notes);
    print_line(&format!("wrote `{}`: {} inputs", args.out.display(), account.inputs));
    Ok(())
}

fn create(args: &ImportArgs) -> Result<File> {
    // What cannot be read is reported before an empty file is made.
    drop(InputFile::open(&args.file)?);
    File::create_new(&args.out).with_context(|| format!("creating `{}`", args.out.display()))
}

/// The station's configuration for a file without one.
#[derive(Clone, Copy, Debug, Default)]
pub struct StationOptions<'a> {
    /// `None` for the default configuration.
    pub config: Option<&'a Path>,
    pub robot: Option<&'a Path>,
    /// Single keys; they override `config` and robot.
    pub settings: &'a [Setting],
}

impl StationOptions<'_> {
    pub fn config(&self) -> Result<Config> {
        let mut config = config::load(self.config, self.settings)?.config;
        if let Some(path) = self.robot {
            config = config.with_robot(RobotProfile::read(path)?);
            config = config::apply_overrides(&config, self.settings)?;
        }
        Ok(config)
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportSummary {
    pub inputs: u64,
    /// Messages about omitted or changed data.
    pub notes: Vec<String>,
}

/// Passes the frames of a telemetry log with their times, microseconds since 1970, corrected for damage and date changes so that they
/// never decrease; returns messages about the corrections.
pub fn logged_frames(
    path: &Path,
    station: StationOptions<'_>,
    take: &mut dyn FnMut(u64, &[u8]),
) -> Result<Vec<String>> {
    let own = station.config()?.station;
    timed_frames(path, Address::new(own.system, own.component), take)
}

/// Writes a telemetry log or a descriptor's run as a posebridge recording.
pub fn import<W: Write + Seek>(
    path: &Path,
    data: &DataFlags,
    station: StationOptions<'_>,
    out: W,
) -> Result<(W, ImportSummary)> {
    match InputFile::open(path)?.kind {
        InputKind::Tlog => {
            let source = TlogSource::open(path, station.config()?)?;
            write(out, &source.header, |sink| source.inputs(sink))
        }
        InputKind::Descriptor => {
            let source = DescriptorSource::open(path, &dataset::with_robot(data, station.robot)?)?;
            let header = header(&source.config, source.utc_start_micros)?;
            write(out, &header, |sink| source.inputs(sink))
        }
        InputKind::Own => bail!("`{}` is a recording of posebridge already", path.display()),
        InputKind::Messages => bail!(messages_hint(path)),
        InputKind::Bytes => {
            bail!("`{}`: bytes without times cannot be replayed; a telemetry log (*.tlog) has times", path.display())
        }
    }
}

/// What to do with messages that are no recording.
pub(super) fn messages_hint(path: &Path) -> String {
    format!(
        "`{}` holds messages of `posebridge export --messages`: make a telemetry log of it first, with `posebridge import FILE --out LOG.tlog`",
        path.display()
    )
}

/// The bytes of a posebridge recording: those of the file with all parts that continue it, or converted from a telemetry log in memory;
/// and messages about omitted data.
pub fn recording_bytes(path: &Path, station: StationOptions<'_>) -> Result<(Vec<u8>, Vec<String>)> {
    let file = InputFile::open(path)?;
    if file.kind != InputKind::Tlog {
        return own_bytes(path, file, MemoryLimit::default());
    }
    let source = TlogSource::open(path, station.config()?)?;
    in_memory(path, &source.header, |sink| source.inputs(sink))
}

/// A descriptor's run as a recording in memory, as [`recording_bytes`], and the run.
pub fn converted_run(path: &Path, data: &DataFlags) -> Result<(Vec<u8>, Vec<String>, RobotRun)> {
    let source = DescriptorSource::open(path, data)?;
    let (bytes, notes) =
        in_memory(path, &header(&source.config, source.utc_start_micros)?, |sink| source.inputs(sink))?;
    Ok((bytes, notes, source.robot_run))
}

/// Fails beyond the memory limit of a recording.
fn in_memory(
    path: &Path,
    header: &RecordingHeader,
    inputs: impl FnOnce(&mut InputSink<'_>) -> Result<Vec<String>>,
) -> Result<(Vec<u8>, Vec<String>)> {
    let max_bytes = MemoryLimit::default().max_bytes;
    let mut held = 0;
    let (out, account) = write(Cursor::new(Vec::new()), header, |sink| {
        inputs(&mut |now, input| {
            let bytes = if let Input::Bytes { bytes, .. } = input { bytes.len() } else { 0 };
            held += (size_of::<Input>() + bytes) as u64;
            ensure!(
                held <= max_bytes,
                "`{}` becomes more than {} MiB: cut it into parts",
                path.display(),
                max_bytes >> 20
            );
            sink(now, input)
        })
    })?;
    Ok((out.into_inner(), account.notes))
}

fn write<W: Write + Seek>(
    out: W,
    header: &RecordingHeader,
    inputs: impl FnOnce(&mut InputSink<'_>) -> Result<Vec<String>>,
) -> Result<(W, ImportSummary)> {
    let mut writer = RecordingWriter::create(out, header)?;
    let mut account = ImportSummary::default();
    account.notes = inputs(&mut |now, input| {
        account.inputs += 1;
        Ok(writer.record(now, input)?)
    })?;
    Ok((writer.finish()?, account))
}

struct DescriptorSource {
    /// Robot, tunables and arena.
    config: Config,
    robot_run: RobotRun,
    /// Of the zero of its times.
    utc_start_micros: u64,
}

impl DescriptorSource {
    fn open(path: &Path, flags: &DataFlags) -> Result<Self> {
        let data = DataSet::open(path, flags)?;
        let [name] = data.runs.as_slice() else {
            bail!(
                "a recording holds one run, but {} are selected: choose one with --run: {}",
                data.runs.len(),
                data.runs.join(", ")
            );
        };
        let robot_run = data.load(name, flags)?;
        let start = robot_run.filter_config.start.map(|start| RobotStart {
            x_m: start.pose.x.0,
            y_m: start.pose.y.0,
            heading_deg: start.pose.heading.rad().to_degrees(),
            position_sigma_m: start.position_sigma_m,
            heading_sigma_deg: start.heading_sigma_rad.to_degrees(),
        });
        let config = Config {
            robot: RobotFile { start, ..robot_run.robot.clone() },
            filter: robot_run.filter.clone(),
            world: WorldConfig {
                landmarks: numbered_points(robot_run.run.landmarks.iter().map(|(id, at)| (id.0, *at))),
                beacons: numbered_points(robot_run.run.beacons.iter().map(|(id, at)| (id.0, *at))),
                walls: Vec::new(),
            },
            links: Vec::new(),
            ..Config::default()
        };
        Ok(Self { config, robot_run, utc_start_micros: data.utc_start_micros })
    }

    fn inputs(&self, sink: &mut InputSink<'_>) -> Result<Vec<String>> {
        let run = &self.robot_run.run;
        for timed in run.observations.iter() {
            sink(timed.arrival, &Input::Observation(timed.observation))?;
        }
        let left_out = [
            (run.bad_rows.total(), "rows that could not be used"),
            (run.truth.len(), "true poses: they belong to the descriptor"),
            (run.withheld.len(), "fixes that the descriptor withholds"),
        ];
        let left_out = left_out.into_iter().filter(|(count, _)| *count > 0);
        Ok(left_out.map(|(count, what)| format!("left out: {count} {what}")).collect())
    }
}

fn numbered_points(points: impl Iterator<Item = (u32, Point2<Arena>)>) -> Vec<NumberedPlace> {
    let to_point = |(id, at): (u32, Point2<Arena>)| NumberedPlace { id, x_m: at.x.0, y_m: at.y.0 };
    points.map(to_point).collect()
}

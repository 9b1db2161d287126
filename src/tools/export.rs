//! `posebridge export`: converts a recording and its estimates to files for other programs.
//! Reads posebridge recordings, telemetry logs and descriptors; the engine is that of a live run. docs/recordings.md describes the
//! files.

mod atomic_file;
mod decoded_messages;
mod files;
mod path_csv;

use std::io::BufWriter;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use posebridge_estimator::FilterConfig;
use posebridge_recording::container::RecordingReader;
use posebridge_recording::tlog::TlogWriter;
use posebridge_recording::tum;
use posebridge_report::{PoseTrack, TimedPose};
use posebridge_station::{RecordedStations, Robot};
use posebridge_telemetry::{Estimate, Event, HostClock, Input, Observation, Output, RobotId, TimeDelta, Timestamp};

use self::decoded_messages::{MessageFormats, export_messages};
use self::files::{OutputFolder, RunFiles, print_written};
use self::path_csv::write_path_csv;
use super::dataset::{self, RobotRun};
use super::ground_truth::GroundTruth;
use super::import::{self, StationOptions};
use super::replay::{SmoothError, SmoothedResult, SmoothingSpan};
use super::score::{PosePair, Scorer};
use crate::config::{Config, Overlay, config_with_overlay};
use crate::console::{print_line, print_lines};
use crate::exit::{ExitStage, Failure};
use crate::flags::{DataFlags, not_negative};
use crate::station::input_file::{InputFile, InputKind};
use crate::station::per_robot::{PerRobot, file_parts};
use crate::station::recorded_session::{for_each_input, missing_start};
use crate::station::signing::recorded_stations_config;
use crate::station::tlog_writer::TrafficLog;

/// Flags of `export`.
#[derive(Args, Clone, Debug)]
pub struct ExportArgs {
    /// A recording (*.mcap), a telemetry log (*.tlog, *.tlog.gz) or a recording's descriptor (*.toml); with --messages also bytes of a
    /// link (*.raw, *.bin).
    pub recording: PathBuf,
    /// Formats to write, separated by commas.
    #[arg(long = "format", value_enum, value_delimiter = ',', required = true)]
    pub formats: Vec<Format>,
    /// Decode every MAVLink message by its definition in place of estimating: with `csv` a table for each kind of message in the folder
    /// `NAME-messages`, with `mcap` a channel for each kind and sender in `NAME-messages.mcap`.
    #[arg(long)]
    pub messages: bool,
    /// Folder for the files; created if it does not exist.
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// What to read of a descriptor's data.
    #[command(flatten)]
    pub data: DataFlags,
    /// Filter. Default: the filter of the recording.
    #[arg(long, value_name = "NAME")]
    pub filter: Option<String>,
    /// Robot profile to use instead of the recording's robot. --set overrides it.
    #[arg(long, value_name = "FILE.toml")]
    pub robot: Option<PathBuf>,
    /// Also write the path given the whole run, as `smooth.tum` and `smooth.csv`.
    #[arg(long)]
    pub smooth: bool,
    /// Also write the path given the observations up to so many seconds later, as `fixed-lag.tum` and `fixed-lag.csv`.
    #[arg(long, value_name = "SECONDS", value_parser = not_negative)]
    pub fixed_lag: Option<f64>,
    /// Ground truth from `posebridge sim --truth`. Default: the ground truth in the recording.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Key file of a signed link. Default: the key file that was used while recording. Can be repeated.
    #[arg(long = "key", value_name = "FILE")]
    pub keys: Vec<PathBuf>,
}

/// What can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One table per stream: estimates, innovations, observations, links.
    Csv,
    /// Trajectories of ground truth and estimate at the same timestamps, for evo.
    Tum,
    /// A telemetry log with received and sent frames.
    Tlog,
    /// A posebridge recording.
    Mcap,
    /// A ROS 2 bag, a folder with MCAP and its metadata.yaml: odometry, pose, IMU, transforms, diagnostics.
    Ros2,
}

fn station(args: &ExportArgs) -> StationOptions<'_> {
    StationOptions { config: None, robot: args.robot.as_deref(), settings: &args.data.settings }
}

pub fn execute(args: &ExportArgs) -> Result<(), Failure> {
    if args.messages {
        let formats = message_formats(args).before_start()?;
        drop(InputFile::open(&args.recording).before_start()?);
        make_folder(args).before_start()?;
        return export_messages(&args.recording, output_folder(args), formats).while_running();
    }
    let kind = check(args).before_start()?;
    make_folder(args).before_start()?;
    if args.formats.contains(&Format::Mcap) {
        write_mcap(args).while_running()?;
    }
    let is_copied = kind == InputKind::Tlog && args.formats.contains(&Format::Tlog);
    if is_copied {
        copy_tlog(args).while_running()?;
    }
    let needs_engine = |format: &Format| match format {
        Format::Csv | Format::Tum | Format::Ros2 => true,
        Format::Tlog => !is_copied,
        Format::Mcap => false,
    };
    let engine_formats: Vec<Format> = args.formats.iter().copied().filter(needs_engine).collect();
    if engine_formats.is_empty() {
        return Ok(());
    }
    let session = ExportSession::open(args, kind).before_start()?;
    let run = session.run(args, &engine_formats).while_running()?;
    if engine_formats.contains(&Format::Tum) {
        write_trajectories(args, &run).while_running()?;
    }
    write_hindsight(args, &run.robots).while_running()?;
    Ok(())
}

fn make_folder(args: &ExportArgs) -> Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("making the folder `{}`", args.out.display()))
}

/// What of `--messages` is to be written.
fn message_formats(args: &ExportArgs) -> Result<MessageFormats> {
    let is_requested = |format| args.formats.contains(&format);
    ensure!(
        args.formats.iter().all(|format| matches!(format, Format::Csv | Format::Mcap)),
        "--messages writes --format csv and mcap"
    );
    ensure!(
        hindsights(args).next().is_none() && args.filter.is_none() && args.truth.is_none() && args.robot.is_none(),
        "--messages estimates nothing: leave out --smooth, --fixed-lag, --filter, --truth and --robot"
    );
    ensure!(
        args.keys.is_empty() && args.data.run.is_none() && args.data.settings.is_empty(),
        "--messages decodes what the file holds: leave out --key, --run and --set"
    );
    Ok(MessageFormats { csv: is_requested(Format::Csv), mcap: is_requested(Format::Mcap) })
}

/// Rejects invalid combinations; returns the kind of the file.
fn check(args: &ExportArgs) -> Result<InputKind> {
    let name = args.recording.display();
    let kind = InputFile::open(&args.recording)?.kind;
    let is_requested = |format| args.formats.contains(&format);
    ensure!(
        hindsights(args).next().is_none() || is_requested(Format::Csv) || is_requested(Format::Tum),
        "--smooth and --fixed-lag write --format csv and tum"
    );
    match kind {
        InputKind::Bytes => {
            bail!("`{name}`: bytes without times cannot be exported; `posebridge inspect` says what they hold")
        }
        InputKind::Messages => bail!(import::messages_hint(&args.recording)),
        InputKind::Own if is_requested(Format::Mcap) => {
            bail!("--format mcap: `{name}` is a recording of posebridge already")
        }
        InputKind::Descriptor if is_requested(Format::Tlog) => {
            bail!("--format tlog: `{name}` is a descriptor, there are no frames in its data")
        }
        InputKind::Descriptor => {
            ensure!(args.truth.is_none(), "--truth is for recordings: a descriptor names its own");
        }
        InputKind::Own | InputKind::Tlog => {}
    }
    Ok(kind)
}

fn write_mcap(args: &ExportArgs) -> Result<()> {
    let (file, fresh) = output_folder(args).create_new(".mcap")?;
    let (_, account) = import::import(&args.recording, &args.data, station(args), file)?;
    print_lines(&account.notes);
    print_written(fresh.path(), account.inputs, "inputs");
    fresh.finish()
}

/// Copies the valid frames of a telemetry log, with big-endian times that never decrease.
fn copy_tlog(args: &ExportArgs) -> Result<()> {
    let (out, fresh) = output_folder(args).create_new(".tlog")?;
    let mut writer = TlogWriter::new(BufWriter::new(out));
    let mut written = Ok(0);
    let notes = import::logged_frames(&args.recording, station(args), &mut |micros, frame| {
        if let Ok(count) = written {
            let done = writer.record(micros, frame);
            written = done.map(|()| count + 1);
        }
    })?;
    let written = written.with_context(|| format!("writing `{}`", fresh.path().display()))?;
    writer.finish()?;
    print_lines(&notes);
    print_written(fresh.path(), written, "frames");
    fresh.finish()
}

/// A recording with the data of an engine run.
struct ExportSession {
    name: String,
    bytes: Vec<u8>,
    config: Config,
    scorer: Option<Scorer>,
    /// A descriptor's run.
    data: Option<RobotRun>,
    truth: Option<PoseTrack>,
}

/// What is kept of a robot's events.
#[derive(Default)]
struct CollectedPoses {
    /// All of one origin: the arena's, or else where the robot started.
    estimates: Vec<TimedPose>,
    is_located: bool,
    observations: Vec<Observation>,
    retains_observations: bool,
    restarts: u64,
}

impl CollectedPoses {
    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    fn on_event(&mut self, event: &Event) {
        match event {
            Event::ObservationAligned { observation, .. } if self.retains_observations => {
                self.observations.push(*observation);
            }
            Event::BrickRestarted { .. } => self.restarts += 1,
            Event::EstimateUpdated { estimate, .. } => self.on_estimate(estimate),
            _ => {}
        }
    }
}

impl CollectedPoses {
    /// With truth only those in the arena: there is nothing to compare the others with.
    fn poses(self, truth: Option<&PoseTrack>) -> Vec<TimedPose> {
        if self.is_located || truth.is_none() { self.estimates } else { Vec::new() }
    }

    /// Poses in the arena take the place of those that are relative to where the robot started.
    fn on_estimate(&mut self, estimate: &Estimate) {
        if !self.is_located && !estimate.is_relative() {
            self.is_located = true;
            self.estimates.clear();
        }
        if self.is_located == estimate.is_relative() {
            return;
        }
        if estimate.is_relative() || estimate.validity.heading {
            self.estimates.push(TimedPose { time: estimate.stamp, pose: estimate.pose });
        }
    }
}

struct ExportedRun {
    /// Of a posebridge recording; never empty.
    robots: Vec<RobotPoses>,
    /// A descriptor's run at the instants of its truth or withheld fixes.
    pairs: Option<Vec<PosePair>>,
}

struct RobotPoses {
    /// `None` with a single robot.
    label: Option<String>,
    hindsight: Vec<HindsightPath>,
    /// With valid position and heading, in the order of publication.
    estimates: Vec<TimedPose>,
    truth: Option<PoseTrack>,
}

impl ExportSession {
    fn open(args: &ExportArgs, kind: InputKind) -> Result<Self> {
        let name = args.recording.display().to_string();
        let (bytes, data) = if kind == InputKind::Descriptor {
            let data = dataset::with_robot(&args.data, args.robot.as_deref())?;
            let (bytes, notes, robot_run) = import::converted_run(&args.recording, &data)?;
            print_lines(&notes);
            if robot_run.run.truth.is_empty() {
                print_line(
                    "there is no truth: the withheld fixes stand in its place, and the estimates are of the point that they saw",
                );
            }
            (bytes, Some(robot_run))
        } else {
            let (bytes, notes) = import::recording_bytes(&args.recording, station(args))?;
            print_lines(&notes);
            (bytes, None)
        };
        let reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        if let Some(lack) = missing_start(reader.part_header()) {
            print_line(&format!("{name}: {lack}; the estimates are not those of the live run"));
        }
        // A descriptor's settings are in what was made of it already: their keys are those of its robot.
        let overlay = match kind {
            InputKind::Descriptor => Overlay::default(),
            InputKind::Own | InputKind::Tlog | InputKind::Bytes | InputKind::Messages => {
                Overlay { robot: args.robot.as_deref(), settings: &args.data.settings }
            }
        };
        let mut config = config_with_overlay(&reader.header().config_toml, overlay)?;
        if let Some(filter) = &args.filter {
            config.filter.name.clone_from(filter);
        }
        let known = if args.formats.contains(&Format::Tum) || args.truth.is_some() {
            GroundTruth::load(&name, &bytes, args.truth.as_deref(), None)?
        } else {
            GroundTruth::default()
        };
        let scorer = data.as_ref().map(|data| Scorer::new(&data.run, &data.filter_config.calibration));
        Ok(Self { name, bytes, config, scorer, data, truth: known.truth })
    }

    /// Runs the engine and writes the files of all requested formats except TUM, which needs the whole run.
    fn run(self, args: &ExportArgs, engine_formats: &[Format]) -> Result<ExportedRun> {
        let mut reader = RecordingReader::open(&self.bytes)?;
        let (first, further) = recorded_stations_config(&self.config, &args.keys)?;
        let utc_start_micros = reader.header().utc_start_micros;
        let mut files = RunFiles::default();
        if engine_formats.contains(&Format::Csv) {
            files.add_tables(&args.out);
        }
        if engine_formats.contains(&Format::Tlog) {
            let (out, fresh) = output_folder(args).create_new(".tlog")?;
            let links = std::iter::once(&first).chain(&further).flat_map(|station| station.config.links.clone());
            let log = TrafficLog::new(BufWriter::new(out), utc_start_micros, &links.collect::<Vec<_>>());
            files.add_traffic(log, fresh);
        }
        if engine_formats.contains(&Format::Ros2) {
            files.add_bag(output_folder(args), utc_start_micros)?;
        }
        let mut stations = RecordedStations::new(first, further)?;
        let mut scorer = self.scorer;
        let retains_observations = hindsights(args).next().is_some();
        let mut estimates = PerRobot::new(move || CollectedPoses { retains_observations, ..CollectedPoses::default() });
        for_each_input(&self.name, &mut reader, |now, input| {
            files.record_input(now, input)?;
            stations.handle(now, input);
            record_outputs(now, &mut stations, &mut files, &mut estimates)?;
            if let (Some(scorer), Input::Observation(one)) = (&mut scorer, input) {
                scorer.on_observation(&one.measurement, one.stamp, stations.first());
            }
            Ok(())
        })?;
        if let Some(scorer) = &mut scorer {
            scorer.finish(stations.first());
        }
        files.finish()?;
        let hindsight = |label: &str, id: Option<RobotId>, collected: &CollectedPoses| {
            let robot = stations.robots().find(|robot| Some(robot.id()) == id);
            let mut filter_config = self.config.filter_config_of(self.config.robot_file(robot))?;
            filter_config.geometry = robot.map_or(filter_config.geometry, Robot::geometry);
            let data = self.data.as_ref();
            if collected.restarts > 0 && hindsights(args).next().is_some() {
                bail!("{label}: {}", SmoothError::Restarted(collected.restarts));
            }
            hindsight_paths(args, label, &filter_config, &collected.observations, data)
        };
        let robots = robot_poses(args, &self.name, &self.bytes, estimates, self.truth, hindsight)?;
        Ok(ExportedRun { robots, pairs: scorer.map(|scorer| scorer.pairs) })
    }
}

/// Each robot's estimates with its truth; `truth` is that of the only robot, or of the first.
fn robot_poses(
    args: &ExportArgs,
    name: &str,
    recording: &[u8],
    estimates: PerRobot<CollectedPoses>,
    truth: Option<PoseTrack>,
    hindsight: impl Fn(&str, Option<RobotId>, &CollectedPoses) -> Result<Vec<HindsightPath>>,
) -> Result<Vec<RobotPoses>> {
    let mut robots = estimates.into_entries();
    if robots.len() == 1
        && let Some(only) = robots.pop()
    {
        let hindsight = hindsight(name, only.robot, &only.value)?;
        return Ok(vec![RobotPoses { label: None, hindsight, estimates: only.value.poses(truth.as_ref()), truth }]);
    }
    let needs_truth = args.formats.contains(&Format::Tum);
    let robots = robots.into_iter().map(|robot| {
        let known = needs_truth.then(|| GroundTruth::load(name, recording, args.truth.as_deref(), robot.robot));
        let truth = known.transpose()?.and_then(|known| known.truth);
        let hindsight = hindsight(&robot.label, robot.robot, &robot.value)?;
        Ok(RobotPoses { label: Some(robot.label), hindsight, estimates: robot.value.poses(truth.as_ref()), truth })
    });
    robots.collect()
}

fn output_folder(args: &ExportArgs) -> OutputFolder<'_> {
    OutputFolder { folder: &args.out, recording: &args.recording }
}

fn record_outputs(
    now: Timestamp<HostClock>,
    stations: &mut RecordedStations,
    files: &mut RunFiles,
    estimates: &mut PerRobot<CollectedPoses>,
) -> Result<()> {
    while let Some(output) = stations.poll() {
        match output {
            Output::Event(event) => {
                files.record_event(now, &event)?;
                estimates.push(&event, CollectedPoses::on_event);
            }
            Output::Transmit { link, priority, bytes, .. } => files.record_sent(now, link, priority, &bytes)?,
            // What the live program did for it, it did then.
            Output::Request(_) => {}
        }
    }
    Ok(())
}

/// Writes `estimate.tum`, and `truth.tum` if there is truth; with several robots `estimate-NAME.tum` and `truth-NAME.tum` each.
fn write_trajectories(args: &ExportArgs, run: &ExportedRun) -> Result<()> {
    if let Some(pairs) = &run.pairs {
        let at = |time, pose| TimedPose { time, pose };
        write_one(args, "estimate", &with_unique_times(pairs.iter().map(|pair| at(pair.time, pair.estimated))))?;
        return write_one(args, "truth", &with_unique_times(pairs.iter().map(|pair| at(pair.time, pair.expected))));
    }
    let labels = run.robots.iter().map(|robot| robot.label.as_deref().unwrap_or_default());
    for (robot, part) in run.robots.iter().zip(file_parts(labels)) {
        write_robot(args, robot, &part)?;
    }
    Ok(())
}

/// `part` is the robot's part of the file names, used with several robots.
fn write_robot(args: &ExportArgs, robot: &RobotPoses, part: &str) -> Result<()> {
    let suffix = robot.label.as_ref().map_or_else(String::new, |_| format!("-{part}"));
    let (estimate, truth) = trajectories(robot);
    if estimate.is_empty() {
        let scope = if robot.truth.is_some() { " where there is truth" } else { "" };
        match &robot.label {
            // The others have theirs.
            Some(label) => print_line(&format!("there is no valid estimate of {label}{scope} to write")),
            None => bail!("there is no valid estimate{scope} to write"),
        }
        return Ok(());
    }
    write_one(args, &format!("estimate{suffix}"), &estimate)?;
    if let Some(truth) = truth {
        return write_one(args, &format!("truth{suffix}"), &truth);
    }
    print_line(&format!("there is no truth: `estimate{suffix}.tum` stands alone; give --truth"));
    Ok(())
}

fn trajectories(robot: &RobotPoses) -> (Vec<TimedPose>, Option<Vec<TimedPose>>) {
    let estimates = robot.estimates.iter().copied();
    let Some(truth) = &robot.truth else {
        return (with_unique_times(estimates), None);
    };
    let pairs = estimates.filter_map(|estimate| {
        let stamp = estimate.time;
        let pose = truth.at(stamp)?;
        Some((estimate, TimedPose { time: stamp, pose }))
    });
    // Both have the same stamps in the same order, and so they have them afterwards.
    let (estimates, truth): (Vec<TimedPose>, Vec<TimedPose>) = pairs.unzip();
    (with_unique_times(estimates.into_iter()), Some(with_unique_times(truth.into_iter())))
}

/// Of several estimates for an instant each counts for the score, as in a replay.
fn with_unique_times(poses: impl Iterator<Item = TimedPose>) -> Vec<TimedPose> {
    let mut poses: Vec<TimedPose> = poses.collect();
    poses.sort_by_key(|one| one.time);
    tum::separate_times(poses.iter_mut().map(|one| &mut one.time));
    poses
}

fn write_one(args: &ExportArgs, name: &str, poses: &[TimedPose]) -> Result<()> {
    let path = args.out.join(format!("{name}.tum"));
    let text: String = poses.iter().map(|one| tum::format_line(one.time, one.pose)).collect();
    std::fs::write(&path, text).with_context(|| format!("writing `{}`", path.display()))?;
    print_written(&path, poses.len() as u64, "poses");
    Ok(())
}

/// The paths in hindsight that were asked for, with the names of their files.
fn hindsights(args: &ExportArgs) -> impl Iterator<Item = (&'static str, SmoothingSpan)> {
    let lag = args.fixed_lag.map(|lag_s| ("fixed-lag", SmoothingSpan::Lag(TimeDelta::from_secs_f64(lag_s))));
    args.smooth.then_some(("smooth", SmoothingSpan::WholeRun)).into_iter().chain(lag)
}

/// A path in hindsight of one robot.
struct HindsightPath {
    /// Of the files.
    name: &'static str,
    path: SmoothedResult,
    /// A descriptor's run at the instants of its truth or withheld fixes.
    pairs: Option<Vec<PosePair>>,
}

/// The paths that were asked for; says why there is none.
fn hindsight_paths(
    args: &ExportArgs,
    label: &str,
    config: &FilterConfig,
    observations: &[Observation],
    data: Option<&RobotRun>,
) -> Result<Vec<HindsightPath>> {
    let mut paths = Vec::new();
    for (name, hindsight) in hindsights(args) {
        let path = SmoothedResult::new(config, observations, hindsight)
            .with_context(|| format!("{label}: there is no path to write"))?;
        if let Some(shortfall) = path.shortfall() {
            print_line(&format!("{label}: not converged: {shortfall}"));
        }
        let pairs = data.map(|data| {
            let mut scorer = Scorer::new(&data.run, &config.calibration);
            scorer.finish(&path);
            scorer.pairs
        });
        paths.push(HindsightPath { name, path, pairs });
    }
    Ok(paths)
}

/// Writes `NAME.tum`, where there is truth at the instants of that, and `NAME.csv`; with several robots `NAME-ROBOT.tum` each.
fn write_hindsight(args: &ExportArgs, robots: &[RobotPoses]) -> Result<()> {
    let labels = robots.iter().map(|robot| robot.label.as_deref().unwrap_or_default());
    for (robot, part) in robots.iter().zip(file_parts(labels)) {
        let suffix = robot.label.as_ref().map_or_else(String::new, |_| format!("-{part}"));
        for HindsightPath { name, path, pairs } in &robot.hindsight {
            let name = format!("{name}{suffix}");
            if args.formats.contains(&Format::Csv) {
                let file = args.out.join(format!("{name}.csv"));
                print_written(&file, write_path_csv(&file, path)?, "lines");
            }
            if args.formats.contains(&Format::Tum) {
                let own = path.estimates().map(|estimate| TimedPose { time: estimate.stamp, pose: estimate.pose });
                let poses = match (pairs, &robot.truth) {
                    (Some(pairs), _) => {
                        pairs.iter().map(|pair| TimedPose { time: pair.time, pose: pair.estimated }).collect()
                    }
                    (None, Some(truth)) => own.filter(|at| truth.at(at.time).is_some()).collect::<Vec<_>>(),
                    (None, None) => own.collect(),
                };
                write_one(args, &name, &with_unique_times(poses.into_iter()))?;
            }
        }
    }
    Ok(())
}

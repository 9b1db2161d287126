//! The run through the engine that an export is made of.

use std::fs::File;
use std::io::{BufWriter, Cursor};
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_recording::container::{RecordingEnd, RecordingReader};
use posebridge_recording::csv::CsvWriter;
use posebridge_report::{PoseTrack, TimedPose};
use posebridge_station::Station;
use posebridge_telemetry::{Event, HostClock, Input, Output, Timestamp};

use super::args::{ExportArgs, Format, station};
use super::output_files::{AtomicFile, create_new, print_notes, print_written};
use crate::config::{Config, Overlay, config_with_overlay};
use crate::console::print_line;
use crate::station::input_file::InputKind;
use crate::station::per_robot::PerRobot;
use crate::station::recording_warnings::missing_start;
use crate::station::signing;
use crate::station::traffic_log::TrafficLog;
use crate::tools::dataset::DataSet;
use crate::tools::ground_truth::GroundTruth;
use crate::tools::import;
use crate::tools::score::{PosePair, Scorer};

/// A recording with everything that a run through the engine needs.
pub(super) struct ExportSession {
    name: String,
    bytes: Vec<u8>,
    config: Config,
    /// What a descriptor's run is held against.
    scorer: Option<Scorer>,
    truth: Option<PoseTrack>,
}

/// What a run has made besides files.
pub(super) struct ExportedRun {
    /// The robots of a recording of ours; there is always one.
    pub(super) robots: Vec<RobotPoses>,
    /// A descriptor's run at the instants of its truth or withheld fixes.
    pub(super) pairs: Option<Vec<PosePair>>,
}

/// Estimates and truth of one robot.
pub(super) struct RobotPoses {
    /// What it is called, where there are several.
    pub(super) label: Option<String>,
    /// The estimates whose position and heading were valid, in the order in which they were made.
    pub(super) estimates: Vec<TimedPose>,
    /// Where it really was.
    pub(super) truth: Option<PoseTrack>,
}

/// The files that are written while the engine runs.
struct ExportFiles {
    csv: Option<CsvWriter<'static, File>>,
    tlog: Option<TrafficLog<BufWriter<File>>>,
}

impl ExportSession {
    /// Reads everything.
    ///
    /// # Errors
    /// The recording, its truth or a flag makes no sense.
    pub(super) fn open(args: &ExportArgs, kind: InputKind) -> Result<Self> {
        let name = args.recording.display().to_string();
        let (bytes, scorer) = if kind == InputKind::Descriptor {
            let bytes = Cursor::new(Vec::new());
            let (bytes, account) = import::import(&args.recording, &args.data, station(args), bytes)?;
            print_notes(&account.notes);
            (bytes.into_inner(), Some(scorer_of(args)?))
        } else {
            let (bytes, notes) = import::recording_bytes(&args.recording, station(args))?;
            print_notes(&notes);
            (bytes, None)
        };
        let reader = RecordingReader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        if let Some(lack) = missing_start(reader.part_header()) {
            print_line(&format!("{name}: {lack}; the estimates are not those of the live run"));
        }
        // A descriptor's settings are in what was made of it already: their keys are those of its robot.
        let overlay = match kind {
            InputKind::Descriptor => Overlay::default(),
            InputKind::Own | InputKind::Tlog | InputKind::Bytes => {
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
        Ok(Self { name, bytes, config, scorer, truth: known.truth })
    }

    /// Runs the engine and writes the files of the wanted formats but TUM, which needs the whole run.
    ///
    /// # Errors
    /// The configuration makes no sense, or a file cannot be written.
    pub(super) fn run(self, args: &ExportArgs, wanted: &[Format]) -> Result<ExportedRun> {
        let mut reader = RecordingReader::open(&self.bytes)?;
        let mut station_config = self.config.station_config()?;
        signing::restore_states(&self.config, &args.keys, &mut station_config)?;
        let utc_start_micros = reader.header().utc_start_micros;
        let tlog = wanted.contains(&Format::Tlog).then(|| create_new(args, "tlog"));
        let (tlog, fresh) = tlog.transpose()?.unzip();
        let mut files = ExportFiles {
            csv: wanted.contains(&Format::Csv).then(|| streams(&args.out)),
            tlog: tlog.map(|file| {
                let out = BufWriter::new(file);
                TrafficLog::new(out, utc_start_micros, &station_config.links)
            }),
        };
        let mut station = Station::new(station_config, Timestamp::ZERO)?;
        let mut scorer = self.scorer;
        let mut estimates = PerRobot::new(Vec::new);
        for item in &mut reader {
            match item {
                Ok((now, input)) => {
                    files.record_input(now, &input)?;
                    station.handle(now, &input);
                    files.record_outputs(now, &mut station, &mut estimates)?;
                    if let (Some(scorer), Input::Observation(one)) = (&mut scorer, &input) {
                        scorer.on_observation(&one.measurement, one.stamp, &station);
                    }
                }
                Err(error) => print_line(&format!("{}: {error}; what is whole is used", self.name)),
            }
        }
        if let RecordingEnd::Truncated { offset, what } = reader.recording_end() {
            print_line(&format!("{}: cut off at byte {offset} ({what}); everything before is used", self.name));
        }
        if let Some(scorer) = &mut scorer {
            scorer.finish(&station);
        }
        files.finish(args, fresh)?;
        let robots = robot_poses(args, &self.name, &self.bytes, estimates, self.truth)?;
        Ok(ExportedRun { robots, pairs: scorer.map(|scorer| scorer.pairs) })
    }
}

/// Each robot's estimates with its truth; `truth` is that of the only robot, or of the first.
fn robot_poses(
    args: &ExportArgs,
    name: &str,
    recording: &[u8],
    estimates: PerRobot<Vec<TimedPose>>,
    truth: Option<PoseTrack>,
) -> Result<Vec<RobotPoses>> {
    let mut robots = estimates.into_entries();
    if robots.len() == 1
        && let Some(only) = robots.pop()
    {
        return Ok(vec![RobotPoses { label: None, estimates: only.value, truth }]);
    }
    let wants_truth = args.formats.contains(&Format::Tum);
    let robots = robots.into_iter().map(|robot| {
        let known = wants_truth.then(|| GroundTruth::load(name, recording, args.truth.as_deref(), robot.robot));
        let truth = known.transpose()?.and_then(|known| known.truth);
        Ok(RobotPoses { label: Some(robot.label), estimates: robot.value, truth })
    });
    robots.collect()
}

/// The truth or the withheld fixes of the one run that the flags choose.
fn scorer_of(args: &ExportArgs) -> Result<Scorer> {
    let data = DataSet::open(&args.recording, &args.data)?;
    let [run] = data.runs.as_slice() else { anyhow::bail!("choose one run with --run: {}", data.runs.join(", ")) };
    let robot_run = data.load(run, &args.data)?;
    if robot_run.run.truth.is_empty() {
        print_line(
            "there is no truth: the withheld fixes stand in its place, and the estimates are of the point that they saw",
        );
    }
    Ok(Scorer::new(&robot_run.run, &robot_run.filter_config.calibration))
}

/// Opens streams in a folder; what an export before this one has left there is overwritten.
fn streams(folder: &Path) -> CsvWriter<'static, File> {
    let folder = folder.to_owned();
    CsvWriter::new(move |name: &str| File::create(folder.join(format!("{name}.csv"))))
}

impl ExportFiles {
    fn record_input(&mut self, now: Timestamp<HostClock>, input: &Input) -> Result<()> {
        if let (Some(tlog), Input::Bytes { link, peer, bytes }) = (&mut self.tlog, input) {
            tlog.received(now, *link, *peer, bytes).context("writing the telemetry log")?;
        }
        Ok(())
    }

    fn record_outputs(
        &mut self,
        now: Timestamp<HostClock>,
        station: &mut Station,
        estimates: &mut PerRobot<Vec<TimedPose>>,
    ) -> Result<()> {
        while let Some(output) = station.poll() {
            match output {
                Output::Event(event) => {
                    if let Some(csv) = &mut self.csv {
                        csv.record(now, &event).context("writing CSV")?;
                    }
                    estimates.push(&event, |estimates, event| estimates.extend(valid_pose(event)));
                }
                Output::Transmit { link, priority, bytes, .. } => {
                    if let Some(tlog) = &mut self.tlog {
                        tlog.sent(now, link, priority, &bytes).context("writing the telemetry log")?;
                    }
                }
                // What the live program did for it, it did then.
                Output::Request(_) => {}
            }
        }
        Ok(())
    }

    fn finish(self, args: &ExportArgs, fresh: Option<AtomicFile>) -> Result<()> {
        if let Some(csv) = self.csv {
            for (name, lines) in csv.finish().context("writing CSV")? {
                print_written(&args.out.join(format!("{name}.csv")), lines, "lines");
            }
        }
        if let (Some(tlog), Some(fresh)) = (self.tlog, fresh) {
            let (_, frames) = tlog.finish().context("writing the telemetry log")?;
            print_written(fresh.path(), frames, "frames");
            fresh.finish()?;
        }
        Ok(())
    }
}

fn valid_pose(event: &Event) -> Option<TimedPose> {
    let Event::EstimateUpdated { estimate, .. } = event else {
        return None;
    };
    let is_valid = estimate.validity.position && estimate.validity.heading;
    is_valid.then_some(TimedPose { time: estimate.stamp, pose: estimate.pose })
}

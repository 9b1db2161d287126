//! The run through the engine that an export is made of.

use std::fs::File;
use std::io::{BufWriter, Cursor};
use std::path::Path;

use anyhow::{Context, Result};
use posebridge_analysis::{TimedPose, Track};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{Ending, Reader};
use posebridge_recording::csv::Streams;
use posebridge_telemetry::{Event, HostClock, Input, Output, Stamp};

use super::fresh::Fresh;
use super::{ExportArgs, Format, create_new, station, tell, tell_all};
use crate::config::Config;
use crate::data::DataSet;
use crate::import;
use crate::input_file::Kind;
use crate::known::Known;
use crate::own_recording::{Overlay, lack_of, laid_over};
use crate::score::{Pair, Scorer};
use crate::signing;
use crate::stderr::say;
use crate::tlog::TrafficLog;

/// A recording with everything that a run through the engine needs.
pub(super) struct Session {
    name: String,
    bytes: Vec<u8>,
    config: Config,
    /// What a descriptor's run is held against.
    scorer: Option<Scorer>,
    truth: Option<Track>,
}

/// What a run has made besides files.
pub(super) struct Made {
    /// The estimates whose position and heading were valid, in the order in which they were made.
    pub(super) estimates: Vec<TimedPose>,
    /// The truth of a recording of ours.
    pub(super) truth: Option<Track>,
    /// A descriptor's run at the instants of its truth or withheld fixes.
    pub(super) pairs: Option<Vec<Pair>>,
}

/// The files that are written while the engine runs.
struct Files {
    csv: Option<Streams<'static, BufWriter<File>>>,
    tlog: Option<TrafficLog<BufWriter<File>>>,
}

impl Session {
    /// Reads everything.
    ///
    /// # Errors
    /// The recording, its truth or a flag makes no sense.
    pub(super) fn open(args: &ExportArgs, kind: Kind) -> Result<Self> {
        let name = args.recording.display().to_string();
        let (bytes, scorer) = if kind == Kind::Descriptor {
            let bytes = Cursor::new(Vec::new());
            let (bytes, account) = import::import(&args.recording, &args.data, station(args), bytes)?;
            tell_all(&account.notes);
            (bytes.into_inner(), Some(scorer_of(args)?))
        } else {
            let (bytes, notes) = import::recording_bytes(&args.recording, station(args))?;
            tell_all(&notes);
            (bytes, None)
        };
        let reader = Reader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        if let Some(lack) = lack_of(reader.beginning()) {
            say(&format!("{name}: {lack}; the estimates are not those of the live run"));
        }
        // A descriptor's settings are in what was made of it already: their keys are those of its robot.
        let overlay = match kind {
            Kind::Descriptor => Overlay::default(),
            Kind::Own | Kind::Tlog | Kind::Bytes => {
                Overlay { robot: args.robot.as_deref(), settings: &args.data.settings }
            }
        };
        let mut config = laid_over(&reader.header().config_toml, overlay)?;
        if let Some(filter) = &args.filter {
            config.filter.name.clone_from(filter);
        }
        let known = if args.formats.contains(&Format::Tum) || args.truth.is_some() {
            Known::of(&name, &bytes, args.truth.as_deref())?
        } else {
            Known::default()
        };
        Ok(Self { name, bytes, config, scorer, truth: known.truth })
    }

    /// Runs the engine and writes the files of the wanted formats but TUM, which needs the whole run.
    ///
    /// # Errors
    /// The configuration makes no sense, or a file cannot be written.
    pub(super) fn run(self, args: &ExportArgs, wanted: &[Format]) -> Result<Made> {
        let mut reader = Reader::open(&self.bytes)?;
        let mut pipeline_config = self.config.pipeline()?;
        signing::recall(&self.config, &args.keys, &mut pipeline_config)?;
        let utc_start_micros = reader.header().utc_start_micros;
        let tlog = wanted.contains(&Format::Tlog).then(|| create_new(args, "tlog"));
        let (tlog, fresh) = tlog.transpose()?.unzip();
        let mut files = Files {
            csv: wanted.contains(&Format::Csv).then(|| streams(&args.out)),
            tlog: tlog.map(|file| {
                let out = BufWriter::new(file);
                TrafficLog::new(out, utc_start_micros, &pipeline_config.links)
            }),
        };
        let mut pipeline = Pipeline::new(pipeline_config, Stamp::ZERO)?;
        let mut scorer = self.scorer;
        let mut estimates = Vec::new();
        for item in &mut reader {
            match item {
                Ok((now, input)) => {
                    files.take_input(now, &input)?;
                    pipeline.handle(now, &input);
                    files.take_outputs(now, &mut pipeline, &mut estimates)?;
                    if let (Some(scorer), Input::Observation(one)) = (&mut scorer, &input) {
                        scorer.observed(&one.observed, one.stamp, &pipeline);
                    }
                }
                Err(error) => say(&format!("{}: {error}; what is whole is used", self.name)),
            }
        }
        if let Ending::Torn { offset, what } = reader.ending() {
            say(&format!("{}: cut off at byte {offset} ({what}); everything before is used", self.name));
        }
        if let Some(scorer) = &mut scorer {
            scorer.finish(&pipeline);
        }
        files.finish(args, fresh)?;
        Ok(Made { estimates, truth: self.truth, pairs: scorer.map(|scorer| scorer.pairs) })
    }
}

/// The truth or the withheld fixes of the one run that the flags choose.
fn scorer_of(args: &ExportArgs) -> Result<Scorer> {
    let data = DataSet::open(&args.recording, &args.data)?;
    let [run] = data.runs.as_slice() else { anyhow::bail!("choose one run with --run: {}", data.runs.join(", ")) };
    let robot_run = data.load(run, &args.data)?;
    if robot_run.run.truth.is_empty() {
        say(
            "there is no truth: the withheld fixes stand in its place, and the estimates are of the point that they saw",
        );
    }
    Ok(Scorer::new(&robot_run.run, &robot_run.filter_config.calibration))
}

/// Opens streams in a folder; what an export before this one has left there is overwritten.
fn streams(folder: &Path) -> Streams<'static, BufWriter<File>> {
    let folder = folder.to_owned();
    Streams::new(move |name: &str| File::create(folder.join(format!("{name}.csv"))).map(BufWriter::new))
}

impl Files {
    fn take_input(&mut self, now: Stamp<HostClock>, input: &Input) -> Result<()> {
        if let (Some(tlog), Input::Bytes { link, peer, bytes }) = (&mut self.tlog, input) {
            tlog.received(now, (*link, *peer), bytes).context("writing the telemetry log")?;
        }
        Ok(())
    }

    fn take_outputs(
        &mut self,
        now: Stamp<HostClock>,
        pipeline: &mut Pipeline,
        estimates: &mut Vec<TimedPose>,
    ) -> Result<()> {
        while let Some(output) = pipeline.poll() {
            match output {
                Output::Event(event) => {
                    if let Some(csv) = &mut self.csv {
                        csv.take(now, &event).context("writing CSV")?;
                    }
                    estimates.extend(valid_pose(&event));
                }
                Output::Transmit { link, priority, bytes, .. } => {
                    if let Some(tlog) = &mut self.tlog {
                        tlog.sent(now, (link, priority), &bytes).context("writing the telemetry log")?;
                    }
                }
                // What the live program did for it, it did then.
                Output::Request(_) => {}
            }
        }
        Ok(())
    }

    fn finish(self, args: &ExportArgs, fresh: Option<Fresh>) -> Result<()> {
        if let Some(csv) = self.csv {
            for (name, lines) in csv.finish().context("writing CSV")? {
                tell(&args.out.join(format!("{name}.csv")), lines, "lines");
            }
        }
        if let (Some(tlog), Some(fresh)) = (self.tlog, fresh) {
            let (_, frames) = tlog.finish().context("writing the telemetry log")?;
            tell(fresh.path(), frames, "frames");
            fresh.finish()?;
        }
        Ok(())
    }
}

fn valid_pose(event: &Event) -> Option<TimedPose> {
    let Event::Estimated { estimate, .. } = event else {
        return None;
    };
    let is_valid = estimate.validity.position && estimate.validity.heading;
    is_valid.then_some(TimedPose { stamp: estimate.stamp, pose: estimate.pose })
}

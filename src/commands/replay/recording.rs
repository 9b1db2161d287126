//! A recording of ours, read into memory: its configuration, its truth, and the way of its inputs into the engine.

use std::path::Path;

use anyhow::{Result, ensure};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{Header, Reader};
use posebridge_telemetry::{HostClock, Input, Span, Stamp};

use super::robot;
use super::watch::{Lane, Pace, Place, Window};
use crate::cli::SessionFlags;
use crate::config::{self, Config};
use crate::import::{self, Inputs, Session, Station};
use crate::known::Known;
use crate::notes::Notes;
use crate::progress;
use crate::signing;

/// The bar moves when so many bytes have been read.
const BAR_STEP: u64 = 256 * 1024;

/// A recording of ours, in memory, or a telemetry log in its place.
pub struct OwnRecording {
    /// Its path, as it was given.
    pub name: String,
    /// What it says about itself.
    pub header: Header,
    inputs: Inputs,
    /// What is missing of the file's parts.
    notes: Vec<String>,
}

/// What came of giving a recording to the engine.
#[derive(Debug, Default)]
pub struct Passage {
    /// From the first input to the last that was given.
    pub recorded: Span,
    /// What is missing or damaged, in words.
    pub notes: Vec<String>,
}

impl OwnRecording {
    /// Reads it; of a telemetry log only the beginning.
    ///
    /// # Errors
    /// The file cannot be read or is no recording of ours, or a flag is for other recordings.
    pub fn open(flags: &SessionFlags) -> Result<Self> {
        ensure!(
            flags.data.run.is_none() && flags.data.use_every.is_none(),
            "--run and --use-every choose from a descriptor's data, not from a recording of ours"
        );
        let name = flags.recording.display().to_string();
        let settings = robot::settings(flags, &["robot"])?;
        let station = Station { settings: &settings, ..Station::default() };
        let Session { header, notes, inputs } = import::session(&flags.recording, station)?;
        Ok(Self { name, header, inputs, notes })
    }

    /// The configuration that it was made with, and what the flags and the filter change of it.
    ///
    /// # Errors
    /// It makes no sense.
    pub fn config(&self, flags: &SessionFlags, filter: Option<&str>) -> Result<Config> {
        let origin = "the recording's own configuration";
        let settings = robot::settings(flags, &["robot"])?;
        let mut config = config::load_text(origin, &self.header.config_toml, &settings)?.config;
        if let Some(filter) = filter {
            filter.clone_into(&mut config.filter.name);
        }
        Ok(config)
    }

    /// What is changed of the configuration that it was made with, in words; empty if nothing is.
    ///
    /// # Errors
    /// The recorded configuration or a flag makes no sense.
    pub fn changes(&self, flags: &SessionFlags, filters: &[String]) -> Result<Vec<String>> {
        let recorded = config::load_text("the recording's own configuration", &self.header.config_toml, &[])?;
        let others = filters.iter().filter(|name| **name != recorded.config.filter.name);
        let mut changes: Vec<String> = others.map(|name| format!("filter.name={name}")).collect();
        changes.extend(changed_settings(flags));
        Ok(changes)
    }

    /// The pipeline of a configuration.
    ///
    /// # Errors
    /// The configuration or a key makes no sense.
    pub fn pipeline(flags: &SessionFlags, config: &Config) -> Result<Pipeline> {
        let mut pipeline_config = config.pipeline()?;
        signing::recall(config, &flags.keys, &mut pipeline_config)?;
        Ok(Pipeline::new(pipeline_config, Stamp::ZERO)?)
    }

    /// The truth: that of a file, else that of the recording.
    ///
    /// # Errors
    /// The file cannot be read, or the recorded truth is damaged.
    pub fn known(&self, truth: Option<&Path>) -> Result<Known> {
        match &self.inputs {
            Inputs::Recorded(bytes) => Known::of(&self.name, bytes, truth),
            Inputs::Logged(_) => Known::of_file(truth),
        }
    }

    /// When its first input was given.
    pub fn origin(&self) -> Stamp<HostClock> {
        let Inputs::Recorded(bytes) = &self.inputs else {
            return Stamp::ZERO;
        };
        let reader = Reader::open(bytes).ok();
        let first = reader.and_then(|mut reader| reader.find_map(Result::ok));
        first.map_or(Stamp::ZERO, |(now, _)| now)
    }

    /// Gives every lane what the pipeline was given live, at the same instants.
    ///
    /// # Errors
    /// As the watchers say; or a telemetry log cannot be read any further, or nothing lies within the window.
    pub fn run(&self, lanes: &mut [Lane<'_>], window: Window, pace: Option<&Pace>) -> Result<Passage> {
        let mut notes = Notes::of(&self.notes);
        let mut course =
            Course { lanes, window, pace, first: None, recorded: Span::ZERO, has_given: false, is_over: false };
        match &self.inputs {
            Inputs::Recorded(bytes) => run_recorded(bytes, &mut course, &mut notes)?,
            Inputs::Logged(log) => {
                let left_out = log.give(&mut |now, input| course.give(now, input))?;
                for note in left_out {
                    notes.add(note);
                }
            }
        }
        let recorded = course.recorded;
        ensure!(
            course.has_given || window.is_whole(),
            "`{}`: nothing lies between --from and --to: its inputs lie between 0 and {:.3} s",
            self.name,
            recorded.as_secs_f64()
        );
        let notes = notes.finish();
        Ok(Passage { recorded, notes })
    }
}

/// The lanes on their way through a session.
struct Course<'c, 'l> {
    lanes: &'c mut [Lane<'l>],
    window: Window,
    pace: Option<&'c Pace>,
    /// When the first input was given.
    first: Option<Stamp<HostClock>>,
    recorded: Span,
    /// Something lay within the window.
    has_given: bool,
    /// All that is wanted was given.
    is_over: bool,
}

impl Course<'_, '_> {
    fn give(&mut self, now: Stamp<HostClock>, input: &Input) -> Result<()> {
        let elapsed = now - *self.first.get_or_insert(now);
        let place = self.window.place(elapsed);
        self.is_over |= place == Place::Behind;
        if self.is_over {
            return Ok(());
        }
        self.has_given |= place == Place::Within;
        if let Some(pace) = self.pace {
            pace.wait(elapsed);
        }
        for lane in &mut *self.lanes {
            lane.give(now, input, place)?;
        }
        self.recorded = self.recorded.max(elapsed);
        Ok(())
    }
}

fn run_recorded(bytes: &[u8], course: &mut Course<'_, '_>, notes: &mut Notes) -> Result<()> {
    let mut reader = Reader::open(bytes)?;
    let bar = progress::bar(bytes.len() as u64, "bytes")?;
    notes.add_lack(reader.beginning());
    while let Some(item) = reader.next() {
        match item {
            Ok((now, input)) => course.give(now, &input)?,
            Err(error) => notes.add_damage(&error),
        }
        if course.is_over {
            break;
        }
        if reader.offset() >= bar.position() + BAR_STEP {
            bar.set_position(reader.offset());
        }
    }
    bar.finish_and_clear();
    if !course.is_over {
        notes.add_ending(&reader.ending());
    }
    Ok(())
}

/// What flags lay over a configuration, in words.
pub fn changed_settings(flags: &SessionFlags) -> Vec<String> {
    let robot = flags.robot.iter();
    let mut changes: Vec<String> = robot.map(|path| format!("robot of {}", path.display())).collect();
    let settings = flags.data.settings.iter().chain(&flags.params);
    changes.extend(settings.map(ToString::to_string));
    changes
}

//! A recording of ours, read into memory: its configuration, its truth, and the way of its inputs into the engine.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use posebridge_analysis::{TimedPose, Track};
use posebridge_pipeline::Pipeline;
use posebridge_recording::container::{self, Ending, Header, Reader};
use posebridge_telemetry::{HostClock, Span, Stamp};

use super::robot;
use super::watch::{Lane, Pace, Place, Window};
use crate::cli::SessionFlags;
use crate::collect::LONGEST_GAP;
use crate::config::{self, Config};
use crate::import::{self, Station};
use crate::own_recording::lack_of;
use crate::progress;
use crate::signing;
use crate::truth_file;

/// So many damaged places are named.
const MOST_NOTES: usize = 50;
/// The bar moves when so many bytes have been read.
const BAR_STEP: u64 = 256 * 1024;

/// A recording of ours, in memory.
pub struct OwnRecording {
    /// Its path, as it was given.
    pub name: String,
    /// What it says about itself.
    pub header: Header,
    bytes: Vec<u8>,
    /// What was left out when a telemetry log was made into a recording.
    notes: Vec<String>,
}

/// Where the robot was, and where it believed to be, as far as the recording or a file beside it tells.
#[derive(Default)]
pub struct Known {
    /// The truth of a simulated run.
    pub truth: Option<Track>,
    /// The brick's own dead reckoning.
    pub odometry: Option<Track>,
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
    /// Reads it; a telemetry log becomes one in memory.
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
        let station = Station {
            settings: &settings,
            ..Station::default()
        };
        let (bytes, notes) = import::recording_bytes(&flags.recording, station)?;
        let reader = Reader::open(&bytes).with_context(|| format!("recording `{name}`"))?;
        let header = reader.header().clone();
        Ok(Self {
            name,
            header,
            bytes,
            notes,
        })
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
        let recorded = config::load_text(
            "the recording's own configuration",
            &self.header.config_toml,
            &[],
        )?;
        let others = filters
            .iter()
            .filter(|name| **name != recorded.config.filter.name);
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
        if let Some(path) = truth {
            return Ok(Known {
                truth: Some(truth_file::open(path)?),
                odometry: None,
            });
        }
        let samples = container::truth(&self.bytes)
            .with_context(|| format!("the truth in `{}`; give another with --truth", self.name))?;
        if samples.is_empty() {
            return Ok(Known::default());
        }
        let of_truth = samples.iter().map(|sample| TimedPose {
            stamp: sample.stamp,
            pose: sample.pose,
        });
        let believed = samples.iter().filter_map(|sample| {
            Some(TimedPose {
                stamp: sample.stamp,
                pose: sample.odometry?,
            })
        });
        let odometry = Track::new(believed, LONGEST_GAP);
        Ok(Known {
            truth: Some(Track::new(of_truth, LONGEST_GAP)),
            odometry: (!odometry.samples().is_empty()).then_some(odometry),
        })
    }

    /// When its first input was given.
    pub fn origin(&self) -> Stamp<HostClock> {
        let reader = Reader::open(&self.bytes).ok();
        let first = reader.and_then(|mut reader| reader.find_map(Result::ok));
        first.map_or(Stamp::ZERO, |(now, _)| now)
    }

    /// Gives every lane what the pipeline was given live, at the same instants.
    ///
    /// # Errors
    /// As the watchers say.
    pub fn run(
        &self,
        lanes: &mut [Lane<'_>],
        window: Window,
        pace: Option<&Pace>,
    ) -> Result<Passage> {
        let mut reader = Reader::open(&self.bytes)?;
        let bar = progress::bar(self.bytes.len() as u64, "bytes")?;
        let mut notes = Notes::default();
        self.notes.iter().cloned().for_each(|note| notes.add(note));
        if let Some(lack) = lack_of(reader.beginning()) {
            notes.add(format!("{lack}; the replay is not that of the live run"));
        }
        let mut first = None;
        let mut recorded = Span::ZERO;
        let mut is_over = false;
        while let Some(item) = reader.next() {
            let (now, input) = match item {
                Ok(given) => given,
                // What is whole behind the damage is still worth replaying.
                Err(error) => {
                    notes.add(format!(
                        "{error}; the replay is not that of the live run any more"
                    ));
                    continue;
                }
            };
            let elapsed = now - *first.get_or_insert(now);
            let place = window.place(elapsed);
            if place == Place::Behind {
                is_over = true;
                break;
            }
            if let Some(pace) = pace {
                pace.wait(elapsed);
            }
            for lane in &mut *lanes {
                lane.give(now, &input, place)?;
            }
            recorded = recorded.max(elapsed);
            if reader.offset() >= bar.position() + BAR_STEP {
                bar.set_position(reader.offset());
            }
        }
        bar.finish_and_clear();
        if let (Ending::Torn { offset, what }, false) = (reader.ending(), is_over) {
            notes.add(format!(
                "cut off at byte {offset} ({what}); everything before was replayed"
            ));
        }
        let notes = notes.finish();
        Ok(Passage { recorded, notes })
    }
}

/// What flags lay over a configuration, in words.
pub fn changed_settings(flags: &SessionFlags) -> Vec<String> {
    let robot = flags.robot.iter();
    let mut changes: Vec<String> = robot
        .map(|path| format!("robot of {}", path.display()))
        .collect();
    let settings = flags.data.settings.iter().chain(&flags.params);
    changes.extend(settings.map(ToString::to_string));
    changes
}

/// What is missing or damaged: the first of them in words, the others as a number.
#[derive(Default)]
struct Notes {
    told: Vec<String>,
    more: u64,
}

impl Notes {
    fn add(&mut self, note: String) {
        if self.told.len() < MOST_NOTES {
            self.told.push(note);
        } else {
            self.more += 1;
        }
    }

    fn finish(mut self) -> Vec<String> {
        if self.more > 0 {
            self.told
                .push(format!("{} more places are damaged", self.more));
        }
        self.told
    }
}

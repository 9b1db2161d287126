//! What a session, or the runs of a foreign recording, came to: what the page, the text and the JSON object of `report` are made of.

use posebridge_analysis::metrics::{Judgement, Tone};
use posebridge_analysis::{ErrorSummary, SourceTally, Track};
use posebridge_telemetry::SensorId;

use super::chronicle::Chronicle;
use crate::learned::Learned;

/// Everything that is told.
pub struct Story {
    /// The recording, as it was given.
    pub recording: String,
    /// What it says about itself: name and value.
    pub facts: Vec<(String, String)>,
    /// The filter that was run.
    pub filter: String,
    /// What was laid over the recording's own configuration.
    pub changed: Vec<String>,
    /// What is missing or damaged.
    pub notes: Vec<String>,
    /// The whole session, or the runs of a descriptor.
    pub runs: Vec<RunStory>,
}

/// By what errors are judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Yardstick {
    /// Where the robot really was.
    Truth,
    /// Fixes that the filter was not given.
    WithheldFixes,
    /// Nothing.
    None,
}

/// One run.
pub struct RunStory {
    /// Its name.
    pub name: String,
    /// What happened in it.
    pub chronicle: Chronicle,
    /// How far off the estimate was, as `replay` has it.
    pub errors: ErrorSummary,
    /// Against what.
    pub yardstick: Yardstick,
    /// Where the robot was.
    pub truth: Option<Track>,
    /// Where the brick alone believed it was, or where the wheels alone say it was.
    pub odometry: Option<Track>,
    /// What the filter has learned.
    pub learned: Option<Learned>,
}

/// What is to be thought of one sensor.
#[derive(Clone, Copy, Debug)]
pub struct SourceVerdict {
    /// The sensor.
    pub sensor: SensorId,
    /// What became of its observations, as `replay` has it.
    pub tally: SourceTally,
    /// By its innovations.
    pub judgement: Judgement,
}

impl RunStory {
    /// A verdict for every sensor that was heard.
    #[must_use]
    pub fn verdicts(&self) -> Vec<SourceVerdict> {
        let sources = self.chronicle.sources.iter();
        sources
            .filter_map(|source| {
                Some(SourceVerdict {
                    sensor: source.sensor,
                    tally: *self.chronicle.tally(source.sensor)?,
                    judgement: source.test.judge(),
                })
            })
            .collect()
    }

    /// The verdict on the whole run: bad if any sensor's is, good if at least one could be judged.
    #[must_use]
    pub fn verdict(&self) -> (Tone, &'static str, String) {
        let verdicts = self.verdicts();
        let with = |tone: Tone| {
            let these = verdicts.iter().filter(|one| one.judgement.tone() == tone);
            these.map(|one| one.sensor.name()).collect::<Vec<_>>()
        };
        let (bad, good) = (with(Tone::Bad), with(Tone::Good));
        if !bad.is_empty() {
            let text = format!("look at {}: what to do stands with it below", bad.join(", "));
            return (Tone::Bad, "Not all is well:", text);
        }
        if good.is_empty() {
            let text = "no sensor has been predicted often enough to judge the filter by it".to_owned();
            return (Tone::Open, "Nothing to judge by:", text);
        }
        let text = format!("what the filter claims fits what it saw of {}", good.join(", "));
        (Tone::Good, "All is well:", text)
    }
}

/// A name in words for the yardstick.
impl Yardstick {
    /// As a sentence has it.
    #[must_use]
    pub const fn in_words(self) -> &'static str {
        match self {
            Self::Truth => "the truth",
            Self::WithheldFixes => "fixes that were withheld",
            Self::None => "nothing",
        }
    }
}

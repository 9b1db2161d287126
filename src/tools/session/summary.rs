//! What a session, or the runs of a foreign recording, came to: what the page, the text and the JSON object of `report` are made of.

use posebridge_report::metrics::{InnovationVerdict, VerdictTone};
use posebridge_report::{ErrorSummary, PoseTrack, SourceTally};
use posebridge_telemetry::{LinkCounter, SensorId};

use super::history::SessionHistory;
use crate::station::learned_calibration::LearnedCalibration;

/// What is reported of each link.
pub const LINK_COUNTERS: [LinkCounter; 8] = [
    LinkCounter::FRAMES_IN,
    LinkCounter::FRAMES_OUT,
    LinkCounter::FRAMES_LOST,
    LinkCounter::CHECKSUM_ERRORS,
    LinkCounter::GARBAGE_BYTES,
    LinkCounter::TIMEOUTS,
    LinkCounter::UNSENT,
    LinkCounter::RECONNECTS,
];

/// Everything that is reported.
pub struct SessionSummary {
    /// The recording, as it was given.
    pub recording: String,
    /// Its own description: name and value.
    pub facts: Vec<(String, String)>,
    /// The filter that was run.
    pub filter: String,
    /// What was laid over the recording's own configuration.
    pub changed: Vec<String>,
    /// What is missing or damaged.
    pub notes: Vec<String>,
    /// The whole session, or the runs of a descriptor.
    pub runs: Vec<RunSummary>,
}

/// The reference for errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScoreReference {
    /// Where the robot really was.
    Truth,
    /// Fixes that the filter was not given.
    WithheldFixes,
    /// Nothing.
    None,
}

/// One run.
pub struct RunSummary {
    /// Its name.
    pub name: String,
    /// What happened in it.
    pub history: SessionHistory,
    /// How far off the estimate was, as `replay` has it.
    pub errors: ErrorSummary,
    /// Against what.
    pub reference: ScoreReference,
    /// Where the robot was.
    pub truth: Option<PoseTrack>,
    /// The path by the brick's own odometry, or by the wheels alone.
    pub odometry: Option<PoseTrack>,
    /// What the filter has learned.
    pub learned: Option<LearnedCalibration>,
}

/// What is to be thought of one sensor.
#[derive(Clone, Copy, Debug)]
pub struct SourceSummary {
    /// The sensor.
    pub sensor: SensorId,
    /// What became of its observations, as `replay` has it.
    pub tally: SourceTally,
    /// By its innovations.
    pub assessment: InnovationVerdict,
}

impl RunSummary {
    /// A verdict for every sensor that was heard.
    pub fn source_summaries(&self) -> Vec<SourceSummary> {
        let sources = self.history.sources.iter();
        sources
            .filter_map(|source| {
                Some(SourceSummary {
                    sensor: source.sensor,
                    tally: *self.history.tally(source.sensor)?,
                    assessment: source.test.evaluate(),
                })
            })
            .collect()
    }

    /// The verdict on the whole run: bad if any sensor's is, good if at least one could be tested.
    pub fn verdict(&self) -> (VerdictTone, &'static str, String) {
        let verdicts = self.source_summaries();
        let with = |tone: VerdictTone| {
            let these = verdicts.iter().filter(|one| one.assessment.tone() == tone);
            these.map(|one| one.sensor.name()).collect::<Vec<_>>()
        };
        let (bad, good) = (with(VerdictTone::Bad), with(VerdictTone::Good));
        if !bad.is_empty() {
            let text = format!("look at {}: what to do stands with it below", bad.join(", "));
            return (VerdictTone::Bad, "Not all is well:", text);
        }
        if good.is_empty() {
            let text = "no sensor has been predicted often enough to judge the filter by it".to_owned();
            return (VerdictTone::Inconclusive, "Nothing to judge by:", text);
        }
        let text = format!("what the filter claims fits what it saw of {}", good.join(", "));
        (VerdictTone::Good, "All is well:", text)
    }
}

/// The name of the reference, for people.
impl ScoreReference {
    /// As a sentence has it.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Truth => "the truth",
            Self::WithheldFixes => "fixes that were withheld",
            Self::None => "nothing",
        }
    }
}

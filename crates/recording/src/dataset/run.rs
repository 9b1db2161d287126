//! One run of a foreign recording, ready to be replayed and scored: what is good, which rows are bad, and why a run cannot be loaded.

use std::collections::{BTreeMap, BTreeSet};
use std::{fmt, io};

use posebridge_telemetry::{
    Arena, BeaconId, BrickClock, Fix, Heading, HostClock, LandmarkId, Observation, Point2, StartPose, Timestamp,
};

/// One run of a foreign recording.
///
/// Brick and host stamps are on one time base, the data's own; nothing is subtracted but the descriptor's `offset_s`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DatasetRun {
    /// The run's name in its descriptor.
    pub name: String,
    /// Where the robot stood at the start, if the descriptor knows.
    pub start: Option<StartPose>,
    /// What the robot's sensors and cameras said, sorted by arrival.
    pub observations: Vec<TimedObservation>,
    /// Where the robot really was, by an instrument of its own; for scoring only.
    pub truth: Vec<TruthPose>,
    /// Fixes that were kept from the filter; for scoring only.
    pub withheld: Vec<WithheldFix>,
    /// Places of the landmarks.
    pub landmarks: Vec<(LandmarkId, Point2<Arena>)>,
    /// Places of the radio beacons.
    pub beacons: Vec<(BeaconId, Point2<Arena>)>,
    /// Rows that were left out, and why.
    pub bad_rows: BadRows,
}

/// An observation with the instant at which the host had it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedObservation {
    /// When it arrived; equal to its own stamp where the recording does not say.
    pub arrival: Timestamp<HostClock>,
    /// The observation.
    pub observation: Observation,
}

/// The true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthPose {
    /// The instant.
    pub time: Timestamp<BrickClock>,
    /// Where the body's origin was.
    pub position: Point2<Arena>,
    /// The body's heading, if the instrument measures it.
    pub heading: Option<Heading>,
}

/// A fix that the filter does not get.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithheldFix {
    /// The instant of the fix.
    pub time: Timestamp<BrickClock>,
    /// The fix; its position is that of the tag and not of the body.
    pub fix: Fix,
}

/// How many bad rows are named; the rest is only counted.
const MAX_LISTED_ROWS: usize = 20;

/// Why a row was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BadRowReason {
    /// The row has too few columns.
    MissingColumn,
    /// A value is not a finite number.
    NotNumeric,
    /// The time is earlier than that of the row before.
    TimeBackwards,
    /// The time is that of the row before, where an interval is needed.
    ZeroInterval,
    /// A fix repeats the stamp of the one before.
    RepeatedTimestamp,
    /// The value or the time leaps further than the descriptor says is possible.
    ImpossibleJump,
    /// The value is outside the limits that the descriptor sets.
    OutOfRange,
    /// The row names a landmark or beacon that the maps do not have.
    UnknownId,
}

impl BadRowReason {
    /// The reason in words, as reports print it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::MissingColumn => "missing column",
            Self::NotNumeric => "not a number",
            Self::TimeBackwards => "time goes back",
            Self::ZeroInterval => "zero interval",
            Self::RepeatedTimestamp => "repeated stamp",
            Self::ImpossibleJump => "impossible jump",
            Self::OutOfRange => "out of range",
            Self::UnknownId => "unknown id",
        }
    }
}

/// One row that was left out.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BadRow {
    /// The file, as the descriptor names it.
    pub file: String,
    /// The line, from 1.
    pub line: usize,
    /// Why.
    pub reason: BadRowReason,
    /// The value at fault.
    pub detail: String,
}

impl fmt::Display for BadRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, line, reason) = (&self.file, self.line, self.reason.name());
        write!(f, "{file}:{line}: {reason}: {}", self.detail)
    }
}

/// All rows of a run that were left out. A row that two streams refuse for the same reason counts once.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BadRows {
    /// How many, by reason; reasons that did not occur are absent.
    pub counts: BTreeMap<BadRowReason, usize>,
    /// The first 20, in the order in which they were met.
    pub listed: Vec<BadRow>,
    already_counted: BTreeSet<(String, usize, BadRowReason)>,
}

impl BadRows {
    /// How many rows were left out in all.
    pub fn total(&self) -> usize {
        self.counts.values().sum()
    }

    /// How many rows were left out for this reason.
    pub fn count(&self, reason: BadRowReason) -> usize {
        self.counts.get(&reason).copied().unwrap_or(0)
    }

    pub(super) fn add(&mut self, file: &str, line: usize, fault: RowError) {
        let RowError { reason, detail } = fault;
        if !self.already_counted.insert((file.to_owned(), line, reason)) {
            return;
        }
        *self.counts.entry(reason).or_insert(0) += 1;
        if self.listed.len() < MAX_LISTED_ROWS {
            self.listed.push(BadRow { file: file.to_owned(), line, reason, detail });
        }
    }
}

/// What is wrong with the row at hand.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RowError {
    pub(super) reason: BadRowReason,
    pub(super) detail: String,
}

impl RowError {
    pub(super) fn new(reason: BadRowReason, detail: impl Into<String>) -> Self {
        Self { reason, detail: detail.into() }
    }
}

/// Why a run cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// No run, or more than one, goes by this name.
    #[error("{matches} runs begin with `{asked}`: use one of: {known}")]
    Run { asked: String, matches: usize, known: String },
    #[error("run `{run}`: {message}")]
    Template { run: String, message: String },
    #[error("cannot read {path}: say with --data where the recordings lie")]
    Open { path: String, source: io::Error },
    #[error("{path} is damaged or not gzip")]
    Gzip { path: String, source: io::Error },
    /// A file is larger than any recording of a small robot.
    #[error("{path} unpacks to more than 1 GiB")]
    TooLarge { path: String },
    #[error("{path}: there is no column `{column}`, the header has: {known}")]
    NoColumn { path: String, column: String, known: String },
}

//! One run of a foreign recording, ready for replay and scoring, with its bad rows and load errors.

use std::collections::BTreeMap;
use std::{fmt, io};

use posebridge_telemetry::{Arena, BeaconId, BrickClock, Fix, Heading, LandmarkId, Point2, StartPose, Timestamp};

use super::observation_list::ObservationList;
use crate::csv_dialect::AmbiguousDialect;
use crate::ros2::bag::BagError;

/// Limit of the numbers of a run in memory: some forty million readings. Larger than any recording of a small robot.
pub(super) const MAX_HELD_BYTES: u64 = 1 << 30;

/// One run of a foreign recording.
///
/// Brick and host timestamps share the time base of the data; only the descriptor's `offset_s` is subtracted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DatasetRun {
    pub name: String,
    pub start: Option<StartPose>,
    pub observations: ObservationList,
    /// From a separate instrument; for scoring only.
    pub truth: Vec<TruthPose>,
    /// Fixes withheld from the filter; for scoring only.
    pub withheld: Vec<WithheldFix>,
    pub landmarks: Vec<(LandmarkId, Point2<Arena>)>,
    pub beacons: Vec<(BeaconId, Point2<Arena>)>,
    pub bad_rows: BadRows,
    /// Dialects that were found in its files, as file and words.
    pub dialects: Vec<String>,
}

impl DatasetRun {
    /// Memory of its numbers.
    pub(super) fn held_bytes(&self) -> u64 {
        let references = self.truth.len() * size_of::<TruthPose>() + self.withheld.len() * size_of::<WithheldFix>();
        self.observations.bytes() + references as u64
    }
}

/// The true pose at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthPose {
    pub time: Timestamp<BrickClock>,
    /// Of the body's origin.
    pub position: Point2<Arena>,
    /// `None` if the instrument does not measure it.
    pub heading: Option<Heading>,
}

/// A fix withheld from the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithheldFix {
    pub time: Timestamp<BrickClock>,
    /// Position of the tag, not of the body.
    pub fix: Fix,
}

/// Bad rows that are listed; more are only counted.
const MAX_LISTED_ROWS: usize = 20;

/// Why a row of a file was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BadRowReason {
    MissingColumn,
    /// More fields than the header has, as decimal commas make them.
    ExtraColumn,
    NotNumeric,
    TimeBackwards,
    /// Equal to the previous row, where an interval is needed.
    ZeroInterval,
    /// A fix has the timestamp of the previous one.
    RepeatedTimestamp,
    ImpossibleJump,
    /// Outside the limits in the descriptor.
    OutOfRange,
    /// A landmark or beacon that is not in the map.
    UnknownId,
    /// A message of a bag that cannot be decoded.
    Damaged,
}

impl BadRowReason {
    /// The reason in words, as in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::MissingColumn => "missing column",
            Self::ExtraColumn => "more columns than the header",
            Self::NotNumeric => "not a number",
            Self::TimeBackwards => "time goes back",
            Self::ZeroInterval => "zero interval",
            Self::RepeatedTimestamp => "repeated stamp",
            Self::ImpossibleJump => "impossible jump",
            Self::OutOfRange => "out of range",
            Self::UnknownId => "unknown id",
            Self::Damaged => "damaged message",
        }
    }
}

/// A rejected row.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BadRow {
    /// As written in the descriptor.
    pub file: String,
    /// From 1.
    pub line: usize,
    pub reason: BadRowReason,
    pub detail: String,
}

impl fmt::Display for BadRow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (file, line, reason) = (&self.file, self.line, self.reason.name());
        write!(f, "{file}:{line}: {reason}: {}", self.detail)
    }
}

/// All rejected rows of a run. A row that two streams reject for the same reason counts once.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BadRows {
    /// By reason; absent if it did not occur.
    pub counts: BTreeMap<BadRowReason, usize>,
    /// The first 20, in reading order.
    pub listed: Vec<BadRow>,
    /// A bit for each line, so that a file of nothing but bad rows fills no memory.
    already_counted: BTreeMap<(String, BadRowReason), Vec<u64>>,
}

impl BadRows {
    pub fn total(&self) -> usize {
        self.counts.values().sum()
    }

    pub fn count(&self, reason: BadRowReason) -> usize {
        self.counts.get(&reason).copied().unwrap_or(0)
    }

    pub(super) fn add(&mut self, file: &str, line: usize, fault: RowError) {
        let RowError { reason, detail } = fault;
        let lines = self.already_counted.entry((file.to_owned(), reason)).or_default();
        let (word, bit) = (line / 64, 1 << (line % 64));
        if lines.len() <= word {
            lines.resize(word + 1, 0);
        }
        if lines[word] & bit != 0 {
            return;
        }
        lines[word] |= bit;
        *self.counts.entry(reason).or_insert(0) += 1;
        if self.listed.len() < MAX_LISTED_ROWS {
            self.listed.push(BadRow { file: file.to_owned(), line, reason, detail });
        }
    }
}

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

/// Why a run of a foreign recording cannot be loaded.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// No run, or more than one, matches this name.
    #[error("{matches} runs begin with `{asked}`: use one of: {known}")]
    Run { asked: String, matches: usize, known: String },
    #[error("run `{run}`: {message}")]
    Template { run: String, message: String },
    #[error("cannot read {path}: say with --data where the recordings lie")]
    Open { path: String, source: io::Error },
    /// A bag that cannot be read, or without the topic.
    #[error("{path}: the bag cannot be read")]
    Bag { path: String, source: BagError },
    #[error("{path} is damaged or not gzip")]
    Gzip { path: String, source: io::Error },
    /// Larger than any recording of a small robot.
    #[error("{path} unpacks to more than 1 GiB")]
    TooLarge { path: String },
    #[error("{path}:{line}: the line is longer than 1 MiB: is it a table?")]
    LongLine { path: String, line: usize },
    #[error("{path}:{line}: up to here the run holds more than 1 GiB of numbers: cut it into several runs")]
    TooMuch { path: String, line: usize },
    /// It can be read in two ways.
    #[error("{path}:{}: {source}", source.line)]
    Dialect { path: String, source: AmbiguousDialect },
    #[error("{path}:{line}: there is no column `{column}`, the header has: {known}{hint}")]
    NoColumn {
        path: String,
        /// Of the header, from 1.
        line: usize,
        column: String,
        known: String,
        /// What may be wrong instead; empty if nothing is known.
        hint: &'static str,
    },
    /// A file whose descriptor names header lines.
    #[error("{path} is empty: line {line} should be the header")]
    Empty { path: String, line: usize },
}

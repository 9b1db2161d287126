//! Bad rows: counted by reason, the first ones named. They never end a run.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

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

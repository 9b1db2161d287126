//! Rows that make no sense: counted by reason, the first ones named, never the end of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// How many bad rows are named; the rest is only counted.
const NAMED_ROWS: usize = 20;

/// Why a row was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// The row has too few columns.
    MissingColumn,
    /// A value is not a finite number.
    NotNumeric,
    /// The time is earlier than that of the row before.
    TimeBackwards,
    /// The time is that of the row before, where an interval is needed.
    ZeroInterval,
    /// A fix repeats the stamp of the one before.
    RepeatedStamp,
    /// The value or the time leaps further than the descriptor says is possible.
    ImpossibleJump,
    /// The value is outside the limits that the descriptor sets.
    OutOfRange,
    /// The row speaks of a landmark or beacon that the maps do not have.
    UnknownId,
}

impl Reason {
    /// The reason in words, as reports print it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::MissingColumn => "missing column",
            Self::NotNumeric => "not a number",
            Self::TimeBackwards => "time goes back",
            Self::ZeroInterval => "zero interval",
            Self::RepeatedStamp => "repeated stamp",
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
    pub reason: Reason,
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
    pub counts: BTreeMap<Reason, usize>,
    /// The first 20, in the order in which they were met.
    pub named: Vec<BadRow>,
    seen: BTreeSet<(String, usize, Reason)>,
}

impl BadRows {
    /// How many rows were left out in all.
    pub fn total(&self) -> usize {
        self.counts.values().sum()
    }

    /// How many rows were left out for this reason.
    pub fn count(&self, reason: Reason) -> usize {
        self.counts.get(&reason).copied().unwrap_or(0)
    }

    pub(super) fn add(&mut self, file: &str, line: usize, fault: Fault) {
        let Fault { reason, detail } = fault;
        if !self.seen.insert((file.to_owned(), line, reason)) {
            return;
        }
        *self.counts.entry(reason).or_insert(0) += 1;
        if self.named.len() < NAMED_ROWS {
            self.named.push(BadRow { file: file.to_owned(), line, reason, detail });
        }
    }
}

/// What is wrong with the row at hand.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Fault {
    pub(super) reason: Reason,
    pub(super) detail: String,
}

impl Fault {
    pub(super) fn new(reason: Reason, detail: impl Into<String>) -> Self {
        Self { reason, detail: detail.into() }
    }
}

//! Readers that convert the rows of each kind of stream to values.
//!
//! A stream's columns are bound once per file; the resulting [`RowReader`] keeps its state from row to row. It gets the
//! time step since the last good row and decides what to do with it: a counter loses nothing on a row without an
//! interval, a rate does.

pub(super) mod positions;
pub(super) mod sensors;
pub(super) mod wheels;

use super::run::{BadRowReason, RowError};
use super::table::TableRow;

/// Turns rows into values; `None` for a good row that says nothing new.
pub(super) type RowReader<T> = Box<dyn FnMut(&TableRow<'_>, TimeStep) -> Result<Option<T>, RowError>>;

/// How a row's time follows that of the last good row; intervals are positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TimeStep {
    /// There is no row before.
    First,
    Forward {
        interval_s: f64,
    },
    /// At the same time.
    Repeated,
    Backward {
        nanos: i64,
    },
    /// Later by more than the descriptor says is possible.
    Jump {
        nanos: i64,
    },
}

impl TimeStep {
    /// The interval since the last good row, `None` for the first.
    pub(super) fn interval_s(self) -> Result<Option<f64>, RowError> {
        let fault = match self {
            Self::First => return Ok(None),
            Self::Forward { interval_s } => return Ok(Some(interval_s)),
            Self::Repeated => RowError::new(BadRowReason::ZeroInterval, "the stamp of the row before"),
            Self::Backward { nanos } => {
                let detail = format!("by {} s", nanos as f64 * 1e-9);
                RowError::new(BadRowReason::TimeBackwards, detail)
            }
            Self::Jump { nanos } => {
                let detail = format!("the time leaps by {} s", nanos as f64 * 1e-9);
                RowError::new(BadRowReason::ImpossibleJump, detail)
            }
        };
        Err(fault)
    }

    /// As [`TimeStep::interval_s`], where several rows may have one instant.
    pub(super) fn require_in_order(self) -> Result<(), RowError> {
        match self {
            Self::Repeated => Ok(()),
            Self::First | Self::Forward { .. } | Self::Backward { .. } | Self::Jump { .. } => {
                self.interval_s().map(|_| ())
            }
        }
    }
}

/// Follows the stamps of one stream.
#[derive(Debug)]
pub(super) struct RowClock {
    last: Option<i64>,
    suspect: Option<i64>,
    max_gap_nanos: Option<i64>,
}

impl RowClock {
    pub(super) fn new(max_gap_nanos: Option<i64>) -> Self {
        Self { last: None, suspect: None, max_gap_nanos }
    }

    /// How this stamp follows the last good one. A leap that the next row confirms is a real gap and no leap.
    pub(super) fn classify(&mut self, nanos: i64) -> TimeStep {
        let Some(last) = self.last else {
            return TimeStep::First;
        };
        let forward = nanos.saturating_sub(last);
        if forward < 0 {
            return TimeStep::Backward { nanos: forward.saturating_neg() };
        }
        if forward == 0 {
            return TimeStep::Repeated;
        }
        if let Some(max_gap) = self.max_gap_nanos
            && forward > max_gap
        {
            let since_doubted = self.suspect.map(|doubted| nanos.saturating_sub(doubted));
            if !since_doubted.is_some_and(|since| (0..=max_gap).contains(&since)) {
                self.suspect = Some(nanos);
                return TimeStep::Jump { nanos: forward };
            }
        }
        TimeStep::Forward { interval_s: forward as f64 * 1e-9 }
    }

    /// Takes this stamp as the last good one.
    pub(super) fn accept(&mut self, nanos: i64) {
        self.last = Some(nanos);
        self.suspect = None;
    }
}

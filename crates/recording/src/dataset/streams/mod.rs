//! Readers that convert the rows of each kind of stream to values.
//!
//! A stream's columns are bound once per file; the resulting [`RowReader`] keeps its state from row to row. It receives the time step
//! since the last good row: a counter loses nothing on a row without an interval, a rate does.

pub(super) mod positions;
pub(super) mod sensors;

use super::run::{BadRowReason, RowError};
use super::table::TableRow;

/// Converts a row to a value; `None` for a valid row without new information.
pub(super) type RowReader<T> = Box<dyn FnMut(&TableRow<'_>, TimeStep) -> Result<Option<T>, RowError>>;

/// Time step of a row since the last good row; intervals are positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum TimeStep {
    First,
    Forward {
        interval_s: f64,
    },
    /// Equal timestamps.
    Repeated,
    Backward {
        nanos: i64,
    },
    /// Longer than the descriptor permits.
    Jump {
        nanos: i64,
    },
}

impl TimeStep {
    /// The interval since the last good row; `None` for the first.
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

    /// Like [`TimeStep::interval_s`], but allows several rows with one timestamp.
    pub(super) fn require_in_order(self) -> Result<(), RowError> {
        match self {
            Self::Repeated => Ok(()),
            Self::First | Self::Forward { .. } | Self::Backward { .. } | Self::Jump { .. } => {
                self.interval_s().map(|_| ())
            }
        }
    }
}

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

    /// Compares a timestamp with the last good one. A jump that the next row confirms is a real gap.
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
            let since_suspect = self.suspect.map(|suspect_since| nanos.saturating_sub(suspect_since));
            if !since_suspect.is_some_and(|since| (0..=max_gap).contains(&since)) {
                self.suspect = Some(nanos);
                return TimeStep::Jump { nanos: forward };
            }
        }
        TimeStep::Forward { interval_s: forward as f64 * 1e-9 }
    }

    pub(super) fn accept(&mut self, nanos: i64) {
        self.last = Some(nanos);
        self.suspect = None;
    }
}

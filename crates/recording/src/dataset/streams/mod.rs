//! How rows of each kind of stream become values, one after the other.
//!
//! A stream's columns are bound once per file; the [`Reader`] that results keeps what it needs from row to row. It sees
//! how the row's time follows the last good one and decides itself what that means: a counter loses nothing on a row
//! without an interval, a rate does.

pub(super) mod plain;
pub(super) mod positions;
pub(super) mod ranges;
pub(super) mod wheels;

use super::bad_rows::{Fault, Reason};
use super::table::Row;

/// Turns rows into values; `None` for a good row that says nothing new.
pub(super) type Reader<T> = Box<dyn FnMut(&Row<'_>, Step) -> Result<Option<T>, Fault>>;

/// How a row's time follows that of the last good row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Step {
    /// There is no row before.
    First,
    /// Later, by so many seconds.
    Forward {
        /// The interval, positive.
        interval_s: f64,
    },
    /// At the same time.
    Same,
    /// Earlier, by so many nanoseconds.
    Back {
        /// The interval, positive.
        nanos: i64,
    },
    /// Later by more than the descriptor says is possible.
    Leap {
        /// The interval, positive.
        nanos: i64,
    },
}

impl Step {
    /// The interval since the last good row, `None` for the first.
    pub(super) fn interval_s(self) -> Result<Option<f64>, Fault> {
        let fault = match self {
            Self::First => return Ok(None),
            Self::Forward { interval_s } => return Ok(Some(interval_s)),
            Self::Same => Fault::new(Reason::ZeroInterval, "the stamp of the row before"),
            Self::Back { nanos } => {
                let detail = format!("by {} s", nanos as f64 * 1e-9);
                Fault::new(Reason::TimeBackwards, detail)
            }
            Self::Leap { nanos } => {
                let detail = format!("the time leaps by {} s", nanos as f64 * 1e-9);
                Fault::new(Reason::ImpossibleJump, detail)
            }
        };
        Err(fault)
    }

    /// As [`Step::interval_s`], where several rows may speak of one instant.
    pub(super) fn in_order(self) -> Result<(), Fault> {
        match self {
            Self::Same => Ok(()),
            Self::First | Self::Forward { .. } | Self::Back { .. } | Self::Leap { .. } => self.interval_s().map(|_| ()),
        }
    }
}

/// Follows the stamps of one stream.
#[derive(Debug)]
pub(super) struct Clock {
    last: Option<i64>,
    doubted: Option<i64>,
    max_gap_nanos: Option<i64>,
}

impl Clock {
    pub(super) fn new(max_gap_nanos: Option<i64>) -> Self {
        Self { last: None, doubted: None, max_gap_nanos }
    }

    /// How this stamp follows the last good one. A leap that the next row confirms is a real gap and no leap.
    pub(super) fn step(&mut self, nanos: i64) -> Step {
        let Some(last) = self.last else {
            return Step::First;
        };
        let forward = nanos.saturating_sub(last);
        if forward < 0 {
            return Step::Back { nanos: forward.saturating_neg() };
        }
        if forward == 0 {
            return Step::Same;
        }
        if let Some(max_gap) = self.max_gap_nanos
            && forward > max_gap
        {
            let since_doubted = self.doubted.map(|doubted| nanos.saturating_sub(doubted));
            if !since_doubted.is_some_and(|since| (0..=max_gap).contains(&since)) {
                self.doubted = Some(nanos);
                return Step::Leap { nanos: forward };
            }
        }
        Step::Forward { interval_s: forward as f64 * 1e-9 }
    }

    /// Takes this stamp as the last good one.
    pub(super) fn accept(&mut self, nanos: i64) {
        self.last = Some(nanos);
        self.doubted = None;
    }
}

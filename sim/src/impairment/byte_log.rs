//! The outcome of every offered byte: counters, and a log by unit and byte range.
//!
//! The counters balance: offered bytes are delivered, lost for a cause, or still in transit.

use std::collections::VecDeque;
use std::ops::Range;

use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use serde::Serialize;

/// Beyond this the oldest entries are dropped and counted.
const LOG_ENTRIES: usize = 1 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LossCause {
    BufferFull,
    /// The whole unit was lost, independently of others.
    Unit,
    /// Lost in the bad state of the burst model, or by the loss of its good state.
    Burst,
    Byte,
    LinkDown,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOutcome {
    Delivered {
        at: Timestamp<HostClock>,
    },
    Duplicated {
        at: Timestamp<HostClock>,
    },
    Lost(LossCause),
    /// One bit of the single byte of the range was inverted.
    Flipped {
        /// 0 is the lowest.
        bit: u8,
    },
    /// Delayed together with everything behind them.
    Stalled {
        by: TimeDelta,
    },
    HeldBack {
        by: TimeDelta,
    },
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogEntry {
    /// Counted from 0 in the order of offering.
    pub unit: u64,
    pub bytes: Range<usize>,
    pub outcome: ByteOutcome,
}

/// Counts of one direction since it was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counters {
    pub units_offered: u64,
    pub bytes_offered: u64,
    pub chunks_delivered: u64,
    /// Without copies.
    pub bytes_delivered: u64,
    pub bytes_on_the_way: u64,
    pub bytes_lost_to_full_buffer: u64,
    pub bytes_lost_alone: u64,
    pub bytes_lost_in_bursts: u64,
    pub bytes_missing: u64,
    /// In transit when the link went down, or offered while it was down.
    pub bytes_lost_to_outages: u64,
    pub bits_flipped: u64,
    pub stalls: u64,
    /// Datagrams that were overtaken.
    pub held_back: u64,
    pub repeated: u64,
    pub bytes_repeated: u64,
    /// Log entries dropped because they were not read in time.
    pub log_forgotten: u64,
}

impl Counters {
    pub const fn bytes_lost(&self) -> u64 {
        self.bytes_lost_to_full_buffer
            + self.bytes_lost_alone
            + self.bytes_lost_in_bursts
            + self.bytes_missing
            + self.bytes_lost_to_outages
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct ByteAccount {
    pub(super) counters: Counters,
    log: VecDeque<LogEntry>,
}

impl ByteAccount {
    pub(super) const fn on_offered(&mut self, bytes: usize) {
        self.counters.units_offered += 1;
        self.counters.bytes_offered += bytes as u64;
        self.counters.bytes_on_the_way += bytes as u64;
    }

    pub(super) fn record(&mut self, unit: u64, bytes: Range<usize>, outcome: ByteOutcome) {
        if bytes.is_empty() {
            return;
        }
        self.count(bytes.len() as u64, outcome);
        if self.log.len() >= LOG_ENTRIES {
            self.log.pop_front();
            self.counters.log_forgotten += 1;
        }
        self.log.push_back(LogEntry { unit, bytes, outcome });
    }

    pub(super) fn take_log(&mut self) -> Vec<LogEntry> {
        std::mem::take(&mut self.log).into()
    }

    const fn count(&mut self, bytes: u64, outcome: ByteOutcome) {
        let counters = &mut self.counters;
        let tally = match outcome {
            ByteOutcome::Delivered { .. } => &mut counters.bytes_delivered,
            ByteOutcome::Lost(LossCause::BufferFull) => &mut counters.bytes_lost_to_full_buffer,
            ByteOutcome::Lost(LossCause::Unit) => &mut counters.bytes_lost_alone,
            ByteOutcome::Lost(LossCause::Burst) => &mut counters.bytes_lost_in_bursts,
            ByteOutcome::Lost(LossCause::Byte) => &mut counters.bytes_missing,
            ByteOutcome::Lost(LossCause::LinkDown) => &mut counters.bytes_lost_to_outages,
            ByteOutcome::Duplicated { .. } => {
                counters.repeated += 1;
                counters.bytes_repeated += bytes;
                return;
            }
            ByteOutcome::Flipped { .. } => {
                counters.bits_flipped += 1;
                return;
            }
            ByteOutcome::Stalled { .. } => {
                counters.stalls += 1;
                return;
            }
            ByteOutcome::HeldBack { .. } => {
                counters.held_back += 1;
                return;
            }
        };
        *tally += bytes;
        counters.bytes_on_the_way -= bytes;
    }
}

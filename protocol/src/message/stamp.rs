//! Time stamps as they stand on the wire.

use posebridge_telemetry::{HostClock, Timestamp};

/// A time stamp as it stood on the wire, before unwrapping and alignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireStamp {
    /// Microseconds in 32 bits; wraps after 71.6 minutes.
    Micros32(u32),
    /// Milliseconds in 32 bits; wraps after 49.7 days.
    Millis32(u32),
    /// Microseconds in 64 bits.
    Micros64(u64),
    /// None: the brick was asked, and looked between question and answer by the clock of whoever asked. Never on a wire.
    HostInterval {
        /// When the question left.
        sent: Timestamp<HostClock>,
        /// When the last byte of the answer was there.
        answered: Timestamp<HostClock>,
    },
}

impl WireStamp {
    /// In whole microseconds as it stands there; of an answer the middle between question and answer, by the clock of who asked.
    pub const fn as_micros(self) -> u64 {
        match self {
            Self::Micros32(micros) => micros as u64,
            Self::Millis32(millis) => millis as u64 * 1_000,
            Self::Micros64(micros) => micros,
            Self::HostInterval { sent, answered } => {
                i64::midpoint(sent.as_nanos(), answered.as_nanos()).unsigned_abs() / 1_000
            }
        }
    }
}

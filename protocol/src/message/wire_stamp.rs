//! Timestamps as messages hold them.

use posebridge_telemetry::{HostClock, Timestamp};

/// A timestamp as on the wire, before unwrapping and alignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireStamp {
    /// Microseconds in 32 bits; wraps after 71.6 minutes.
    Micros32(u32),
    /// Milliseconds in 32 bits; wraps after 49.7 days.
    Millis32(u32),
    /// Microseconds in 64 bits.
    Micros64(u64),
    /// Without a timestamp: the brick was polled, and the value was read between request and reply by the clock of the
    /// requesting side. Never on a wire.
    HostInterval {
        sent: Timestamp<HostClock>,
        /// When the last byte of the reply arrived.
        answered: Timestamp<HostClock>,
    },
}

impl WireStamp {
    /// In whole microseconds as on the wire; for a `HostInterval` the middle between request and reply.
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

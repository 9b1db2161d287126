//! The last stamp of a remote clock, and the plausible range of the next one without a restart.

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};
use serde::{Deserialize, Serialize};

use super::MAX_SKEW;
use crate::host_times::ShiftHostTimes;

/// Period of a 32-bit microsecond counter.
pub(super) const PERIOD_MICROS: i64 = 1 << 32;
/// A stamp that is this much older than the last one is not a reordering, unless a queue has just been released
/// ([`STRAGGLER_WINDOW`]): datagrams overtake each other by milliseconds. The estimator's history rejects smaller
/// falls.
const RESTART_BACK_THRESHOLD: TimeDelta = TimeDelta::from_millis(1_000);
/// Time after the release of a queue within which a datagram may arrive that the complete queue has overtaken, older by
/// the length of the queue.
const STRAGGLER_WINDOW: TimeDelta = TimeDelta::from_millis(1_000);
/// A clock that is this much further ahead than the host's is another clock, in addition to the share of the elapsed
/// time that its rate explains ([`MAX_SKEW`]): 2000 ppm need eight minutes for a second.
const RESTART_AHEAD_THRESHOLD: TimeDelta = TimeDelta::from_millis(1_000);
/// A clock that is this much further behind than the host's stood still or restarted: no link holds a message for
/// longer than TCP, whose sender gives up after 924.6 s (Linux, ip-sysctl, tcp_retries2).
const MAX_DELAY: TimeDelta = TimeDelta::from_millis(924_600);

/// The latest instant that a timestamp of the remote clock can have.
const MAX_MICROS: u64 = i64::MAX as u64 / 1_000;

/// The last stamp of a clock, or of one of its endpoints.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct LastStamp {
    pub(super) remote_micros: i64,
    pub(super) arrival: Timestamp<HostClock>,
    /// Delay relative to the fastest message before it. After a queue the next message may be released at once, and be
    /// younger by this.
    queue_delay: TimeDelta,
    queue: TimeDelta,
    /// When its first message arrived.
    released: Timestamp<HostClock>,
}

/// The range of a stamp without a restart, in microseconds on the remote clock.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "the unit is part of every name of a bare number")]
pub(super) struct PlausibleRange {
    earliest_micros: i64,
    expected_micros: i64,
    pub(super) latest_micros: i64,
}

impl ShiftHostTimes for LastStamp {
    fn shift_host_times(&mut self, by: TimeDelta) {
        self.arrival.shift_host_times(by);
        self.released.shift_host_times(by);
    }
}

impl LastStamp {
    /// Whether sums of its numbers stay within their range.
    pub(super) fn is_sound(&self) -> bool {
        self.remote_micros.unsigned_abs() <= MAX_MICROS
    }

    /// The first stamp of a clock.
    pub(super) const fn first(remote_micros: i64, arrival: Timestamp<HostClock>) -> Self {
        Self { remote_micros, arrival, queue_delay: TimeDelta::ZERO, queue: TimeDelta::ZERO, released: arrival }
    }

    pub(super) fn plausible_range(&self, arrival: Timestamp<HostClock>) -> PlausibleRange {
        let (elapsed, skew) = self.elapsed(arrival);
        let expected_micros = self.remote_micros + micros(elapsed);
        let straggling = if arrival - self.released <= STRAGGLER_WINDOW { self.queue } else { TimeDelta::ZERO };
        PlausibleRange {
            earliest_micros: (self.remote_micros - micros(RESTART_BACK_THRESHOLD + straggling))
                .max(expected_micros - micros(skew + MAX_DELAY)),
            expected_micros,
            latest_micros: expected_micros + micros(skew + self.queue_delay + RESTART_AHEAD_THRESHOLD),
        }
    }

    /// After a later stamp of the same clock.
    pub(super) fn followed_by(&self, remote_micros: i64, arrival: Timestamp<HostClock>) -> Self {
        let (elapsed, skew) = self.elapsed(arrival);
        let lag = elapsed - TimeDelta::from_micros(remote_micros - self.remote_micros);
        // A slow clock lags for ever without being held back: what its rate may explain neither counts nor is kept.
        let decayed = (self.queue_delay - skew).max(TimeDelta::ZERO);
        let added = if lag > skew { lag } else { lag.min(TimeDelta::ZERO) };
        let held_back = (decayed + added).max(TimeDelta::ZERO).min(MAX_DELAY);
        let (queue, released) = if held_back >= self.queue || arrival - self.released > STRAGGLER_WINDOW {
            (held_back, arrival)
        } else {
            (self.queue, self.released)
        };
        Self { remote_micros, arrival, queue_delay: held_back, queue, released }
    }

    /// The time on the host since this stamp arrived, and the share of it by which the clocks' rates may differ.
    fn elapsed(&self, arrival: Timestamp<HostClock>) -> (TimeDelta, TimeDelta) {
        let elapsed = (arrival - self.arrival).max(TimeDelta::ZERO);
        let skew = TimeDelta::from_secs_f64(elapsed.as_secs_f64() * MAX_SKEW);
        (elapsed, skew)
    }
}

impl PlausibleRange {
    pub(super) const fn contains(&self, instant_micros: i64) -> bool {
        self.earliest_micros <= instant_micros && instant_micros <= self.latest_micros
    }

    /// The instant of the stamp: its full value if it has 64 bits and is plausible, else the one nearest to the
    /// expected instant.
    pub(super) fn instant_of(&self, stamp: WireStamp) -> i64 {
        let full_micros = micros_of(stamp);
        match stamp {
            WireStamp::Micros64(_) if self.contains(full_micros) => full_micros,
            WireStamp::Micros64(_)
            | WireStamp::Micros32(_)
            | WireStamp::Millis32(_)
            // It is no instant of this clock; the engine converts it by what is known of both.
            | WireStamp::HostInterval { .. } => {
                nearest_instant(self.expected_micros, full_micros)
            }
        }
    }
}

const fn micros(duration: TimeDelta) -> i64 {
    duration.as_nanos() / 1_000
}

pub(super) fn micros_of(stamp: WireStamp) -> i64 {
    match stamp {
        WireStamp::Micros32(micros) => i64::from(micros),
        WireStamp::Millis32(millis) => i64::from(millis) * 1_000,
        // Beyond i64 nanoseconds there is no instant; damage, which the restart rule then catches.
        WireStamp::Micros64(_) | WireStamp::HostInterval { .. } => {
            i64::try_from(stamp.as_micros()).unwrap_or(i64::MAX).min(i64::MAX / 2_000)
        }
    }
}

/// The instant nearest to `near_micros` at which a counter shows this value modulo its period.
pub(super) const fn nearest_instant(near_micros: i64, shown_micros: i64) -> i64 {
    let ahead = (shown_micros - near_micros).rem_euclid(PERIOD_MICROS);
    if ahead >= PERIOD_MICROS / 2 { near_micros + ahead - PERIOD_MICROS } else { near_micros + ahead }
}

//! Counters that wrap, restart and lag, turned into instants on the remote clock.
//!
//! Everything is reduced to microseconds modulo 2^32, which is what a 32-bit microsecond counter shows; a counter of
//! milliseconds or of 64 bits agrees with it modulo the same number. The instant is the one nearest to what was expected.

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, Span, Stamp, clock::Clock};

/// Period of a 32-bit microsecond counter.
const PERIOD_MICROS: i64 = 1 << 32;
/// A stamp this much older than the last one is no reordering: datagrams overtake each other by milliseconds. Shorter falls are
/// refused by the estimator's history instead.
const RESTART_BACK: Span = Span::from_millis(1_000);
/// A clock that has run this much further than the host's is another clock: 2000 ppm need eight minutes for a second.
const RESTART_AHEAD: Span = Span::from_millis(1_000);
/// And this share of the time since, for links that were silent for hours.
const LARGEST_SKEW: f64 = 0.01;

/// Unwraps the stamps of one remote clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unwrapper {
    last: Option<Seen>,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    remote_micros: i64,
    arrival: Stamp<HostClock>,
}

/// A stamp on the remote clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unwrapped<C: Clock> {
    /// The clock ran on.
    Continued(Stamp<C>),
    /// The clock fell or leapt: it was restarted, and this is its first stamp.
    Restarted(Stamp<C>),
}

impl Unwrapper {
    /// The instant of a stamp that arrived at `arrival`.
    pub fn unwrap<C: Clock>(
        &mut self,
        stamp: WireStamp,
        arrival: Stamp<HostClock>,
    ) -> Unwrapped<C> {
        let whole = micros_of(stamp);
        let Some(last) = self.last else {
            return Unwrapped::Continued(self.keep(whole, arrival));
        };
        let step_micros = shortest_step(last.remote_micros, whole);
        let step = Span::from_micros(step_micros);
        let elapsed = (arrival - last.arrival).max(Span::ZERO);
        let furthest =
            elapsed + Span::from_secs_f64(elapsed.as_secs_f64() * LARGEST_SKEW) + RESTART_AHEAD;
        if step < -RESTART_BACK || step > furthest {
            return Unwrapped::Restarted(self.keep(whole, arrival));
        }
        let remote_micros = last.remote_micros + step_micros;
        if step_micros > 0 {
            self.keep::<C>(remote_micros, arrival);
        }
        Unwrapped::Continued(Stamp::from_micros(remote_micros))
    }

    /// The instant of a stamp near the last one, whichever side; nothing is learnt from it.
    pub(super) fn nearest<C: Clock>(&self, stamp: WireStamp) -> Option<Stamp<C>> {
        let last = self.last?;
        let step_micros = shortest_step(last.remote_micros, micros_of(stamp));
        Some(Stamp::from_micros(last.remote_micros + step_micros))
    }

    fn keep<C: Clock>(&mut self, remote_micros: i64, arrival: Stamp<HostClock>) -> Stamp<C> {
        self.last = Some(Seen {
            remote_micros,
            arrival,
        });
        Stamp::from_micros(remote_micros)
    }
}

/// What a counter shows, in microseconds.
fn micros_of(stamp: WireStamp) -> i64 {
    match stamp {
        WireStamp::Micros32(micros) => i64::from(micros),
        WireStamp::Millis32(millis) => i64::from(millis) * 1_000,
        // Beyond i64 nanoseconds there is no instant; damage, which the restart rule then catches.
        WireStamp::Micros64(micros) => i64::try_from(micros)
            .unwrap_or(i64::MAX)
            .min(i64::MAX / 2_000),
    }
}

/// The step from one instant to a counter's value modulo its period, the short way.
fn shortest_step(from_micros: i64, to_micros: i64) -> i64 {
    let ahead = (to_micros - from_micros).rem_euclid(PERIOD_MICROS);
    if ahead >= PERIOD_MICROS / 2 {
        ahead - PERIOD_MICROS
    } else {
        ahead
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::BrickClock;

    fn unwrapped(
        unwrapper: &mut Unwrapper,
        stamp: WireStamp,
        arrival_ms: i64,
    ) -> Unwrapped<BrickClock> {
        unwrapper.unwrap(stamp, Stamp::from_millis(arrival_ms))
    }

    #[test]
    fn a_microsecond_counter_runs_on_across_its_wrap() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(u32::MAX - 999), 0);
        let after = unwrapped(&mut unwrapper, WireStamp::Micros32(49_000), 50);
        assert_eq!(
            after,
            Unwrapped::Continued(Stamp::from_micros((1 << 32) + 49_000))
        );
    }

    #[test]
    fn milliseconds_and_microseconds_of_one_clock_agree_across_the_wrap() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(u32::MAX - 999), 0);
        unwrapped(&mut unwrapper, WireStamp::Micros32(49_000), 50);
        let millis = unwrapped(
            &mut unwrapper,
            WireStamp::Millis32(((1_u64 << 32) / 1_000) as u32 + 100),
            100,
        );
        assert_eq!(
            millis,
            Unwrapped::Continued(Stamp::from_micros(4_295_067_000))
        );
    }

    #[test]
    fn a_fall_to_zero_is_a_restart_and_a_late_datagram_is_not() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(90_000_000), 0);
        let late = unwrapped(&mut unwrapper, WireStamp::Micros32(89_990_000), 5);
        assert_eq!(late, Unwrapped::Continued(Stamp::from_micros(89_990_000)));
        let fall = unwrapped(&mut unwrapper, WireStamp::Micros32(2_000_000), 4_000);
        assert_eq!(fall, Unwrapped::Restarted(Stamp::from_micros(2_000_000)));
    }

    #[test]
    fn a_leap_ahead_of_the_host_is_a_restart_and_a_long_silence_is_not() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(1_000_000), 0);
        let after_silence = unwrapped(&mut unwrapper, WireStamp::Micros32(601_000_000), 600_000);
        assert_eq!(
            after_silence,
            Unwrapped::Continued(Stamp::from_micros(601_000_000))
        );
        let leap = unwrapped(&mut unwrapper, WireStamp::Micros32(700_000_000), 600_100);
        assert_eq!(leap, Unwrapped::Restarted(Stamp::from_micros(700_000_000)));
    }

    #[test]
    fn no_stamp_overflows() {
        let mut unwrapper = Unwrapper::default();
        for stamp in [
            WireStamp::Micros64(u64::MAX),
            WireStamp::Micros64(0),
            WireStamp::Millis32(u32::MAX),
        ] {
            unwrapped(&mut unwrapper, stamp, 0);
        }
    }
}

//! Counters that wrap, restart and lag, turned into instants on the remote clock.
//!
//! Everything is reduced to microseconds modulo 2^32, as a 32-bit microsecond counter shows; a counter of milliseconds
//! or of 64 bits agrees with it modulo the same number, and some bricks put their 32-bit register into a 64-bit field.
//! The instant is the one nearest to the expected one: the last one plus the time that passed on the host since. That
//! holds through a silence for as long as the two rates differ by less than half a period over it: twelve days at 2000
//! ppm. A counter whose 64 bits fit the expectation needs no unwrapping.
//!
//! # What cannot be known
//! A brick that restarted during a silence shows the time since. If that, modulo the period, lies between the limit by
//! the longest delay of a link and the expected instant, it cannot be distinguished from the old clock and is taken for
//! it. After more than a quarter of an hour that is about a fifth of all values; after a shorter silence fewer, because
//! the clock must not fall either.

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, Timestamp, clock::Clock};

use super::Endpoint;
use super::last_stamp::{micros_of, nearest_instant};
use super::stamp_tracks::{StampPlacement, StampTracks};

/// Unwraps the stamps of one remote clock, from all its endpoints.
#[derive(Clone, Debug, Default)]
pub struct Unwrapper {
    tracks: StampTracks,
}

/// The result of unwrapping a stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UnwrapOutcome<C: Clock> {
    /// The clock continued.
    Continued(Timestamp<C>),
    /// The clock fell or leapt: it was restarted, and this is its first stamp.
    Restarted(Timestamp<C>),
    /// The stamp is from before a known restart, delayed by a slower endpoint. It has no instant on the current clock.
    Stale,
}

impl Unwrapper {
    /// The instant of a stamp that arrived from `endpoint` at `arrival`.
    pub fn unwrap<C: Clock>(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> UnwrapOutcome<C> {
        match self.tracks.classify(endpoint, stamp, arrival) {
            None => UnwrapOutcome::Continued(self.restart(endpoint, stamp, arrival)),
            Some(StampPlacement::Continued(micros)) => UnwrapOutcome::Continued(Timestamp::from_micros(micros)),
            Some(StampPlacement::Stale) => UnwrapOutcome::Stale,
            Some(StampPlacement::Restarted) => UnwrapOutcome::Restarted(self.restart(endpoint, stamp, arrival)),
        }
    }

    /// The instant of a stamp that another endpoint has delivered before. It updates the endpoint's track, but never
    /// indicates a restart. `None` if it has no instant on the current clock.
    pub(super) fn unwrap_copy<C: Clock>(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> Option<Timestamp<C>> {
        match self.tracks.classify(endpoint, stamp, arrival)? {
            StampPlacement::Continued(micros) => Some(Timestamp::from_micros(micros)),
            StampPlacement::Stale | StampPlacement::Restarted => None,
        }
    }

    /// The instant of a stamp nearest to the last one, on either side; changes no state.
    pub(super) fn nearest<C: Clock>(&self, stamp: WireStamp) -> Option<Timestamp<C>> {
        let last = self.tracks.latest()?;
        Some(Timestamp::from_micros(nearest_instant(last.remote_micros, micros_of(stamp))))
    }

    fn restart<C: Clock>(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> Timestamp<C> {
        let remote_micros = micros_of(stamp);
        self.tracks.restart(endpoint, remote_micros, arrival);
        Timestamp::from_micros(remote_micros)
    }
}

#[cfg(test)]
mod tests {
    use super::super::last_stamp::PERIOD_MICROS;
    use super::*;
    use posebridge_telemetry::BrickClock;

    fn unwrapped(unwrapper: &mut Unwrapper, stamp: WireStamp, arrival_ms: i64) -> UnwrapOutcome<BrickClock> {
        unwrapper.unwrap(Endpoint::default(), stamp, Timestamp::from_millis(arrival_ms))
    }

    #[test]
    fn a_millisecond_counter_runs_on_across_its_wrap_after_fifty_days() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Millis32(u32::MAX - 9), 0);
        let after = unwrapped(&mut unwrapper, WireStamp::Millis32(40), 50);
        assert_eq!(after, UnwrapOutcome::Continued(Timestamp::from_millis((1 << 32) + 40)));
    }

    #[test]
    fn milliseconds_and_microseconds_of_one_clock_agree_across_the_wrap() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(u32::MAX - 999), 0);
        let micros = unwrapped(&mut unwrapper, WireStamp::Micros32(49_000), 50);
        assert_eq!(micros, UnwrapOutcome::Continued(Timestamp::from_micros((1 << 32) + 49_000)));
        let millis = unwrapped(&mut unwrapper, WireStamp::Millis32(((1_u64 << 32) / 1_000) as u32 + 100), 100);
        assert_eq!(millis, UnwrapOutcome::Continued(Timestamp::from_micros(4_295_067_000)));
    }

    #[test]
    fn a_fall_to_zero_is_a_restart_and_a_late_datagram_is_not() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(90_000_000), 0);
        let late = unwrapped(&mut unwrapper, WireStamp::Micros32(89_990_000), 5);
        assert_eq!(late, UnwrapOutcome::Continued(Timestamp::from_micros(89_990_000)));
        let fall = unwrapped(&mut unwrapper, WireStamp::Micros32(2_000_000), 4_000);
        assert_eq!(fall, UnwrapOutcome::Restarted(Timestamp::from_micros(2_000_000)));
    }

    #[test]
    fn a_datagram_overtaken_by_a_queue_is_late_and_later_a_fall_is_a_restart() {
        let mut unwrapper = Unwrapper::default();
        let mut stamp_at = |millis: u32, arrival_ms| unwrapped(&mut unwrapper, WireStamp::Millis32(millis), arrival_ms);
        stamp_at(20_000, 20_000);
        // The link stands still for six seconds, and then everything comes at once; one of it a little later.
        for millis in (20_100..=26_000).step_by(50) {
            let continued = UnwrapOutcome::Continued(Timestamp::from_millis(millis.into()));
            assert_eq!(stamp_at(millis, 26_000), continued);
        }
        let late = UnwrapOutcome::Continued(Timestamp::from_millis(20_050));
        assert_eq!(stamp_at(20_050, 26_900), late);
        let runs_on = UnwrapOutcome::Continued(Timestamp::from_millis(27_000));
        assert_eq!(stamp_at(27_000, 27_000), runs_on);
        let fall = UnwrapOutcome::Restarted(Timestamp::from_millis(21_050));
        assert_eq!(stamp_at(21_050, 27_050), fall);
    }

    #[test]
    fn a_leap_ahead_of_the_host_is_a_restart_and_a_long_silence_is_not() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros32(1_000_000), 0);
        let after_silence = unwrapped(&mut unwrapper, WireStamp::Micros32(601_000_000), 600_000);
        assert_eq!(after_silence, UnwrapOutcome::Continued(Timestamp::from_micros(601_000_000)));
        let leap = unwrapped(&mut unwrapper, WireStamp::Micros32(700_000_000), 600_100);
        assert_eq!(leap, UnwrapOutcome::Restarted(Timestamp::from_micros(700_000_000)));
    }

    /// The low 32 bits of an instant, as a brick shows them.
    fn register(instant_micros: i64) -> WireStamp {
        WireStamp::Micros32(instant_micros as u32)
    }

    const SECOND: i64 = 1_000_000;
    const MINUTE: i64 = 60 * SECOND;

    #[test]
    fn a_clock_runs_on_through_a_silence_of_any_length() {
        // Instants before the silence: young, shortly before the first wrap, and after several.
        for last_micros in [2 * SECOND, 4_290 * SECOND, 4_000_000 * SECOND + 7] {
            for silence_micros in [10 * SECOND, 40 * MINUTE, 80 * MINUTE, 180 * MINUTE] {
                for skew_ppm in [-2_000, 0, 2_000] {
                    let mut unwrapper = Unwrapper::default();
                    unwrapped(&mut unwrapper, WireStamp::Micros64(last_micros as u64), 0);
                    let ran_micros = silence_micros + silence_micros / 1_000_000 * skew_ppm;
                    let now_micros = last_micros + ran_micros;
                    let after = unwrapped(&mut unwrapper, register(now_micros), silence_micros / 1_000);
                    assert_eq!(
                        after,
                        UnwrapOutcome::Continued(Timestamp::from_micros(now_micros)),
                        "{last_micros} us, then {silence_micros} us at {skew_ppm} ppm"
                    );
                }
            }
        }
    }

    #[test]
    fn what_a_link_held_back_during_a_silence_keeps_its_time() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, register(4_290 * SECOND), 0);
        // Fifteen minutes later everything arrives at once, beginning with what was sent next.
        for sent_micros in [4_291 * SECOND, 4_296 * SECOND, 5_190 * SECOND] {
            let after = unwrapped(&mut unwrapper, register(sent_micros), 900_000);
            assert_eq!(after, UnwrapOutcome::Continued(Timestamp::from_micros(sent_micros)));
        }
    }

    #[test]
    fn a_slow_clock_or_a_jittery_link_does_not_excuse_a_leap() {
        let mut unwrapper = Unwrapper::default();
        // An hour at 20 Hz and -2000 ppm, every other message 30 ms late: 7 s behind in all.
        for k in 0..72_000_i64 {
            let stamp = register(SECOND + k * 49_900);
            let arrival_ms = k * 50 + (k % 2) * 30;
            let after = unwrapped(&mut unwrapper, stamp, arrival_ms);
            assert!(matches!(after, UnwrapOutcome::Continued(_)), "message {k}");
        }
        let leap_micros = SECOND + 72_000 * 49_900 + 1_200_000;
        let leap = unwrapped(&mut unwrapper, register(leap_micros), 72_000 * 50);
        assert_eq!(leap, UnwrapOutcome::Restarted(Timestamp::from_micros(leap_micros)));
    }

    #[test]
    fn a_restart_during_a_silence_is_detected_where_the_expectation_excludes_the_counter() {
        // Last stamp, then forty minutes of silence, then a brick that has been up for some seconds or minutes.
        for (last_s, up_s) in [(100, 5), (3_000, 5), (4_000, 5), (100, 1_400), (4_200, 600)] {
            let mut unwrapper = Unwrapper::default();
            unwrapped(&mut unwrapper, register(last_s * SECOND), 0);
            let after = unwrapped(&mut unwrapper, register(up_s * SECOND), 2_400_000);
            assert_eq!(
                after,
                UnwrapOutcome::Restarted(Timestamp::from_micros(up_s * SECOND)),
                "{up_s} s after {last_s} s"
            );
        }
    }

    #[test]
    fn a_restart_whose_counter_fits_the_expectation_is_not_detected() {
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, register(4_000 * SECOND), 0);
        // Up for 2000 s, which is 6295 s modulo the period; 6400 s were expected.
        let after = unwrapped(&mut unwrapper, register(2_000 * SECOND), 2_400_000);
        let taken = Timestamp::from_micros(2_000 * SECOND + PERIOD_MICROS);
        assert_eq!(after, UnwrapOutcome::Continued(taken));
    }

    #[test]
    fn a_full_counter_is_used_where_the_rate_leaves_more_than_one_wrap_open() {
        // Ten days at 5000 ppm are 72 minutes, a whole period more than expected.
        let ten_days_micros = 10 * 24 * 60 * MINUTE;
        let now_micros = SECOND + ten_days_micros / 1_000 * 1_005;
        let mut unwrapper = Unwrapper::default();
        unwrapped(&mut unwrapper, WireStamp::Micros64(SECOND as u64), 0);
        let after = unwrapped(&mut unwrapper, WireStamp::Micros64(now_micros as u64), ten_days_micros / 1_000);
        assert_eq!(after, UnwrapOutcome::Continued(Timestamp::from_micros(now_micros)));
    }

    #[test]
    fn a_32_bit_register_in_a_64_bit_field_means_the_same_instant() {
        let mut unwrapper = Unwrapper::default();
        let now_micros = 9_000 * SECOND;
        unwrapped(&mut unwrapper, WireStamp::Micros64(now_micros as u64), 0);
        let shown = WireStamp::Micros64((now_micros + 50_000) as u64 % (1 << 32));
        let after = unwrapped(&mut unwrapper, shown, 50);
        let expected = Timestamp::from_micros(now_micros + 50_000);
        assert_eq!(after, UnwrapOutcome::Continued(expected));
    }

    #[test]
    fn a_relayed_stamp_lies_near_the_last_one_however_long_ago_that_came() {
        let mut unwrapper = Unwrapper::default();
        assert_eq!(unwrapper.nearest::<BrickClock>(register(5)), None);
        unwrapped(&mut unwrapper, register(4_290 * SECOND), 0);
        for instant_micros in [4_289 * SECOND, 2_200 * SECOND, 4_296 * SECOND] {
            let instant = unwrapper.nearest::<BrickClock>(register(instant_micros));
            assert_eq!(instant, Some(Timestamp::from_micros(instant_micros)));
        }
    }

    #[test]
    fn no_stamp_overflows() {
        let mut unwrapper = Unwrapper::default();
        for stamp in [WireStamp::Micros64(u64::MAX), WireStamp::Micros64(0), WireStamp::Millis32(u32::MAX)] {
            unwrapped(&mut unwrapper, stamp, 0);
        }
    }
}

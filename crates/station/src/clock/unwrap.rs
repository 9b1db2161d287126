//! Counters that wrap, restart and lag, from several endpoints, turned into instants on the remote clock.
//!
//! Everything is reduced to microseconds modulo 2^32, as a 32-bit microsecond counter shows; a counter of milliseconds
//! or of 64 bits agrees with it modulo the same number, and some bricks put their 32-bit register into a 64-bit field.
//! The instant is the one nearest to the expected one: the last one plus the time that passed on the host since. That
//! holds through a silence for as long as the two rates differ by less than half a period over it: twelve days at 2000
//! ppm. A counter whose 64 bits fit the expectation needs no unwrapping.
//!
//! # Several endpoints
//! Stamps of one endpoint arrive in order; stamps of two do not, because one link may delay by seconds what the other has already
//! delivered. A stamp that goes back therefore means a restart only if it goes back relative to the last one of its own endpoint. If it
//! only goes back relative to the latest of all endpoints, it may just be late.
//!
//! ```text
//! endpoint   stamp                                                       is
//! current    follows the last one of its endpoint                        of the clock as it runs
//! current    does not                                                    a restart; the other endpoints become stale
//! any        follows the latest of all endpoints                         of the clock as it runs; the endpoint is current
//! stale      follows the last one of its endpoint, sent before the end   of the clock before: no instant
//! stale      does not, and lies before the latest                        of the clock as it runs, late; the endpoint is current
//! other      lies before the latest, which is not older than 2 s         of the clock as it runs, late; the endpoint is behind
//! other      anything else                                               a restart; the other endpoints become stale
//! ```
//! A stamp follows another if it lies in `LastStamp::plausible_range`. An endpoint without a stamp before the restart cannot be
//! distinguished from a late one. It counts as late while another endpoint continues the clock as it was, and for two seconds more.
//!
//! # What cannot be known
//! A brick that restarted during a silence shows the time since. If that, modulo the period, lies between the limit by
//! the longest delay of a link and the expected instant, it cannot be distinguished from the old clock and is taken for
//! it. After more than a quarter of an hour that is about a fifth of all values; after a shorter silence fewer, because
//! the clock must not fall either.
//!
//! # Sources
//! docs/maths/clock.md, section 1.

use posebridge_estimator::RestoreError;
use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp, clock::Clock};
use serde::{Deserialize, Serialize};

use super::Endpoint;
use super::last_stamp::{LastStamp, micros_of, nearest_instant};
use crate::host_times::ShiftHostTimes;

/// Most endpoints that are followed; the one that was silent longest is dropped first. No robot is connected by more
/// links.
const MAX_TRACKS: usize = 8;
/// For this long after its latest stamp a clock counts as running on, whatever stamps a new endpoint delivers. Telemetry comes more
/// often than this; with this value a restart is detected within three seconds.
const ALIVE_WINDOW: TimeDelta = TimeDelta::from_millis(2_000);

/// Unwraps the stamps of one remote clock, from all its endpoints.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Unwrapper {
    latest: Option<LastStamp>,
    tracks: Vec<StampTrack>,
}

/// The result of unwrapping a stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UnwrapOutcome<C: Clock> {
    Continued(Timestamp<C>),
    /// The clock fell or leapt: it was restarted, and this is its first stamp.
    Restarted(Timestamp<C>),
    /// The stamp is from before a known restart, delayed by a slower endpoint. It has no instant on the current clock.
    Stale,
}

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct StampTrack {
    endpoint: Endpoint,
    last: LastStamp,
    status: TrackStatus,
}

/// The clock of an endpoint's stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum TrackStatus {
    Current,
    /// The current clock, with stamps that have been long past since the first one.
    Behind,
    /// The clock before a restart that another endpoint has shown. No message that was sent before the restart has a
    /// later stamp than this.
    Stale {
        until_micros: i64,
    },
}

impl ShiftHostTimes for Unwrapper {
    fn shift_host_times(&mut self, by: TimeDelta) {
        self.latest.shift_host_times(by);
        for track in &mut self.tracks {
            track.last.shift_host_times(by);
        }
    }
}

impl Unwrapper {
    pub(super) fn check(&self) -> Result<(), RestoreError> {
        let mut stamps = self.tracks.iter().map(|track| &track.last).chain(&self.latest);
        let is_sound = self.tracks.len() <= MAX_TRACKS && stamps.all(LastStamp::is_sound);
        is_sound.then_some(()).ok_or(RestoreError::Implausible("a timestamp of its clock is beyond all times"))
    }

    /// The instant of a stamp that arrived from `endpoint` at `arrival`.
    pub fn unwrap<C: Clock>(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> UnwrapOutcome<C> {
        let is_first = self.latest.is_none();
        match self.follow(endpoint, stamp, arrival) {
            Some((TrackStatus::Current | TrackStatus::Behind, micros)) => {
                UnwrapOutcome::Continued(Timestamp::from_micros(micros))
            }
            Some((TrackStatus::Stale { .. }, _)) => UnwrapOutcome::Stale,
            None => {
                let remote_micros = micros_of(stamp);
                self.restart(endpoint, remote_micros, arrival);
                let first = Timestamp::from_micros(remote_micros);
                if is_first { UnwrapOutcome::Continued(first) } else { UnwrapOutcome::Restarted(first) }
            }
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
        match self.follow(endpoint, stamp, arrival)? {
            (TrackStatus::Current | TrackStatus::Behind, micros) => Some(Timestamp::from_micros(micros)),
            (TrackStatus::Stale { .. }, _) => None,
        }
    }

    /// The instant of a stamp nearest to the last one, on either side; changes no state.
    pub(super) fn nearest<C: Clock>(&self, stamp: WireStamp) -> Option<Timestamp<C>> {
        let last = self.latest?;
        Some(Timestamp::from_micros(nearest_instant(last.remote_micros, micros_of(stamp))))
    }

    /// Stores a stamp; returns the status of its endpoint, and its instant on that clock in microseconds. `None`, with
    /// nothing stored, for the first stamp of a clock and for the first one after a restart.
    fn follow(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> Option<(TrackStatus, i64)> {
        let latest = self.latest?;
        let track = self.tracks.iter().find(|track| track.endpoint == endpoint).copied();
        let (status, micros) = classify(&latest, track, stamp, arrival)?;
        let last = match track {
            // A stamp that was overtaken within its endpoint does not move the reference.
            Some(track) if track.status == status && micros <= track.last.remote_micros => track.last,
            Some(track) if track.status == status => track.last.followed_by(micros, arrival),
            _ => LastStamp::first(micros, arrival),
        };
        self.save_track(StampTrack { endpoint, last, status });
        if status == TrackStatus::Current && micros > latest.remote_micros {
            self.latest = Some(latest.followed_by(micros, arrival));
        }
        Some((status, micros))
    }

    /// Starts or restarts the clock with a stamp from `endpoint`.
    fn restart(&mut self, endpoint: Endpoint, remote_micros: i64, arrival: Timestamp<HostClock>) {
        for track in &mut self.tracks {
            if !matches!(track.status, TrackStatus::Stale { .. }) {
                let until_micros = track.last.plausible_range(arrival).latest_micros;
                track.status = TrackStatus::Stale { until_micros };
            }
        }
        let first = LastStamp::first(remote_micros, arrival);
        self.latest = Some(first);
        self.save_track(StampTrack { endpoint, last: first, status: TrackStatus::Current });
    }

    fn save_track(&mut self, track: StampTrack) {
        let known = self.tracks.iter_mut().find(|known| known.endpoint == track.endpoint);
        if let Some(known) = known {
            *known = track;
            return;
        }
        if self.tracks.len() >= MAX_TRACKS {
            let silent = (0..self.tracks.len()).min_by_key(|&index| self.tracks[index].last.arrival);
            self.tracks.swap_remove(silent.unwrap_or(0));
        }
        self.tracks.push(track);
    }
}

/// The new status of a stamp's endpoint, and its instant on that clock in microseconds; `None` if it means a restart.
fn classify(
    latest: &LastStamp,
    track: Option<StampTrack>,
    stamp: WireStamp,
    arrival: Timestamp<HostClock>,
) -> Option<(TrackStatus, i64)> {
    let status = track.map(|track| track.status);
    let own = track.and_then(|track| {
        let plausible = track.last.plausible_range(arrival);
        let micros = plausible.instant_of(stamp);
        plausible.contains(micros).then_some(micros)
    });
    if status == Some(TrackStatus::Current) {
        return own.map(|micros| (TrackStatus::Current, micros));
    }
    let plausible = latest.plausible_range(arrival);
    let micros = plausible.instant_of(stamp);
    if plausible.contains(micros) {
        return Some((TrackStatus::Current, micros));
    }
    let is_late = (0..plausible.latest_micros).contains(&micros);
    match (status, own) {
        (Some(TrackStatus::Stale { until_micros }), Some(own)) if own <= until_micros => {
            Some((TrackStatus::Stale { until_micros }, own))
        }
        (Some(TrackStatus::Stale { .. }), None) if is_late => Some((TrackStatus::Current, micros)),
        _ if is_late && arrival - latest.arrival <= ALIVE_WINDOW => Some((TrackStatus::Behind, micros)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::last_stamp::PERIOD_MICROS;
    use super::*;
    use posebridge_telemetry::{BrickClock, LinkId, PeerId};

    type Outcome = UnwrapOutcome<BrickClock>;

    const MILLI: i64 = 1_000;
    const SECOND: i64 = 1_000_000;
    const MINUTE: i64 = 60 * SECOND;

    fn continued(micros: i64) -> Outcome {
        UnwrapOutcome::Continued(Timestamp::from_micros(micros))
    }

    fn restarted(micros: i64) -> Outcome {
        UnwrapOutcome::Restarted(Timestamp::from_micros(micros))
    }

    /// The low 32 bits of an instant, as a brick shows them.
    fn register(instant_micros: i64) -> WireStamp {
        WireStamp::Micros32(instant_micros as u32)
    }

    fn full(instant_micros: i64) -> WireStamp {
        WireStamp::Micros64(instant_micros as u64)
    }

    const fn endpoint(link: u16) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(0) }
    }

    /// A stamp in ms that a link delivers at an instant in ms.
    fn deliver(unwrapper: &mut Unwrapper, link: u16, stamp_ms: i64, arrival_ms: i64) -> Outcome {
        unwrapper.unwrap(endpoint(link), full(stamp_ms * MILLI), Timestamp::from_millis(arrival_ms))
    }

    /// Gives stamps of one endpoint to a clock, each with its arrival in ms and the expected outcome.
    fn check(name: &str, stamps: &[(WireStamp, i64, Outcome)]) {
        let mut unwrapper = Unwrapper::default();
        for (stamp, arrival_ms, expected) in stamps {
            let outcome = unwrapper.unwrap(Endpoint::default(), *stamp, Timestamp::from_millis(*arrival_ms));
            assert_eq!(outcome, *expected, "{name}: {stamp:?} at {arrival_ms} ms");
        }
    }

    #[test]
    fn a_counter_wraps_lags_and_is_restarted() {
        let wrap = 1_i64 << 32;
        let millis = WireStamp::Millis32;
        let wrap_ms = wrap / 1_000;
        check(
            "fifty days of milliseconds",
            &[
                (millis(u32::MAX - 9), 0, continued((wrap - 10) * MILLI)),
                (millis(40), 50, continued((wrap + 40) * MILLI)),
            ],
        );
        check(
            "milliseconds and microseconds of one clock",
            &[
                (register(wrap - 1_000), 0, continued(wrap - 1_000)),
                (register(wrap + 49_000), 50, continued(wrap + 49_000)),
                (millis(wrap_ms as u32 + 100), 100, continued((wrap_ms + 100) * MILLI)),
            ],
        );
        check(
            "a late datagram, and a fall to zero",
            &[
                (register(90 * SECOND), 0, continued(90 * SECOND)),
                (register(90 * SECOND - 10 * MILLI), 5, continued(90 * SECOND - 10 * MILLI)),
                (register(2 * SECOND), 4_000, restarted(2 * SECOND)),
            ],
        );
        check(
            "a long silence, and a leap ahead of the host",
            &[
                (register(SECOND), 0, continued(SECOND)),
                (register(601 * SECOND), 600_000, continued(601 * SECOND)),
                (register(700 * SECOND), 600_100, restarted(700 * SECOND)),
            ],
        );
        // Fifteen minutes later everything arrives at once, beginning with what was sent next.
        check(
            "what a link held back during a silence",
            &[
                (register(4_290 * SECOND), 0, continued(4_290 * SECOND)),
                (register(4_291 * SECOND), 900_000, continued(4_291 * SECOND)),
                (register(4_296 * SECOND), 900_000, continued(4_296 * SECOND)),
                (register(5_190 * SECOND), 900_000, continued(5_190 * SECOND)),
            ],
        );
        // Up for 2000 s, which is 6295 s modulo the period; 6400 s were expected.
        check(
            "a restart whose counter fits the expectation",
            &[
                (register(4_000 * SECOND), 0, continued(4_000 * SECOND)),
                (register(2_000 * SECOND), 2_400_000, continued(2_000 * SECOND + PERIOD_MICROS)),
            ],
        );
        // Ten days at 5000 ppm are 72 minutes, a whole period more than expected.
        let ten_days = 10 * 24 * 60 * MINUTE;
        let fast = SECOND + ten_days / 1_000 * 1_005;
        check(
            "a full counter where the rate leaves more than one wrap open",
            &[(full(SECOND), 0, continued(SECOND)), (full(fast), ten_days / 1_000, continued(fast))],
        );
        check(
            "a 32-bit register in a 64-bit field",
            &[
                (full(9_000 * SECOND), 0, continued(9_000 * SECOND)),
                (full((9_000 * SECOND + 50 * MILLI) % wrap), 50, continued(9_000 * SECOND + 50 * MILLI)),
            ],
        );
        // Forty minutes of silence, then a brick that has been up for some seconds or minutes.
        for (last_s, up_s) in [(100, 5), (3_000, 5), (4_000, 5), (100, 1_400), (4_200, 600)] {
            check(
                "a restart during a silence",
                &[
                    (register(last_s * SECOND), 0, continued(last_s * SECOND)),
                    (register(up_s * SECOND), 2_400_000, restarted(up_s * SECOND)),
                ],
            );
        }
    }

    #[test]
    fn a_clock_runs_on_through_a_silence_of_any_length() {
        // Instants before the silence: young, shortly before the first wrap, and after several.
        for last in [2 * SECOND, 4_290 * SECOND, 4_000_000 * SECOND + 7] {
            for silence in [10 * SECOND, 40 * MINUTE, 80 * MINUTE, 180 * MINUTE] {
                for skew_ppm in [-2_000, 0, 2_000] {
                    let now = last + silence + silence / 1_000_000 * skew_ppm;
                    let stamps = [(full(last), 0, continued(last)), (register(now), silence / 1_000, continued(now))];
                    check(&format!("{skew_ppm} ppm"), &stamps);
                }
            }
        }
    }

    #[test]
    fn a_datagram_overtaken_by_a_queue_is_late_and_later_a_fall_is_a_restart() {
        let mut unwrapper = Unwrapper::default();
        let mut at = |millis, arrival_ms| deliver(&mut unwrapper, 0, millis, arrival_ms);
        at(20_000, 20_000);
        // The link stands still for six seconds, and then everything comes at once; one of it a little later.
        for millis in (20_100..=26_000).step_by(50) {
            assert_eq!(at(millis, 26_000), continued(millis * MILLI));
        }
        assert_eq!(at(20_050, 26_900), continued(20_050 * MILLI));
        assert_eq!(at(27_000, 27_000), continued(27_000 * MILLI));
        assert_eq!(at(21_050, 27_050), restarted(21_050 * MILLI));
    }

    #[test]
    fn a_slow_clock_or_a_jittery_link_does_not_excuse_a_leap() {
        // An hour at 20 Hz and -2000 ppm, every other message 30 ms late: 7 s behind in all.
        let mut stamps: Vec<(WireStamp, i64, Outcome)> = Vec::new();
        for k in 0..72_000 {
            let micros = SECOND + k * 49_900;
            stamps.push((register(micros), k * 50 + (k % 2) * 30, continued(micros)));
        }
        let leap = SECOND + 72_000 * 49_900 + 1_200_000;
        stamps.push((register(leap), 72_000 * 50, restarted(leap)));
        check("an hour", &stamps);
    }

    #[test]
    fn a_relayed_stamp_lies_near_the_last_one_however_long_ago_that_came() {
        let mut unwrapper = Unwrapper::default();
        assert_eq!(unwrapper.nearest::<BrickClock>(register(5)), None);
        deliver(&mut unwrapper, 0, 4_290_000, 0);
        for instant_micros in [4_289 * SECOND, 2_200 * SECOND, 4_296 * SECOND] {
            let instant = unwrapper.nearest::<BrickClock>(register(instant_micros));
            assert_eq!(instant, Some(Timestamp::from_micros(instant_micros)));
        }
    }

    #[test]
    fn no_stamp_overflows() {
        let mut unwrapper = Unwrapper::default();
        for stamp in [WireStamp::Micros64(u64::MAX), WireStamp::Micros64(0), WireStamp::Millis32(u32::MAX)] {
            unwrapper.unwrap::<BrickClock>(Endpoint::default(), stamp, Timestamp::ZERO);
        }
    }

    /// Two endpoints that have delivered stamps of a clock which shows a hundred seconds at host zero.
    fn two_endpoints() -> Unwrapper {
        let mut unwrapper = Unwrapper::default();
        assert_eq!(deliver(&mut unwrapper, 0, 100_000, 0), continued(100_000 * MILLI));
        assert_eq!(deliver(&mut unwrapper, 1, 100_010, 20), continued(100_010 * MILLI));
        unwrapper
    }

    #[test]
    fn a_fall_on_one_endpoint_is_a_restart_and_on_two_it_is_none() {
        let mut unwrapper = two_endpoints();
        deliver(&mut unwrapper, 0, 105_000, 5_000);
        assert_eq!(deliver(&mut unwrapper, 1, 100_060, 5_010), continued(100_060 * MILLI));
        assert_eq!(deliver(&mut unwrapper, 0, 100_070, 5_020), restarted(100_070 * MILLI));
    }

    #[test]
    fn after_a_restart_another_endpoint_is_stale_until_it_falls_too() {
        let mut unwrapper = two_endpoints();
        assert_eq!(deliver(&mut unwrapper, 0, 50, 10_000), restarted(50 * MILLI));
        for (stamp_ms, outcome) in [
            (100_100, UnwrapOutcome::Stale),
            (109_900, UnwrapOutcome::Stale),
            // Late, but of the new clock: it has fallen.
            (40, continued(40 * MILLI)),
            (200, continued(200 * MILLI)),
        ] {
            deliver(&mut unwrapper, 0, 4_000, 13_950);
            assert_eq!(deliver(&mut unwrapper, 1, stamp_ms, 14_000), outcome, "{stamp_ms} ms");
        }
    }

    #[test]
    fn an_old_clock_that_runs_on_past_its_end_has_not_ended() {
        let mut unwrapper = two_endpoints();
        // Damage, after which the endpoint is silent.
        assert_eq!(deliver(&mut unwrapper, 0, 900_000, 1_000), restarted(900_000 * MILLI));
        assert_eq!(deliver(&mut unwrapper, 1, 101_000, 1_010), UnwrapOutcome::Stale);
        assert_eq!(deliver(&mut unwrapper, 1, 101_900, 1_910), UnwrapOutcome::Stale);
        let mut instants = (2_000..8_000).step_by(50);
        let end =
            instants.find(|now| matches!(deliver(&mut unwrapper, 1, 100_000 + now, *now), UnwrapOutcome::Restarted(_)));
        assert!(end.is_some_and(|end| end <= 3_100), "{end:?}");
    }

    #[test]
    fn a_new_endpoint_is_late_only_while_another_one_is_active() {
        for (silence_ms, expected) in [(2_000, continued(50 * MILLI)), (2_001, restarted(50 * MILLI))] {
            assert_eq!(deliver(&mut two_endpoints(), 2, 50, 20 + silence_ms), expected, "{silence_ms} ms");
        }
    }

    #[test]
    fn the_endpoint_that_was_silent_longest_is_evicted() {
        let mut unwrapper = two_endpoints();
        for link in 2..20 {
            deliver(&mut unwrapper, link, 100_100, 100);
            deliver(&mut unwrapper, 0, 100_100 + i64::from(link), 100 + i64::from(link));
        }
        let followed = |link| unwrapper.tracks.iter().any(|track| track.endpoint == endpoint(link));
        assert_eq!(unwrapper.tracks.len(), MAX_TRACKS);
        assert!(followed(0) && !followed(1));
    }
}

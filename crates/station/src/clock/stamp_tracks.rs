//! One remote clock that is heard by several ways: which of them speaks of the clock as it runs, and which still of the time before.
//!
//! What comes by one way comes in its order, what comes by two does not: one link may hold back for seconds what the other has
//! brought. A stamp that falls is therefore the sign of a restart only where it is held against the last one of its own way. Held
//! against the youngest of all ways it may just be late.
//!
//! ```text
//! way        stamp                                                   is
//! current    follows the last one of its way                         of the clock as it runs
//! current    does not                                                a restart; the other ways are outlived
//! any        follows the youngest of all ways                        of the clock as it runs; the way is current
//! outlived   follows the last one of its way, sent before the end    of the clock before: no instant
//! outlived   does not, and lies before the youngest                  of the clock as it runs, late; the way is current
//! other      lies before the youngest, which is not older than 2 s   of the clock as it runs, late; the way is behind
//! other      anything else                                           a restart; the other ways are outlived
//! ```
//! "Follows" is what [`Seen`] believes of a clock that ran on. A way that was never heard when the clock began anew cannot be told
//! from one that is late. It is believed to be late for as long as somebody else speaks of the clock as it was, and two seconds more.
//!
//! # Sources
//! docs/maths/clock.md, section 1.

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::Endpoint;
use super::last_stamp::LastStamp;

/// Most ways that are followed; the one that was silent longest goes first. Nobody joins a robot by more links.
const MAX_TRACKS: usize = 8;
/// So long after its youngest stamp a clock is held to run on as it did, whatever a way says that was not heard before. Telemetry that
/// is rarer than this is no telemetry; with this a restart is known within three seconds.
const ALIVE_WINDOW: TimeDelta = TimeDelta::from_millis(2_000);

/// What came by every way, and the youngest of it.
#[derive(Clone, Debug, Default)]
pub(super) struct StampTracks {
    latest: Option<LastStamp>,
    /// In no order.
    tracks: Vec<StampTrack>,
}

/// The last stamp of one way.
#[derive(Clone, Copy, Debug)]
struct StampTrack {
    endpoint: Endpoint,
    last: LastStamp,
    status: TrackStatus,
}

/// Of which clock a way speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrackStatus {
    /// Of the clock as it runs.
    Current,
    /// Of instants that are long past, ever since it was first heard.
    Behind,
    /// Of the clock before a restart that another way has told of. Nothing that was sent before it is stamped later than this.
    Stale { until_micros: i64 },
}

/// What a stamp is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StampPlacement {
    /// An instant of the clock as it runs, in microseconds.
    Continued(i64),
    /// An instant of the clock before its last restart.
    Stale,
    /// The first one after a restart.
    Restarted,
}

impl StampTracks {
    /// The youngest stamp by any way.
    pub(super) const fn youngest(&self) -> Option<LastStamp> {
        self.latest
    }

    /// Where a stamp belongs that came by `way` at `arrival`; takes note of it, unless it tells of a restart: then [`Self::begin`]
    /// must follow. `None` if it is the first of all.
    pub(super) fn classify(
        &mut self,
        way: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> Option<StampPlacement> {
        let youngest = self.latest?;
        let index = self.tracks.iter().position(|heard| heard.endpoint == way);
        let heard = index.and_then(|index| self.tracks.get(index)).copied();
        let (place, micros, standing) = classify_stamp(&youngest, heard, stamp, arrival);
        if place == StampPlacement::Restarted {
            return Some(place);
        }
        let last = match heard {
            // Within its way a stamp that was overtaken does not move the reference.
            Some(heard) if heard.status == standing && micros <= heard.last.remote_micros => heard.last,
            Some(heard) if heard.status == standing => heard.last.followed_by(micros, arrival),
            _ => LastStamp::first(micros, arrival),
        };
        self.save_track(StampTrack { endpoint: way, last, status: standing });
        if standing == TrackStatus::Current && micros > youngest.remote_micros {
            self.latest = Some(youngest.followed_by(micros, arrival));
        }
        Some(place)
    }

    /// The clock begins, or begins anew, with a stamp that came by `way`.
    pub(super) fn restart(&mut self, way: Endpoint, remote_micros: i64, arrival: Timestamp<HostClock>) {
        for heard in &mut self.tracks {
            if !matches!(heard.status, TrackStatus::Stale { .. }) {
                let until_micros = heard.last.plausible_range(arrival).latest_micros;
                heard.status = TrackStatus::Stale { until_micros };
            }
        }
        let first = LastStamp::first(remote_micros, arrival);
        self.latest = Some(first);
        self.save_track(StampTrack { endpoint: way, last: first, status: TrackStatus::Current });
    }

    fn save_track(&mut self, heard: StampTrack) {
        let known = self.tracks.iter_mut().find(|known| known.endpoint == heard.endpoint);
        if let Some(known) = known {
            *known = heard;
            return;
        }
        if self.tracks.len() >= MAX_TRACKS {
            let silent = (0..self.tracks.len()).min_by_key(|&index| self.tracks[index].last.arrival);
            self.tracks.swap_remove(silent.unwrap_or(0));
        }
        self.tracks.push(heard);
    }
}

/// Where a stamp belongs, its instant on the clock of which it speaks, and what its way is then.
fn classify_stamp(
    youngest: &LastStamp,
    heard: Option<StampTrack>,
    stamp: WireStamp,
    arrival: Timestamp<HostClock>,
) -> (StampPlacement, i64, TrackStatus) {
    let standing = heard.map(|heard| heard.status);
    let own = heard.and_then(|heard| {
        let believable = heard.last.plausible_range(arrival);
        let micros = believable.instant_of(stamp);
        believable.contains(micros).then_some(micros)
    });
    if let (Some(TrackStatus::Current), own) = (standing, own) {
        return own.map_or((StampPlacement::Restarted, 0, TrackStatus::Current), |micros| {
            (StampPlacement::Continued(micros), micros, TrackStatus::Current)
        });
    }
    let believable = youngest.plausible_range(arrival);
    let micros = believable.instant_of(stamp);
    if believable.contains(micros) {
        return (StampPlacement::Continued(micros), micros, TrackStatus::Current);
    }
    let is_late = (0..believable.latest_micros).contains(&micros);
    match (standing, own) {
        (Some(TrackStatus::Stale { until_micros }), Some(own)) if own <= until_micros => {
            (StampPlacement::Stale, own, TrackStatus::Stale { until_micros })
        }
        (Some(TrackStatus::Stale { .. }), None) if is_late => {
            (StampPlacement::Continued(micros), micros, TrackStatus::Current)
        }
        _ if is_late && arrival - youngest.arrival <= ALIVE_WINDOW => {
            (StampPlacement::Continued(micros), micros, TrackStatus::Behind)
        }
        _ => (StampPlacement::Restarted, 0, TrackStatus::Current),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{LinkId, PeerId};

    const MILLI: i64 = 1_000;

    const fn way(link: u16) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(0) }
    }

    /// A stamp in ms by a way at an instant in ms; a restart is followed, as its caller must.
    fn give(ways: &mut StampTracks, link: u16, stamp_ms: i64, arrival_ms: i64) -> Option<StampPlacement> {
        let arrival = Timestamp::from_millis(arrival_ms);
        let stamp = WireStamp::Micros64((stamp_ms * MILLI) as u64);
        let place = ways.classify(way(link), stamp, arrival);
        if matches!(place, None | Some(StampPlacement::Restarted)) {
            ways.restart(way(link), stamp_ms * MILLI, arrival);
        }
        place
    }

    /// Two ways that have both spoken of a clock which shows a hundred seconds at host zero.
    fn two_ways() -> StampTracks {
        let mut ways = StampTracks::default();
        assert_eq!(give(&mut ways, 0, 100_000, 0), None);
        let micros = 100_010 * MILLI;
        assert_eq!(give(&mut ways, 1, 100_010, 20), Some(StampPlacement::Continued(micros)));
        ways
    }

    #[test]
    fn a_fall_by_one_way_is_a_restart_and_by_two_it_is_none() {
        let mut ways = two_ways();
        give(&mut ways, 0, 105_000, 5_000);
        let late = give(&mut ways, 1, 100_060, 5_010);
        assert_eq!(late, Some(StampPlacement::Continued(100_060 * MILLI)));
        let fallen = give(&mut ways, 0, 100_070, 5_020);
        assert_eq!(fallen, Some(StampPlacement::Restarted));
    }

    #[test]
    fn after_a_restart_the_other_way_is_outlived_until_it_falls_too() {
        let mut ways = two_ways();
        assert_eq!(give(&mut ways, 0, 50, 10_000), Some(StampPlacement::Restarted));
        for (stamp_ms, place) in [
            (100_100, StampPlacement::Stale),
            (109_900, StampPlacement::Stale),
            // Late, but of the new clock: it has fallen.
            (40, StampPlacement::Continued(40 * MILLI)),
            (200, StampPlacement::Continued(200 * MILLI)),
        ] {
            give(&mut ways, 0, 4_000, 13_950);
            let found = give(&mut ways, 1, stamp_ms, 14_000);
            assert_eq!(found, Some(place), "{stamp_ms} ms");
        }
    }

    #[test]
    fn an_old_clock_that_runs_on_past_its_end_has_not_ended() {
        let mut ways = two_ways();
        // Damage, after which the way is silent.
        assert_eq!(give(&mut ways, 0, 900_000, 1_000), Some(StampPlacement::Restarted));
        assert_eq!(give(&mut ways, 1, 101_000, 1_010), Some(StampPlacement::Stale));
        let before = give(&mut ways, 1, 101_900, 1_910);
        assert_eq!(before, Some(StampPlacement::Stale));
        let mut instants = (2_000..8_000).step_by(50);
        let end = instants.find(|now| give(&mut ways, 1, 100_000 + now, *now) == Some(StampPlacement::Restarted));
        assert!(end.is_some_and(|end| end <= 3_100), "{end:?}");
    }

    #[test]
    fn a_way_that_was_never_heard_is_late_only_while_another_one_speaks() {
        for (silence_ms, expected) in
            [(2_000, StampPlacement::Continued(50 * MILLI)), (2_001, StampPlacement::Restarted)]
        {
            let mut ways = two_ways();
            let found = give(&mut ways, 2, 50, 20 + silence_ms);
            assert_eq!(found, Some(expected), "{silence_ms} ms");
        }
    }

    #[test]
    fn of_many_ways_the_one_that_was_silent_longest_is_forgotten() {
        let mut ways = two_ways();
        for link in 2..20 {
            give(&mut ways, link, 100_100, 100);
            give(&mut ways, 0, 100_100 + i64::from(link), 100 + i64::from(link));
        }
        assert_eq!(ways.tracks.len(), MAX_TRACKS);
        assert!(ways.tracks.iter().any(|heard| heard.endpoint == way(0)));
        assert!(!ways.tracks.iter().any(|heard| heard.endpoint == way(1)));
    }
}

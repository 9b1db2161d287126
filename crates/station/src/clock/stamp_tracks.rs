//! One remote clock whose stamps arrive from several endpoints: which endpoint delivers the clock as it runs, and which still the time
//! before a restart.
//!
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
//! A stamp follows another if it lies in [`LastStamp::plausible_range`]. An endpoint without a stamp before the restart cannot be
//! distinguished from a late one. It counts as late while another endpoint continues the clock as it was, and for two seconds more.
//!
//! # Sources
//! docs/maths/clock.md, section 1.

use posebridge_protocol::message::WireStamp;
use posebridge_telemetry::{HostClock, TimeDelta, Timestamp};

use super::Endpoint;
use super::last_stamp::LastStamp;

/// Most endpoints that are followed; the one that was silent longest is dropped first. No robot is connected by more
/// links.
const MAX_TRACKS: usize = 8;
/// For this long after its latest stamp a clock counts as running on, whatever stamps a new endpoint delivers. Telemetry comes more
/// often than this; with this value a restart is detected within three seconds.
const ALIVE_WINDOW: TimeDelta = TimeDelta::from_millis(2_000);

/// The last stamp of every endpoint, and the latest of them.
#[derive(Clone, Debug, Default)]
pub(super) struct StampTracks {
    latest: Option<LastStamp>,
    tracks: Vec<StampTrack>,
}

/// The last stamp of one endpoint.
#[derive(Clone, Copy, Debug)]
struct StampTrack {
    endpoint: Endpoint,
    last: LastStamp,
    status: TrackStatus,
}

/// The clock of an endpoint's stamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StampPlacement {
    /// An instant of the current clock, in microseconds.
    Continued(i64),
    /// An instant of the clock before its last restart.
    Stale,
    /// The first one after a restart.
    Restarted,
}

impl StampTracks {
    pub(super) const fn latest(&self) -> Option<LastStamp> {
        self.latest
    }

    /// Classifies a stamp from `endpoint` that arrived at `arrival`, and stores it unless it means a restart: then
    /// [`Self::restart`] must follow. `None` for the first stamp.
    pub(super) fn classify(
        &mut self,
        endpoint: Endpoint,
        stamp: WireStamp,
        arrival: Timestamp<HostClock>,
    ) -> Option<StampPlacement> {
        let latest = self.latest?;
        let index = self.tracks.iter().position(|track| track.endpoint == endpoint);
        let track = index.and_then(|index| self.tracks.get(index)).copied();
        let (placement, micros, status) = classify_stamp(&latest, track, stamp, arrival);
        if placement == StampPlacement::Restarted {
            return Some(placement);
        }
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
        Some(placement)
    }

    /// Starts or restarts the clock with a stamp from `endpoint`.
    pub(super) fn restart(&mut self, endpoint: Endpoint, remote_micros: i64, arrival: Timestamp<HostClock>) {
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

/// The placement of a stamp, its instant on its clock, and the new status of its endpoint.
fn classify_stamp(
    latest: &LastStamp,
    track: Option<StampTrack>,
    stamp: WireStamp,
    arrival: Timestamp<HostClock>,
) -> (StampPlacement, i64, TrackStatus) {
    let status = track.map(|track| track.status);
    let own = track.and_then(|track| {
        let plausible = track.last.plausible_range(arrival);
        let micros = plausible.instant_of(stamp);
        plausible.contains(micros).then_some(micros)
    });
    if let (Some(TrackStatus::Current), own) = (status, own) {
        return own.map_or((StampPlacement::Restarted, 0, TrackStatus::Current), |micros| {
            (StampPlacement::Continued(micros), micros, TrackStatus::Current)
        });
    }
    let plausible = latest.plausible_range(arrival);
    let micros = plausible.instant_of(stamp);
    if plausible.contains(micros) {
        return (StampPlacement::Continued(micros), micros, TrackStatus::Current);
    }
    let is_late = (0..plausible.latest_micros).contains(&micros);
    match (status, own) {
        (Some(TrackStatus::Stale { until_micros }), Some(own)) if own <= until_micros => {
            (StampPlacement::Stale, own, TrackStatus::Stale { until_micros })
        }
        (Some(TrackStatus::Stale { .. }), None) if is_late => {
            (StampPlacement::Continued(micros), micros, TrackStatus::Current)
        }
        _ if is_late && arrival - latest.arrival <= ALIVE_WINDOW => {
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

    const fn endpoint(link: u16) -> Endpoint {
        Endpoint { link: LinkId(link), peer: PeerId(0) }
    }

    /// Classifies a stamp in ms that a link delivers at an instant in ms, and calls `restart` where the caller must.
    fn classify(tracks: &mut StampTracks, link: u16, stamp_ms: i64, arrival_ms: i64) -> Option<StampPlacement> {
        let arrival = Timestamp::from_millis(arrival_ms);
        let stamp = WireStamp::Micros64((stamp_ms * MILLI) as u64);
        let placement = tracks.classify(endpoint(link), stamp, arrival);
        if matches!(placement, None | Some(StampPlacement::Restarted)) {
            tracks.restart(endpoint(link), stamp_ms * MILLI, arrival);
        }
        placement
    }

    /// Two endpoints that have delivered stamps of a clock which shows a hundred seconds at host zero.
    fn two_endpoints() -> StampTracks {
        let mut tracks = StampTracks::default();
        assert_eq!(classify(&mut tracks, 0, 100_000, 0), None);
        let micros = 100_010 * MILLI;
        assert_eq!(classify(&mut tracks, 1, 100_010, 20), Some(StampPlacement::Continued(micros)));
        tracks
    }

    #[test]
    fn a_fall_on_one_endpoint_is_a_restart_and_on_two_it_is_none() {
        let mut tracks = two_endpoints();
        classify(&mut tracks, 0, 105_000, 5_000);
        let late = classify(&mut tracks, 1, 100_060, 5_010);
        assert_eq!(late, Some(StampPlacement::Continued(100_060 * MILLI)));
        let fallen = classify(&mut tracks, 0, 100_070, 5_020);
        assert_eq!(fallen, Some(StampPlacement::Restarted));
    }

    #[test]
    fn after_a_restart_another_endpoint_is_stale_until_it_falls_too() {
        let mut tracks = two_endpoints();
        assert_eq!(classify(&mut tracks, 0, 50, 10_000), Some(StampPlacement::Restarted));
        for (stamp_ms, placement) in [
            (100_100, StampPlacement::Stale),
            (109_900, StampPlacement::Stale),
            // Late, but of the new clock: it has fallen.
            (40, StampPlacement::Continued(40 * MILLI)),
            (200, StampPlacement::Continued(200 * MILLI)),
        ] {
            classify(&mut tracks, 0, 4_000, 13_950);
            let found = classify(&mut tracks, 1, stamp_ms, 14_000);
            assert_eq!(found, Some(placement), "{stamp_ms} ms");
        }
    }

    #[test]
    fn an_old_clock_that_runs_on_past_its_end_has_not_ended() {
        let mut tracks = two_endpoints();
        // Damage, after which the endpoint is silent.
        assert_eq!(classify(&mut tracks, 0, 900_000, 1_000), Some(StampPlacement::Restarted));
        assert_eq!(classify(&mut tracks, 1, 101_000, 1_010), Some(StampPlacement::Stale));
        let before = classify(&mut tracks, 1, 101_900, 1_910);
        assert_eq!(before, Some(StampPlacement::Stale));
        let mut instants = (2_000..8_000).step_by(50);
        let end = instants.find(|now| classify(&mut tracks, 1, 100_000 + now, *now) == Some(StampPlacement::Restarted));
        assert!(end.is_some_and(|end| end <= 3_100), "{end:?}");
    }

    #[test]
    fn a_new_endpoint_is_late_only_while_another_one_is_active() {
        for (silence_ms, expected) in
            [(2_000, StampPlacement::Continued(50 * MILLI)), (2_001, StampPlacement::Restarted)]
        {
            let mut tracks = two_endpoints();
            let found = classify(&mut tracks, 2, 50, 20 + silence_ms);
            assert_eq!(found, Some(expected), "{silence_ms} ms");
        }
    }

    #[test]
    fn the_endpoint_that_was_silent_longest_is_evicted() {
        let mut tracks = two_endpoints();
        for link in 2..20 {
            classify(&mut tracks, link, 100_100, 100);
            classify(&mut tracks, 0, 100_100 + i64::from(link), 100 + i64::from(link));
        }
        assert_eq!(tracks.tracks.len(), MAX_TRACKS);
        assert!(tracks.tracks.iter().any(|track| track.endpoint == endpoint(0)));
        assert!(!tracks.tracks.iter().any(|track| track.endpoint == endpoint(1)));
    }
}

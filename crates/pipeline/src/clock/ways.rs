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
use posebridge_telemetry::{HostClock, Span, Stamp};

use super::Way;
use super::unwrap::Seen;

/// Most ways that are followed; the one that was silent longest goes first. Nobody joins a robot by more links.
const MOST_WAYS: usize = 8;
/// So long after its youngest stamp a clock is held to run on as it did, whatever a way says that was not heard before. Telemetry that
/// is rarer than this is no telemetry; with this a restart is known within three seconds.
const ALIVE: Span = Span::from_millis(2_000);

/// What came by every way, and the youngest of it.
#[derive(Clone, Debug, Default)]
pub(super) struct Ways {
    youngest: Option<Seen>,
    /// In no order.
    heard: Vec<Heard>,
}

/// The last stamp of one way.
#[derive(Clone, Copy, Debug)]
struct Heard {
    way: Way,
    last: Seen,
    standing: Standing,
}

/// Of which clock a way speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Standing {
    /// Of the clock as it runs.
    Current,
    /// Of instants that are long past, ever since it was first heard.
    Behind,
    /// Of the clock before a restart that another way has told of. Nothing that was sent before it is stamped later than this.
    Outlived { until_micros: i64 },
}

/// What a stamp is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// An instant of the clock as it runs, in microseconds.
    RunsOn(i64),
    /// An instant of the clock before its last restart.
    Outlived,
    /// The first one after a restart.
    Restarted,
}

impl Ways {
    /// The youngest stamp by any way.
    pub(super) const fn youngest(&self) -> Option<Seen> {
        self.youngest
    }

    /// Where a stamp belongs that came by `way` at `arrival`; takes note of it, unless it tells of a restart: then [`Self::begin`]
    /// must follow. `None` if it is the first of all.
    pub(super) fn place(&mut self, way: Way, stamp: WireStamp, arrival: Stamp<HostClock>) -> Option<Place> {
        let youngest = self.youngest?;
        let index = self.heard.iter().position(|heard| heard.way == way);
        let heard = index.and_then(|index| self.heard.get(index)).copied();
        let (place, micros, standing) = judge(&youngest, heard, stamp, arrival);
        if place == Place::Restarted {
            return Some(place);
        }
        let last = match heard {
            // Within its way a stamp that was overtaken does not move the reference.
            Some(heard) if heard.standing == standing && micros <= heard.last.remote_micros => heard.last,
            Some(heard) if heard.standing == standing => heard.last.followed_by(micros, arrival),
            _ => Seen::at(micros, arrival),
        };
        self.keep(Heard { way, last, standing });
        if standing == Standing::Current && micros > youngest.remote_micros {
            self.youngest = Some(youngest.followed_by(micros, arrival));
        }
        Some(place)
    }

    /// The clock begins, or begins anew, with a stamp that came by `way`.
    pub(super) fn begin(&mut self, way: Way, remote_micros: i64, arrival: Stamp<HostClock>) {
        for heard in &mut self.heard {
            if !matches!(heard.standing, Standing::Outlived { .. }) {
                let until_micros = heard.last.believable(arrival).latest_micros;
                heard.standing = Standing::Outlived { until_micros };
            }
        }
        let first = Seen::at(remote_micros, arrival);
        self.youngest = Some(first);
        self.keep(Heard { way, last: first, standing: Standing::Current });
    }

    fn keep(&mut self, heard: Heard) {
        let known = self.heard.iter_mut().find(|known| known.way == heard.way);
        if let Some(known) = known {
            *known = heard;
            return;
        }
        if self.heard.len() >= MOST_WAYS {
            let silent = (0..self.heard.len()).min_by_key(|&index| self.heard[index].last.arrival);
            self.heard.swap_remove(silent.unwrap_or(0));
        }
        self.heard.push(heard);
    }
}

/// Where a stamp belongs, its instant on the clock of which it speaks, and what its way is then.
fn judge(youngest: &Seen, heard: Option<Heard>, stamp: WireStamp, arrival: Stamp<HostClock>) -> (Place, i64, Standing) {
    let standing = heard.map(|heard| heard.standing);
    let own = heard.and_then(|heard| {
        let believable = heard.last.believable(arrival);
        let micros = believable.instant_of(stamp);
        believable.contains(micros).then_some(micros)
    });
    if let (Some(Standing::Current), own) = (standing, own) {
        return own.map_or((Place::Restarted, 0, Standing::Current), |micros| {
            (Place::RunsOn(micros), micros, Standing::Current)
        });
    }
    let believable = youngest.believable(arrival);
    let micros = believable.instant_of(stamp);
    if believable.contains(micros) {
        return (Place::RunsOn(micros), micros, Standing::Current);
    }
    let is_late = (0..believable.latest_micros).contains(&micros);
    match (standing, own) {
        (Some(Standing::Outlived { until_micros }), Some(own)) if own <= until_micros => {
            (Place::Outlived, own, Standing::Outlived { until_micros })
        }
        (Some(Standing::Outlived { .. }), None) if is_late => (Place::RunsOn(micros), micros, Standing::Current),
        _ if is_late && arrival - youngest.arrival <= ALIVE => (Place::RunsOn(micros), micros, Standing::Behind),
        _ => (Place::Restarted, 0, Standing::Current),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::{LinkId, PeerId};

    const MILLI: i64 = 1_000;

    const fn way(link: u16) -> Way {
        Way { link: LinkId(link), peer: PeerId(0) }
    }

    /// A stamp in ms by a way at an instant in ms; a restart is followed, as its caller must.
    fn give(ways: &mut Ways, link: u16, stamp_ms: i64, arrival_ms: i64) -> Option<Place> {
        let arrival = Stamp::from_millis(arrival_ms);
        let stamp = WireStamp::Micros64((stamp_ms * MILLI) as u64);
        let place = ways.place(way(link), stamp, arrival);
        if matches!(place, None | Some(Place::Restarted)) {
            ways.begin(way(link), stamp_ms * MILLI, arrival);
        }
        place
    }

    /// Two ways that have both spoken of a clock which shows a hundred seconds at host zero.
    fn two_ways() -> Ways {
        let mut ways = Ways::default();
        assert_eq!(give(&mut ways, 0, 100_000, 0), None);
        let micros = 100_010 * MILLI;
        assert_eq!(give(&mut ways, 1, 100_010, 20), Some(Place::RunsOn(micros)));
        ways
    }

    #[test]
    fn a_fall_by_one_way_is_a_restart_and_by_two_it_is_none() {
        let mut ways = two_ways();
        give(&mut ways, 0, 105_000, 5_000);
        let late = give(&mut ways, 1, 100_060, 5_010);
        assert_eq!(late, Some(Place::RunsOn(100_060 * MILLI)));
        let fallen = give(&mut ways, 0, 100_070, 5_020);
        assert_eq!(fallen, Some(Place::Restarted));
    }

    #[test]
    fn after_a_restart_the_other_way_is_outlived_until_it_falls_too() {
        let mut ways = two_ways();
        assert_eq!(give(&mut ways, 0, 50, 10_000), Some(Place::Restarted));
        for (stamp_ms, place) in [
            (100_100, Place::Outlived),
            (109_900, Place::Outlived),
            // Late, but of the new clock: it has fallen.
            (40, Place::RunsOn(40 * MILLI)),
            (200, Place::RunsOn(200 * MILLI)),
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
        assert_eq!(give(&mut ways, 0, 900_000, 1_000), Some(Place::Restarted));
        assert_eq!(give(&mut ways, 1, 101_000, 1_010), Some(Place::Outlived));
        let before = give(&mut ways, 1, 101_900, 1_910);
        assert_eq!(before, Some(Place::Outlived));
        let mut instants = (2_000..8_000).step_by(50);
        let end = instants.find(|now| give(&mut ways, 1, 100_000 + now, *now) == Some(Place::Restarted));
        assert!(end.is_some_and(|end| end <= 3_100), "{end:?}");
    }

    #[test]
    fn a_way_that_was_never_heard_is_late_only_while_another_one_speaks() {
        for (silence_ms, expected) in [(2_000, Place::RunsOn(50 * MILLI)), (2_001, Place::Restarted)] {
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
        assert_eq!(ways.heard.len(), MOST_WAYS);
        assert!(ways.heard.iter().any(|heard| heard.way == way(0)));
        assert!(!ways.heard.iter().any(|heard| heard.way == way(1)));
    }
}

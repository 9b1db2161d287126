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
    pub(super) fn place(
        &mut self,
        way: Way,
        stamp: WireStamp,
        arrival: Stamp<HostClock>,
    ) -> Option<Place> {
        let youngest = self.youngest?;
        let index = self.heard.iter().position(|heard| heard.way == way);
        let heard = index.and_then(|index| self.heard.get(index)).copied();
        let (place, micros, standing) = judge(&youngest, heard, stamp, arrival);
        if place == Place::Restarted {
            return Some(place);
        }
        let last = match heard {
            // Within its way a stamp that was overtaken does not move the reference.
            Some(heard) if heard.standing == standing && micros <= heard.last.remote_micros => {
                heard.last
            }
            Some(heard) if heard.standing == standing => heard.last.followed_by(micros, arrival),
            _ => Seen::at(micros, arrival),
        };
        self.keep(Heard {
            way,
            last,
            standing,
        });
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
        self.keep(Heard {
            way,
            last: first,
            standing: Standing::Current,
        });
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
fn judge(
    youngest: &Seen,
    heard: Option<Heard>,
    stamp: WireStamp,
    arrival: Stamp<HostClock>,
) -> (Place, i64, Standing) {
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
        (Some(Standing::Outlived { .. }), None) if is_late => {
            (Place::RunsOn(micros), micros, Standing::Current)
        }
        _ if is_late && arrival - youngest.arrival <= ALIVE => {
            (Place::RunsOn(micros), micros, Standing::Behind)
        }
        _ => (Place::Restarted, 0, Standing::Current),
    }
}

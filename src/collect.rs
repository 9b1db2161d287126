//! What a run leaves behind for tables and pictures, gathered from its events.

use std::collections::BTreeMap;

use posebridge_analysis::{FixMark, SourceTally, TimedPose, Track};
use posebridge_sim::REMEMBERED;
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Event, FusionRecord, LinkId, Observation, Observed, Point2, Span, Stamp,
};

use crate::report::links::LinkReport;

/// So many estimates are kept; from then on every second one is, and so on: a run of days must not fill the memory.
const KEPT: usize = 50_000;
/// The same for a live run, whose memory must not grow after its first minute: still more than a picture has columns.
const KEPT_LIVE: usize = 2_048;
/// Of a live run without an end at least so much is kept, and the oldest goes: as much as its simulated brick remembers.
const REMEMBERED_LIVE: Span = REMEMBERED;
/// A track is not interpolated across a longer silence.
pub const LONGEST_GAP: Span = Span::from_millis(1_000);

/// Gathers.
#[derive(Debug, Default)]
pub struct Collector {
    /// Estimates whose position and heading were valid.
    pub estimates: Thinned<Estimate>,
    /// Fixes with what became of them.
    pub fixes: Thinned<FixMark>,
    /// How the observations of each sensor fared.
    pub sources: Vec<SourceTally>,
    /// How many observations came.
    pub observations: u64,
    /// The last word on each link's health.
    pub links: BTreeMap<LinkId, LinkReport>,
    /// How often the brick restarted.
    pub restarts: u64,
    /// Every observation as the estimator was given it, for the offline smoother; nothing unless
    /// [`Self::keeping_observations`].
    pub kept: Vec<Observation>,
    keeping: Keeping,
    last_fix: Option<Point2<Arena>>,
}

/// Whether observations are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Keeping {
    /// A run of days must not fill the memory.
    #[default]
    Nothing,
    /// All of them.
    Observations,
}

impl Collector {
    /// One for a live run without a known end: it takes all of its memory at once.
    #[must_use]
    pub fn live() -> Self {
        Self {
            estimates: Thinned::recent(KEPT_LIVE, REMEMBERED_LIVE, |estimate| estimate.stamp),
            fixes: Thinned::recent(KEPT_LIVE, REMEMBERED_LIVE, |fix| fix.stamp),
            ..Self::default()
        }
    }

    /// One that keeps every observation: for recordings, whose length is known.
    #[must_use]
    pub fn keeping_observations() -> Self {
        Self { keeping: Keeping::Observations, ..Self::default() }
    }

    /// Takes an event.
    pub fn take(&mut self, event: &Event) {
        match event {
            Event::Observed { observation, .. } => {
                self.observations += 1;
                if self.keeping == Keeping::Observations {
                    self.kept.push(*observation);
                }
                self.last_fix = if let Observed::Fix(fix) = observation.observed { Some(fix.position) } else { None };
            }
            Event::Fused { record, .. } => self.take_record(record),
            Event::Estimated { estimate, .. } => {
                if estimate.validity.position && estimate.validity.heading {
                    self.estimates.push(*estimate);
                }
            }
            Event::Health { link, health, sources } => {
                let report = LinkReport { health: *health, sources: sources.clone() };
                self.links.insert(*link, report);
            }
            Event::BrickRestarted { .. } => self.restarts += 1,
            Event::RobotSeen { .. }
            | Event::RobotLost { .. }
            | Event::Temperature { .. }
            | Event::BrickClockAligned { .. }
            | Event::CameraClockAligned { .. }
            | Event::Link { .. }
            | Event::Defect { .. }
            | Event::Text { .. } => {}
        }
    }

    fn take_record(&mut self, record: &FusionRecord) {
        posebridge_analysis::metrics::count_in(&mut self.sources, record);
        if let Some(position) = self.last_fix {
            self.fixes.push(FixMark { stamp: record.stamp, position, verdict: record.verdict });
        }
    }

    /// The estimates as a track.
    #[must_use]
    pub fn track(&self) -> Track {
        let samples =
            self.estimates.items().iter().map(|estimate| TimedPose { stamp: estimate.stamp, pose: estimate.pose });
        Track::new(samples, LONGEST_GAP)
    }
}

/// A list that keeps every item, then every second, then every fourth, so that it never holds more than a fixed number. One for the recent
/// past stops to thin once it reaches back far enough, and forgets the oldest instead.
#[derive(Debug)]
pub struct Thinned<T> {
    items: Vec<T>,
    most: usize,
    stride: usize,
    seen: usize,
    recent: Option<Recent<T>>,
}

/// How far back a list of the recent past has to reach, and how old its items are.
#[derive(Debug)]
struct Recent<T> {
    reach: Span,
    stamp_of: fn(&T) -> Stamp<BrickClock>,
}

impl<T> Default for Thinned<T> {
    fn default() -> Self {
        Self::keeping(KEPT)
    }
}

impl<T> Thinned<T> {
    /// An empty list that never holds more than `most` items.
    #[must_use]
    pub fn keeping(most: usize) -> Self {
        Self { items: Vec::new(), most, stride: 1, seen: 0, recent: None }
    }

    /// An empty list with room for `most` items that reaches back at least so far.
    fn recent(most: usize, reach: Span, stamp_of: fn(&T) -> Stamp<BrickClock>) -> Self {
        Self { items: Vec::with_capacity(most), recent: Some(Recent { reach, stamp_of }), ..Self::keeping(most) }
    }

    /// Takes the next item.
    pub fn push(&mut self, item: T) {
        if self.seen.is_multiple_of(self.stride) {
            self.items.push(item);
        }
        self.seen += 1;
        if self.items.len() < self.most {
            return;
        }
        if self.reaches_back() {
            self.items.drain(..self.most / 4);
        } else {
            let mut index = 0;
            self.items.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
    }

    /// Whether three quarters of the list would still reach back far enough.
    fn reaches_back(&self) -> bool {
        let Some(recent) = &self.recent else {
            return false;
        };
        let later = self.items.get(self.most / 4).zip(self.items.last());
        later.is_some_and(|(oldest, newest)| (recent.stamp_of)(newest) - (recent.stamp_of)(oldest) >= recent.reach)
    }

    /// The items that were kept, oldest first.
    #[must_use]
    pub fn items(&self) -> &[T] {
        &self.items
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_list_stays_small_and_even() {
        let mut list = Thinned::default();
        for item in 0..4 * KEPT {
            list.push(item);
        }
        assert!(list.items().len() < KEPT);
        let steps: Vec<usize> = list.items().windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step == steps[0]), "evenly spaced");
    }

    #[test]
    fn a_list_of_the_recent_past_reaches_back_far_enough_and_takes_no_more_memory() {
        let reach = Span::from_millis(1_000);
        let mut list = Thinned::recent(100, reach, |item: &i64| Stamp::from_millis(*item));
        let capacity = list.items.capacity();
        for item in 0..100_000 {
            list.push(item);
            let (oldest, newest) = (list.items()[0], *list.items().last().unwrap());
            assert!(newest - oldest >= item.min(1_000) - 32, "{oldest} {newest}");
            assert!(newest - oldest <= 3_200, "{oldest} {newest}");
        }
        assert!((50..100).contains(&list.items().len()));
        assert_eq!(list.items.capacity(), capacity);
        let steps: Vec<i64> = list.items().windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step == steps[0]), "evenly spaced");
    }
}

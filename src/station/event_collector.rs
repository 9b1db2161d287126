//! Collects estimates and counts from the events of a run, for tables and figures.

use std::collections::BTreeMap;

use posebridge_report::{ComparedTrack, FixMark, PoseTrack, SourceTally, TimedPose, on_map};
use posebridge_sim::HISTORY_DURATION;
use posebridge_telemetry::{
    Arena, BrickClock, Estimate, Event, FusionRecord, LinkId, Observation, ObservationKind, Point2, QuantitySteps,
    TimeDelta, Timestamp,
};

use super::link_report::LinkReport;

/// When full, every second estimate is dropped, and so on: a run of days must not fill the memory.
const MAX_ESTIMATES: usize = 50_000;
/// Capacity for a live run, whose memory must not grow after its first minute: still more than a figure has columns.
const MAX_ESTIMATES_LIVE: usize = 2_048;
/// Minimum history of an endless live run, like that of the simulated brick; older estimates are dropped.
const HISTORY_LIVE: TimeDelta = HISTORY_DURATION;
/// Tracks are not interpolated across a longer gap.
pub const MAX_INTERPOLATION_GAP: TimeDelta = TimeDelta::from_millis(1_000);

#[derive(Debug, Default)]
pub struct EventCollector {
    /// Only those with a heading; see [`on_map`] for those before the robot was found in the arena.
    pub estimates: ThinnedSeries<Estimate>,
    pub fixes: ThinnedSeries<FixMark>,
    pub sources: Vec<SourceTally>,
    /// Of a filter of one quantity; none are taken by a filter of a pose.
    pub quantity_steps: QuantitySteps,
    /// Filters that ran beside the robot's own, in the order of the configuration.
    pub compared: Vec<ComparedFilter>,
    pub observations: u64,
    pub links: BTreeMap<LinkId, LinkReport>,
    pub restarts: u64,
    /// Every observation of the estimator, for the offline smoother; empty unless [`Self::with_observations`].
    pub retained_observations: Vec<Observation>,
    /// False in live runs, which would fill the memory.
    retains_observations: bool,
    is_live: bool,
    last_fix: Option<Point2<Arena>>,
}

/// Results of a filter that ran beside the robot's own.
#[derive(Debug)]
pub struct ComparedFilter {
    pub name: &'static str,
    /// Only those with a heading; see [`on_map`] for those before the robot was found in the arena.
    pub estimates: ThinnedSeries<Estimate>,
    pub sources: Vec<SourceTally>,
}

impl EventCollector {
    /// For a live run without a known end: allocates all of its memory at once.
    pub fn live() -> Self {
        Self {
            estimates: estimates_of_live_run(),
            is_live: true,
            fixes: ThinnedSeries::with_window(MAX_ESTIMATES_LIVE, HISTORY_LIVE, |fix| fix.time),
            ..Self::default()
        }
    }

    /// Retains every observation: for recordings, whose length is known.
    pub fn with_observations() -> Self {
        Self { retains_observations: true, ..Self::default() }
    }

    #[expect(clippy::wildcard_enum_match_arm, reason = "the other events change nothing here")]
    pub fn on_event(&mut self, event: &Event) {
        match event {
            Event::ObservationAligned { observation, .. } => {
                self.observations += 1;
                if self.retains_observations {
                    self.retained_observations.push(*observation);
                }
                self.last_fix =
                    if let ObservationKind::Fix(fix) = observation.measurement { Some(fix.position) } else { None };
            }
            Event::ObservationFused { record, .. } => self.on_fusion(record),
            Event::EstimateUpdated { estimate, .. } if has_heading(estimate) => {
                self.estimates.push(*estimate);
            }
            Event::QuantityUpdated { estimate, .. } => {
                self.quantity_steps.step(estimate.stamp);
            }
            Event::EstimateCompared { filter, estimate, .. } if has_heading(estimate) => {
                self.compared(filter).estimates.push(*estimate);
            }
            Event::ObservationCompared { filter, record, .. } => {
                posebridge_report::metrics::add_to_tallies(&mut self.compared(filter).sources, record);
            }
            Event::Health { link, health, sources } => {
                let report = LinkReport { health: *health, sources: sources.clone() };
                self.links.insert(*link, report);
            }
            Event::BrickRestarted { .. } => self.restarts += 1,
            _ => {}
        }
    }

    fn compared(&mut self, name: &'static str) -> &mut ComparedFilter {
        let known = self.compared.iter().position(|compared| compared.name == name);
        let index = known.unwrap_or_else(|| {
            let estimates = if self.is_live { estimates_of_live_run() } else { ThinnedSeries::default() };
            self.compared.push(ComparedFilter { name, estimates, sources: Vec::new() });
            self.compared.len() - 1
        });
        &mut self.compared[index]
    }

    fn on_fusion(&mut self, record: &FusionRecord) {
        posebridge_report::metrics::add_to_tallies(&mut self.sources, record);
        self.quantity_steps.observe(record);
        if let Some(position) = self.last_fix {
            self.fixes.push(FixMark { time: record.stamp, position, verdict: record.outcome });
        }
    }

    /// Of a filter of one quantity: its steps in words.
    pub fn quantity_steps_text(&self) -> Option<String> {
        (self.quantity_steps.taken() > 0).then(|| self.quantity_steps.to_string())
    }

    /// In the arena; empty for a robot that was never found there.
    pub fn track(&self) -> PoseTrack {
        track_of(self.estimates.items().iter().filter(|estimate| !estimate.is_relative()))
    }

    /// Those parts that count from the same origin as the robot's own estimates.
    pub fn compared_tracks(&self) -> Vec<ComparedTrack> {
        let is_shown = on_map(self.estimates.items());
        let compared = self.compared.iter().map(|compared| {
            let shown = compared.estimates.items().iter().filter(|estimate| is_shown(estimate));
            ComparedTrack { filter: compared.name, track: track_of(shown) }
        });
        compared.collect()
    }
}

fn has_heading(estimate: &Estimate) -> bool {
    estimate.is_relative() || estimate.validity.heading
}

fn track_of<'e>(estimates: impl Iterator<Item = &'e Estimate>) -> PoseTrack {
    let samples = estimates.map(|estimate| TimedPose { time: estimate.stamp, pose: estimate.pose });
    PoseTrack::new(samples, MAX_INTERPOLATION_GAP)
}

fn estimates_of_live_run() -> ThinnedSeries<Estimate> {
    ThinnedSeries::with_window(MAX_ESTIMATES_LIVE, HISTORY_LIVE, |estimate| estimate.stamp)
}

/// A bounded list that keeps every item, then every second, then every fourth. With a window it stops thinning once the items cover it,
/// and drops the oldest instead.
#[derive(Debug)]
pub struct ThinnedSeries<T> {
    items: Vec<T>,
    capacity: usize,
    stride: usize,
    pushed: usize,
    recent: Option<RecentWindow<T>>,
}

/// Minimum duration of a list of recent items, and their timestamps.
#[derive(Debug)]
struct RecentWindow<T> {
    duration: TimeDelta,
    time_of: fn(&T) -> Timestamp<BrickClock>,
}

impl<T> Default for ThinnedSeries<T> {
    fn default() -> Self {
        Self::with_capacity(MAX_ESTIMATES)
    }
}

impl<T> ThinnedSeries<T> {
    pub fn with_capacity(capacity: usize) -> Self {
        Self { items: Vec::new(), capacity, stride: 1, pushed: 0, recent: None }
    }

    /// Holds at most `most` items that cover at least `duration`.
    fn with_window(most: usize, duration: TimeDelta, stamp_of: fn(&T) -> Timestamp<BrickClock>) -> Self {
        Self {
            items: Vec::with_capacity(most),
            recent: Some(RecentWindow { duration, time_of: stamp_of }),
            ..Self::with_capacity(most)
        }
    }

    pub fn push(&mut self, item: T) {
        if self.pushed.is_multiple_of(self.stride) {
            self.items.push(item);
        }
        self.pushed += 1;
        if self.items.len() < self.capacity {
            return;
        }
        if self.covers_window() {
            self.items.drain(..self.capacity / 4);
        } else {
            let mut index = 0;
            self.items.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
    }

    /// Whether three quarters of the list would still cover the window.
    fn covers_window(&self) -> bool {
        let Some(recent) = &self.recent else {
            return false;
        };
        let later = self.items.get(self.capacity / 4).zip(self.items.last());
        later.is_some_and(|(oldest, newest)| (recent.time_of)(newest) - (recent.time_of)(oldest) >= recent.duration)
    }

    pub const fn pushed(&self) -> usize {
        self.pushed
    }

    /// Oldest first.
    pub fn items(&self) -> &[T] {
        &self.items
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_list_stays_small_and_even() {
        let mut list = ThinnedSeries::default();
        for item in 0..4 * MAX_ESTIMATES {
            list.push(item);
        }
        assert!(list.items().len() < MAX_ESTIMATES);
        let steps: Vec<usize> = list.items().windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps.iter().all(|step| *step == steps[0]), "evenly spaced");
    }

    #[test]
    fn a_list_of_the_recent_past_reaches_back_far_enough_and_takes_no_more_memory() {
        let duration = TimeDelta::from_millis(1_000);
        let mut list = ThinnedSeries::with_window(100, duration, |item: &i64| Timestamp::from_millis(*item));
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

//! Time series: points for the next message, and points retained for the history.

use std::collections::btree_map::{BTreeMap, Entry};
use std::collections::{BTreeSet, VecDeque};

use posebridge_telemetry::{Event, HostClock, RobotId, TimeDelta, Timestamp};

use super::view::{FrameContent, RetentionPolicy, View, ViewInput, robot_name, shared_points};
use crate::model::{Frame, RobotFrame};

/// Points of one kind in a message; there are fifty messages a second, so a brick that sends 200 times a second has four.
const MAX_PENDING: usize = 256;
/// Robots that are shown; a class has fewer, and a sender of forged addresses must not fill the memory.
pub(crate) const MAX_ROBOTS: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PointPriority {
    Normal,
    /// Points of interest: a rejected fix, a reset.
    Keep,
}

#[derive(Clone, Debug)]
struct RetainedPoint<T> {
    at: Timestamp<HostClock>,
    point: T,
    priority: PointPriority,
}

/// Thins the points of one priority over a whole session.
#[derive(Clone, Copy, Debug)]
struct Downsampler {
    /// Retains one in this many.
    stride: usize,
    offered: usize,
    retained: usize,
}

impl Downsampler {
    const NONE: Self = Self { stride: 1, offered: 0, retained: 0 };

    fn retains_next(&mut self) -> bool {
        let is_kept = self.offered.is_multiple_of(self.stride);
        self.offered += 1;
        if is_kept {
            self.retained += 1;
        }
        is_kept
    }
}

/// What a live series keeps of the points that leave its window: of each group of consecutive ones the one of most weight. When they
/// are too many the groups double.
#[derive(Clone, Debug)]
struct OlderPoints<T> {
    policy: OlderPolicy<T>,
    robots: usize,
    kept: Vec<T>,
    group_size: usize,
    group: Option<T>,
    grouped: usize,
}

#[derive(Debug)]
pub(super) struct OlderPolicy<T> {
    pub(super) max_points: usize,
    /// NaN counts as least.
    pub(super) weight: fn(&T) -> f64,
}

impl<T> Clone for OlderPolicy<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for OlderPolicy<T> {}

impl<T> OlderPoints<T> {
    const fn new(policy: OlderPolicy<T>) -> Self {
        Self { policy, robots: 1, kept: Vec::new(), group_size: 1, group: None, grouped: 0 }
    }

    fn push(&mut self, point: T) {
        let group = self.group.take();
        let heavier = self.heavier(group, point);
        self.grouped += 1;
        if self.grouped < self.group_size {
            self.group = Some(heavier);
            return;
        }
        self.grouped = 0;
        self.kept.push(heavier);
        while self.kept.len() >= shared_points(self.policy.max_points, self.robots).max(2) {
            self.halve();
        }
    }

    /// In place: blocks that come and go leave gaps in the memory of a long session.
    fn halve(&mut self) {
        let count = self.kept.len();
        for pair in 0..count / 2 {
            let is_second = self.is_heavier(&self.kept[2 * pair + 1], &self.kept[2 * pair]);
            self.kept.swap(pair, 2 * pair + usize::from(is_second));
        }
        if count % 2 == 1 {
            self.kept.swap(count / 2, count - 1);
        }
        self.kept.truncate(count.div_ceil(2));
        self.group_size *= 2;
    }

    fn heavier(&self, first: Option<T>, second: T) -> T {
        first.filter(|first| !self.is_heavier(&second, first)).unwrap_or(second)
    }

    /// Whether `second` weighs more than `first`, which came before it.
    fn is_heavier(&self, second: &T, first: &T) -> bool {
        let weight = |point: &T| Some((self.policy.weight)(point)).filter(|weight| !weight.is_nan());
        weight(second) > weight(first)
    }
}

#[derive(Clone, Debug)]
pub(super) struct RetainedSeries<T> {
    policy: RetentionPolicy,
    kept: VecDeque<RetainedPoint<T>>,
    older: Option<OlderPoints<T>>,
    last: Option<Timestamp<HostClock>>,
    normal: Downsampler,
    important: Downsampler,
    pending: Vec<T>,
    dropped: u64,
}

impl<T: Clone> RetainedSeries<T> {
    pub(super) const fn new(policy: RetentionPolicy) -> Self {
        Self {
            policy,
            kept: VecDeque::new(),
            older: None,
            last: None,
            normal: Downsampler::NONE,
            important: Downsampler::NONE,
            pending: Vec::new(),
            dropped: 0,
        }
    }

    /// Keeps older points of a live session as well.
    pub(super) fn with_older(mut self, policy: Option<OlderPolicy<T>>) -> Self {
        self.older = policy.map(OlderPoints::new);
        self
    }

    /// As many robots share the older points.
    pub(super) const fn share_older(&mut self, robots: usize) {
        if let Some(older) = &mut self.older {
            older.robots = robots;
        }
    }

    /// Applies the policy; excess points are dropped by the next pushes.
    pub(super) const fn set_policy(&mut self, policy: RetentionPolicy) {
        self.policy = policy;
    }

    /// Queues a point for the next message, and retains it if the policy allows.
    pub(super) fn push(&mut self, now: Timestamp<HostClock>, point: T, priority: PointPriority) {
        if self.pending.len() < MAX_PENDING {
            self.pending.push(point.clone());
        } else {
            self.dropped += 1;
        }
        let retained = RetainedPoint { at: now, point, priority };
        match self.policy {
            RetentionPolicy::SlidingWindow { duration, max_points } => {
                self.retain_window(retained, duration, max_points);
            }
            RetentionPolicy::WholeSession { max_points } => self.retain_session(retained, max_points),
        }
    }

    pub(super) fn take_pending(&mut self) -> Vec<T> {
        std::mem::take(&mut self.pending)
    }

    pub(super) const fn has_pending(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Oldest first.
    pub(super) fn retained(&self) -> Vec<T> {
        let older = self.older.iter().flat_map(|older| older.kept.iter());
        older.chain(self.kept.iter().map(|one| &one.point)).cloned().collect()
    }

    pub(super) const fn dropped(&self) -> u64 {
        self.dropped
    }

    fn retain_window(&mut self, one: RetainedPoint<T>, duration: TimeDelta, max_points: usize) {
        let spacing = TimeDelta::from_nanos(duration.as_nanos() / max_points.max(1) as i64);
        let now = one.at;
        if one.priority == PointPriority::Normal && self.last.is_some_and(|last| now - last < spacing) {
            return;
        }
        self.last = Some(now);
        if self.kept.capacity() == 0 {
            // At once, for the same reason: it is full within the first minute.
            self.kept.reserve_exact(max_points + 1);
        }
        self.kept.push_back(one);
        while self.kept.len() > max_points || self.kept.front().is_some_and(|oldest| now - oldest.at > duration) {
            if let (Some(gone), Some(older)) = (self.kept.pop_front(), &mut self.older) {
                older.push(gone.point);
            }
        }
    }

    fn retain_session(&mut self, one: RetainedPoint<T>, max_points: usize) {
        if self.downsampler(one.priority).retains_next() {
            self.kept.push_back(one);
        }
        if self.kept.len() >= max_points {
            // If a quarter or more are normal, halving those frees enough space.
            let is_usual_enough = self.normal.retained >= max_points.div_ceil(4);
            self.halve(if is_usual_enough { PointPriority::Normal } else { PointPriority::Keep });
        }
    }

    fn halve(&mut self, priority: PointPriority) {
        let mut index = 0_usize;
        self.kept.retain(|one| {
            if one.priority == priority {
                index += 1;
            }
            one.priority != priority || index % 2 == 1
        });
        let downsampler = self.downsampler(priority);
        downsampler.stride *= 2;
        downsampler.retained = index.div_ceil(2);
    }

    const fn downsampler(&mut self, priority: PointPriority) -> &mut Downsampler {
        match priority {
            PointPriority::Normal => &mut self.normal,
            PointPriority::Keep => &mut self.important,
        }
    }
}

/// A map with at most `max` keys, of robots unless it is told; entries of other keys are counted and dropped.
#[derive(Clone, Debug)]
pub(super) struct BoundedMap<K, V> {
    pub(super) entries: BTreeMap<K, V>,
    max: usize,
    pub(super) ignored: u64,
}

impl<K: Ord, V> BoundedMap<K, V> {
    pub(super) const fn new(max: usize) -> Self {
        Self { entries: BTreeMap::new(), max, ignored: 0 }
    }

    pub(super) fn get_or_insert(&mut self, key: K, new: impl FnOnce() -> V) -> Option<&mut V> {
        let is_full = self.entries.len() >= self.max;
        let entry = self.entries.entry(key);
        if is_full && matches!(entry, Entry::Vacant(_)) {
            self.ignored += 1;
            return None;
        }
        Some(entry.or_insert_with(new))
    }
}

impl<K: Ord, V> Default for BoundedMap<K, V> {
    fn default() -> Self {
        Self::new(MAX_ROBOTS)
    }
}

/// A series for each robot, or for each sensor of each robot.
#[derive(Clone, Debug)]
pub(super) struct RetainedSeriesMap<K, T> {
    policy: RetentionPolicy,
    older: Option<OlderPolicy<T>>,
    series: BoundedMap<(RobotId, K), RetainedSeries<T>>,
    robots: BTreeSet<RobotId>,
}

impl<K: Ord + Copy, T: Clone> RetainedSeriesMap<K, T> {
    pub(super) const fn new(policy: RetentionPolicy, max_series: usize) -> Self {
        Self { policy, older: None, series: BoundedMap::new(max_series), robots: BTreeSet::new() }
    }

    /// Keeps older points of a live session as well, of each series.
    pub(super) const fn with_older(mut self, policy: OlderPolicy<T>) -> Self {
        self.older = Some(policy);
        self
    }

    pub(super) fn push(&mut self, now: Timestamp<HostClock>, key: (RobotId, K), point: T, priority: PointPriority) {
        let new = || RetainedSeries::new(self.policy).with_older(self.older);
        let Some(series) = self.series.get_or_insert(key, new) else {
            return;
        };
        self.robots.insert(key.0);
        series.set_policy(self.policy.shared_by(self.robots.len()));
        series.share_older(self.robots.len());
        series.push(now, point, priority);
    }

    pub(super) fn take_pending(&mut self) -> Vec<(RobotId, Vec<T>)> {
        let points = self.series.entries.iter_mut().map(|((robot, _), series)| (*robot, series.take_pending()));
        points.filter(|(_, points)| !points.is_empty()).collect()
    }

    pub(super) fn retained(&self) -> Vec<(RobotId, Vec<T>)> {
        self.series.entries.iter().map(|((robot, _), series)| (*robot, series.retained())).collect()
    }

    pub(super) fn dropped(&self) -> u64 {
        let dropped: u64 = self.series.entries.values().map(RetainedSeries::dropped).sum();
        dropped + self.series.ignored
    }
}

/// The point of an event, with its series and priority.
type PointOf<S, K, T> = fn(&mut S, Timestamp<HostClock>, &Event) -> Option<((RobotId, K), T, PointPriority)>;

/// A view of points of robots; `S` is what it knows beside the points.
pub(super) struct SeriesView<S, K, T> {
    pub(super) state: S,
    pub(super) points: RetainedSeriesMap<K, T>,
    pub(super) observe: PointOf<S, K, T>,
    pub(super) write: fn(&mut RobotFrame, Vec<T>),
}

impl<S: Send, K: Ord + Copy + Send, T: Clone + Send> View for SeriesView<S, K, T> {
    fn observe(&mut self, now: Timestamp<HostClock>, input: ViewInput<'_>) {
        if let ViewInput::Event(event) = input
            && let Some((key, point, priority)) = (self.observe)(&mut self.state, now, event)
        {
            self.points.push(now, key, point, priority);
        }
    }

    fn add_updates(&mut self, frame: &mut Frame, _content: FrameContent) {
        for (robot, points) in self.points.take_pending() {
            (self.write)(frame.robot(&robot_name(robot)), points);
        }
    }

    fn add_history(&self, history: &mut Frame) {
        for (robot, points) in self.points.retained() {
            (self.write)(history.robot(&robot_name(robot)), points);
        }
    }

    fn dropped(&self) -> u64 {
        self.points.dropped()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posebridge_telemetry::Address;

    fn at(millis: i64) -> Timestamp<HostClock> {
        Timestamp::from_millis(millis)
    }

    #[test]
    fn the_last_minute_is_kept_evenly_and_never_grows() {
        let mut trail = RetainedSeries::new(RetentionPolicy::SlidingWindow {
            duration: TimeDelta::from_millis(60_000),
            max_points: 1_200,
        });
        for millis in (0..300_000).step_by(5) {
            trail.push(at(millis), millis, PointPriority::Normal);
        }
        let kept = trail.retained();
        assert!((1_195..=1_200).contains(&kept.len()), "{}", kept.len());
        assert!(kept.windows(2).all(|pair| pair[1] - pair[0] == 50));
        assert!(kept[0] >= 240_000 - 50 && *kept.last().unwrap() >= 299_900);
    }

    #[test]
    fn what_is_rare_is_not_thinned_but_bounded() {
        let duration = TimeDelta::from_millis(60_000);
        let mut trail = RetainedSeries::new(RetentionPolicy::SlidingWindow { duration, max_points: 10 });
        trail.push(at(0), 0, PointPriority::Normal);
        trail.push(at(1), 1, PointPriority::Normal);
        trail.push(at(2), 2, PointPriority::Keep);
        assert_eq!(trail.retained(), [0, 2]);
        for millis in 3..1_000 {
            trail.push(at(millis), millis, PointPriority::Keep);
        }
        assert_eq!(trail.retained(), (990..1_000).collect::<Vec<_>>());
    }

    #[test]
    fn of_older_points_the_highest_stay() {
        let window = RetentionPolicy::SlidingWindow { duration: TimeDelta::from_millis(1_000), max_points: 1_000 };
        let older = OlderPolicy { max_points: 100, weight: |(_, height): &(i64, f64)| *height };
        let mut trail = RetainedSeries::new(window).with_older(Some(older));
        for millis in 0..90_000 {
            let height = if millis % 10_000 == 7 { 9.0 } else { f64::NAN };
            trail.push(at(millis), (millis, height), PointPriority::Normal);
        }
        let kept = trail.retained();
        assert!((1_050..1_101).contains(&kept.len()), "{}", kept.len());
        assert_eq!(kept.iter().filter(|(_, height)| *height > 0.0).count(), 9);
        assert!(kept.is_sorted_by_key(|(millis, _)| *millis));
        assert!(kept.windows(2).all(|pair| pair[1].0 - pair[0].0 <= 4_096));
    }

    #[test]
    fn a_whole_session_is_thinned_by_halves() {
        let mut trail = RetainedSeries::new(RetentionPolicy::WholeSession { max_points: 100 });
        for millis in 0..10_000 {
            trail.push(at(millis), millis, PointPriority::Normal);
        }
        let kept = trail.retained();
        assert!((50..100).contains(&kept.len()), "{}", kept.len());
        assert_eq!(kept[0], 0);
        let step = kept[1] - kept[0];
        assert!(kept.windows(2).all(|pair| pair[1] - pair[0] == step));
    }

    #[test]
    fn what_is_rare_outlives_the_thinning_of_a_whole_session() {
        let mut trail = RetainedSeries::new(RetentionPolicy::WholeSession { max_points: 1_000 });
        let weight_of = |millis: i64| {
            if millis % 1_000 == 7 { PointPriority::Keep } else { PointPriority::Normal }
        };
        for millis in 0..90_000 {
            trail.push(at(millis), millis, weight_of(millis));
        }
        let kept = trail.retained();
        let is_rare = |millis: &&i64| weight_of(**millis) == PointPriority::Keep;
        assert_eq!(kept.iter().filter(is_rare).count(), 90);
        assert!((500..1_000).contains(&kept.len()), "{}", kept.len());
        assert!(kept.is_sorted());
    }

    #[test]
    fn a_flood_of_what_is_rare_is_thinned_as_well() {
        let mut trail = RetainedSeries::new(RetentionPolicy::WholeSession { max_points: 100 });
        for millis in 0..10_000 {
            trail.push(at(millis), millis, PointPriority::Keep);
        }
        let kept = trail.retained();
        assert!((50..100).contains(&kept.len()), "{}", kept.len());
        assert!(kept[0] == 0 && *kept.last().unwrap() > 9_700, "{kept:?}");
    }

    #[test]
    fn news_are_bounded_and_counted() {
        let mut trail = RetainedSeries::new(RetentionPolicy::WholeSession { max_points: 10 });
        for millis in 0..1_000 {
            trail.push(at(millis), millis, PointPriority::Normal);
        }
        assert_eq!(trail.take_pending().len(), MAX_PENDING);
        assert_eq!(trail.dropped(), 1_000 - MAX_PENDING as u64);
        assert!(trail.take_pending().is_empty());
    }

    #[test]
    fn robots_beyond_the_most_are_counted_and_not_kept() {
        let mut trails = RetainedSeriesMap::new(RetentionPolicy::WholeSession { max_points: 10 }, 2);
        for system in 0..5 {
            let robot = RobotId { address: Address::new(system, 1), ..RobotId::default() };
            trails.push(at(0), (robot, ()), system, PointPriority::Normal);
        }
        assert_eq!(trails.retained().len(), 2);
        assert_eq!(trails.dropped(), 3);
    }

    #[test]
    fn the_robots_of_a_class_share_the_points_of_eight() {
        let window = RetentionPolicy::SlidingWindow { duration: TimeDelta::from_millis(60_000), max_points: 1_200 };
        for (policy, most) in [(window, 1_200), (RetentionPolicy::WholeSession { max_points: 1_200 }, 1_200)] {
            let mut trails = RetainedSeriesMap::new(policy, MAX_ROBOTS);
            let robots =
                |count| (0..count).map(|system| RobotId { address: Address::new(system, 1), ..RobotId::default() });
            for millis in (0..120_000).step_by(50) {
                // All others come a minute later than the first eight.
                for robot in robots(if millis < 60_000 { 8 } else { 32 }) {
                    trails.push(at(millis), (robot, ()), millis, PointPriority::Normal);
                }
            }
            let lengths: Vec<usize> = trails.retained().iter().map(|(_, points)| points.len()).collect();
            assert_eq!(lengths.len(), 32);
            assert!(lengths.iter().all(|length| (most / 8..=most / 4).contains(length)), "{lengths:?}");
        }
    }
}

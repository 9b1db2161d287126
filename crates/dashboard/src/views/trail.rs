//! Points that wait for the next message, and points that are kept for the history.

use std::collections::{BTreeMap, VecDeque};

use posebridge_telemetry::{HostClock, RobotId, Span, Stamp};

/// So many points of one kind fit into a message; there are fifty messages a second, and a brick that sends 200 times a second has
/// four between two of them.
const MOST_NEWS: usize = 256;
/// So many robots are shown; a class has fewer, and a sender that makes up addresses must not fill the memory.
pub(super) const MOST_ROBOTS: usize = 64;

/// Room for more points than these is made when they come.
const LARGEST_ROOM: usize = 4_096;

/// What is kept for the history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Keep {
    /// The points of the last so long, at most so many: not closer together than would fill it.
    Latest {
        /// So long.
        span: Span,
        /// So many.
        most: usize,
    },
    /// All of the session, at most so many: when it is full every second usual one goes, and of rare ones only where they alone
    /// would fill it.
    Whole {
        /// So many.
        most: usize,
    },
}

impl Keep {
    /// Room for so many points is made at once: what is full within a minute and then stays full had better not grow by doubling.
    const fn room(self) -> usize {
        match self {
            Self::Latest { most, .. } if most <= LARGEST_ROOM => most + 1,
            Self::Latest { .. } | Self::Whole { .. } => 0,
        }
    }
}

/// How much a point matters when points are thinned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Weight {
    /// One of many.
    Usual,
    /// One that people look for: a refused fix, a reset.
    Rare,
}

/// A point with when it came and how much it matters.
#[derive(Clone, Debug)]
struct Kept<T> {
    at: Stamp<HostClock>,
    point: T,
    weight: Weight,
}

/// How points of one weight are thinned over a whole session.
#[derive(Clone, Copy, Debug)]
struct Thinned {
    /// Of so many one is kept.
    stride: usize,
    seen: usize,
    kept: usize,
}

impl Thinned {
    const NONE: Self = Self { stride: 1, seen: 0, kept: 0 };

    /// Whether the next point is one that is kept.
    fn takes_next(&mut self) -> bool {
        let is_kept = self.seen.is_multiple_of(self.stride);
        self.seen += 1;
        if is_kept {
            self.kept += 1;
        }
        is_kept
    }
}

/// A list that stays small.
#[derive(Clone, Debug)]
pub(super) struct Trail<T> {
    keep: Keep,
    kept: VecDeque<Kept<T>>,
    last: Option<Stamp<HostClock>>,
    usual: Thinned,
    rare: Thinned,
    news: Vec<T>,
    dropped: u64,
}

impl<T: Clone> Trail<T> {
    pub(super) const fn new(keep: Keep) -> Self {
        Self {
            keep,
            kept: VecDeque::new(),
            last: None,
            usual: Thinned::NONE,
            rare: Thinned::NONE,
            news: Vec::new(),
            dropped: 0,
        }
    }

    /// Takes a point: it is news, and perhaps kept.
    pub(super) fn push(&mut self, now: Stamp<HostClock>, point: T, weight: Weight) {
        if self.news.len() < MOST_NEWS {
            self.news.push(point.clone());
        } else {
            self.dropped += 1;
        }
        match self.keep {
            Keep::Latest { span, most } => self.keep_latest(kept(now, point, weight), (span, most)),
            Keep::Whole { most } => self.keep_whole(kept(now, point, weight), most),
        }
    }

    /// What came since the last time.
    pub(super) fn take_news(&mut self) -> Vec<T> {
        std::mem::take(&mut self.news)
    }

    /// What is kept, oldest first.
    pub(super) fn kept(&self) -> Vec<T> {
        self.kept.iter().map(|one| one.point.clone()).collect()
    }

    pub(super) const fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Writes to all of the room once, so that the system gives it now and not page by page in the next minutes.
    fn take_room(&mut self, first: &Kept<T>) {
        self.kept.reserve_exact(self.keep.room());
        self.kept.resize(self.keep.room(), first.clone());
        self.kept.clear();
    }

    fn keep_latest(&mut self, one: Kept<T>, (span, most): (Span, usize)) {
        let spacing = Span::from_nanos(span.as_nanos() / most.max(1) as i64);
        let now = one.at;
        if self.last.is_none() {
            self.take_room(&one);
        }
        if one.weight == Weight::Usual && self.last.is_some_and(|last| now - last < spacing) {
            return;
        }
        self.last = Some(now);
        self.kept.push_back(one);
        while self.kept.len() > most || self.kept.front().is_some_and(|oldest| now - oldest.at > span) {
            self.kept.pop_front();
        }
    }

    fn keep_whole(&mut self, one: Kept<T>, most: usize) {
        if self.thinned(one.weight).takes_next() {
            self.kept.push_back(one);
        }
        if self.kept.len() >= most {
            // Where a quarter or more is usual, halving that makes room for long enough.
            let is_usual_enough = self.usual.kept >= most.div_ceil(4);
            self.halve(if is_usual_enough { Weight::Usual } else { Weight::Rare });
        }
    }

    /// Throws every second point of a weight away.
    fn halve(&mut self, weight: Weight) {
        let mut index = 0_usize;
        self.kept.retain(|one| {
            if one.weight == weight {
                index += 1;
            }
            one.weight != weight || index % 2 == 1
        });
        let thinned = self.thinned(weight);
        thinned.stride *= 2;
        thinned.kept = index.div_ceil(2);
    }

    const fn thinned(&mut self, weight: Weight) -> &mut Thinned {
        match weight {
            Weight::Usual => &mut self.usual,
            Weight::Rare => &mut self.rare,
        }
    }
}

const fn kept<T>(at: Stamp<HostClock>, point: T, weight: Weight) -> Kept<T> {
    Kept { at, point, weight }
}

/// A trail for each robot, or for each sensor of each robot.
#[derive(Clone, Debug)]
pub(super) struct Trails<K, T> {
    keep: Keep,
    kept_by_key: BTreeMap<(RobotId, K), Trail<T>>,
    most: usize,
    ignored: u64,
}

impl<K: Ord + Copy, T: Clone> Trails<K, T> {
    /// For so many trails at most.
    pub(super) const fn new(keep: Keep, most: usize) -> Self {
        Self { keep, kept_by_key: BTreeMap::new(), most, ignored: 0 }
    }

    pub(super) fn push(&mut self, now: Stamp<HostClock>, key: (RobotId, K), (point, weight): (T, Weight)) {
        if !self.kept_by_key.contains_key(&key) && self.kept_by_key.len() >= self.most {
            self.ignored += 1;
            return;
        }
        let keep = self.keep;
        let trail = self.kept_by_key.entry(key).or_insert_with(|| Trail::new(keep));
        trail.push(now, point, weight);
    }

    /// What came since the last time, for each robot that has news.
    pub(super) fn take_news(&mut self) -> Vec<(RobotId, Vec<T>)> {
        let trails = self.kept_by_key.iter_mut();
        let news = trails.map(|((robot, _), trail)| (*robot, trail.take_news()));
        news.filter(|(_, news)| !news.is_empty()).collect()
    }

    /// What is kept of each robot.
    pub(super) fn kept(&self) -> Vec<(RobotId, Vec<T>)> {
        let trails = self.kept_by_key.iter();
        trails.map(|((robot, _), trail)| (*robot, trail.kept())).collect()
    }

    pub(super) fn dropped(&self) -> u64 {
        let dropped: u64 = self.kept_by_key.values().map(Trail::dropped).sum();
        dropped + self.ignored
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: i64) -> Stamp<HostClock> {
        Stamp::from_millis(millis)
    }

    #[test]
    fn the_last_minute_is_kept_evenly_and_never_grows() {
        let mut trail = Trail::new(Keep::Latest { span: Span::from_millis(60_000), most: 1_200 });
        for millis in (0..300_000).step_by(5) {
            trail.push(at(millis), millis, Weight::Usual);
        }
        let kept = trail.kept();
        assert!((1_195..=1_200).contains(&kept.len()), "{}", kept.len());
        assert!(kept.windows(2).all(|pair| pair[1] - pair[0] == 50));
        assert!(kept[0] >= 240_000 - 50 && *kept.last().unwrap() >= 299_900);
    }

    #[test]
    fn what_is_rare_is_not_thinned_but_bounded() {
        let span = Span::from_millis(60_000);
        let mut trail = Trail::new(Keep::Latest { span, most: 10 });
        trail.push(at(0), 0, Weight::Usual);
        trail.push(at(1), 1, Weight::Usual);
        trail.push(at(2), 2, Weight::Rare);
        assert_eq!(trail.kept(), [0, 2]);
        for millis in 3..1_000 {
            trail.push(at(millis), millis, Weight::Rare);
        }
        assert_eq!(trail.kept(), (990..1_000).collect::<Vec<_>>());
    }

    #[test]
    fn a_whole_session_is_thinned_by_halves() {
        let mut trail = Trail::new(Keep::Whole { most: 100 });
        for millis in 0..10_000 {
            trail.push(at(millis), millis, Weight::Usual);
        }
        let kept = trail.kept();
        assert!((50..100).contains(&kept.len()), "{}", kept.len());
        assert_eq!(kept[0], 0);
        let step = kept[1] - kept[0];
        assert!(kept.windows(2).all(|pair| pair[1] - pair[0] == step));
    }

    #[test]
    fn what_is_rare_outlives_the_thinning_of_a_whole_session() {
        let mut trail = Trail::new(Keep::Whole { most: 1_000 });
        let weight_of = |millis: i64| {
            if millis % 1_000 == 7 { Weight::Rare } else { Weight::Usual }
        };
        for millis in 0..90_000 {
            trail.push(at(millis), millis, weight_of(millis));
        }
        let kept = trail.kept();
        let is_rare = |millis: &&i64| weight_of(**millis) == Weight::Rare;
        assert_eq!(kept.iter().filter(is_rare).count(), 90);
        assert!((500..1_000).contains(&kept.len()), "{}", kept.len());
        assert!(kept.is_sorted());
    }

    #[test]
    fn a_flood_of_what_is_rare_is_thinned_as_well() {
        let mut trail = Trail::new(Keep::Whole { most: 100 });
        for millis in 0..10_000 {
            trail.push(at(millis), millis, Weight::Rare);
        }
        let kept = trail.kept();
        assert!((50..100).contains(&kept.len()), "{}", kept.len());
        assert!(kept[0] == 0 && *kept.last().unwrap() > 9_700, "{kept:?}");
    }

    #[test]
    fn news_are_bounded_and_counted() {
        let mut trail = Trail::new(Keep::Whole { most: 10 });
        for millis in 0..1_000 {
            trail.push(at(millis), millis, Weight::Usual);
        }
        assert_eq!(trail.take_news().len(), MOST_NEWS);
        assert_eq!(trail.dropped(), 1_000 - MOST_NEWS as u64);
        assert!(trail.take_news().is_empty());
    }

    #[test]
    fn robots_beyond_the_most_are_counted_and_not_kept() {
        let mut trails = Trails::new(Keep::Whole { most: 10 }, 2);
        for system in 0..5 {
            let robot = RobotId { address: posebridge_telemetry::Address::new(system, 1), ..RobotId::default() };
            trails.push(at(0), (robot, ()), (system, Weight::Usual));
        }
        assert_eq!(trails.kept().len(), 2);
        assert_eq!(trails.dropped(), 3);
    }
}

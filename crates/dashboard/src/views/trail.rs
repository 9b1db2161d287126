//! Points that wait for the next message, and points that are kept for the history.

use std::collections::{BTreeMap, VecDeque};

use posebridge_telemetry::{HostClock, RobotId, Span, Stamp};

/// So many points of one kind fit into a message; there are fifty messages a second, and a brick that sends 200 times a second has
/// four between two of them.
const MOST_NEWS: usize = 256;
/// So many robots are shown; a class has fewer, and a sender that makes up addresses must not fill the memory.
pub(super) const MOST_ROBOTS: usize = 64;

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
    /// All of the session, at most so many: when it is full every second one goes.
    Whole {
        /// So many.
        most: usize,
    },
}

/// How much a point matters when points are thinned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Weight {
    /// One of many.
    Usual,
    /// One that people look for: a refused fix, a reset.
    Rare,
}

/// A list that stays small.
#[derive(Clone, Debug)]
pub(super) struct Trail<T> {
    keep: Keep,
    kept: VecDeque<(Stamp<HostClock>, T)>,
    last: Option<Stamp<HostClock>>,
    stride: usize,
    seen: usize,
    news: Vec<T>,
    dropped: u64,
}

impl<T: Clone> Trail<T> {
    pub(super) const fn new(keep: Keep) -> Self {
        Self {
            keep,
            kept: VecDeque::new(),
            last: None,
            stride: 1,
            seen: 0,
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
            Keep::Latest { span, most } => self.keep_latest((now, point), weight, (span, most)),
            Keep::Whole { most } => self.keep_whole((now, point), weight, most),
        }
    }

    /// What came since the last time.
    pub(super) fn take_news(&mut self) -> Vec<T> {
        std::mem::take(&mut self.news)
    }

    /// What is kept, oldest first.
    pub(super) fn kept(&self) -> Vec<T> {
        self.kept.iter().map(|(_, point)| point.clone()).collect()
    }

    pub(super) const fn dropped(&self) -> u64 {
        self.dropped
    }

    fn keep_latest(
        &mut self,
        (now, point): (Stamp<HostClock>, T),
        weight: Weight,
        (span, most): (Span, usize),
    ) {
        let spacing = Span::from_nanos(span.as_nanos() / most.max(1) as i64);
        if weight == Weight::Usual && self.last.is_some_and(|last| now - last < spacing) {
            return;
        }
        self.last = Some(now);
        self.kept.push_back((now, point));
        while self.kept.len() > most
            || self
                .kept
                .front()
                .is_some_and(|(oldest, _)| now - *oldest > span)
        {
            self.kept.pop_front();
        }
    }

    fn keep_whole(&mut self, (now, point): (Stamp<HostClock>, T), weight: Weight, most: usize) {
        if weight == Weight::Rare || self.seen.is_multiple_of(self.stride) {
            self.kept.push_back((now, point));
        }
        self.seen += 1;
        if self.kept.len() >= most {
            let mut index = 0;
            self.kept.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.stride *= 2;
        }
    }
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
        Self {
            keep,
            kept_by_key: BTreeMap::new(),
            most,
            ignored: 0,
        }
    }

    pub(super) fn push(
        &mut self,
        now: Stamp<HostClock>,
        key: (RobotId, K),
        (point, weight): (T, Weight),
    ) {
        if !self.kept_by_key.contains_key(&key) && self.kept_by_key.len() >= self.most {
            self.ignored += 1;
            return;
        }
        let keep = self.keep;
        let trail = self
            .kept_by_key
            .entry(key)
            .or_insert_with(|| Trail::new(keep));
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
        trails
            .map(|((robot, _), trail)| (*robot, trail.kept()))
            .collect()
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
        let mut trail = Trail::new(Keep::Latest {
            span: Span::from_millis(60_000),
            most: 1_200,
        });
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
            let robot = RobotId {
                address: posebridge_telemetry::Address::new(system, 1),
                ..RobotId::default()
            };
            trails.push(at(0), (robot, ()), (system, Weight::Usual));
        }
        assert_eq!(trails.kept().len(), 2);
        assert_eq!(trails.dropped(), 3);
    }
}

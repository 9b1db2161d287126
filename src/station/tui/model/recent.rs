//! Points of the last minute.

use std::collections::VecDeque;

/// Trails are so long, as those of the page.
const WINDOW_S: f64 = 60.0;
/// Most points that are kept: 80 s at the 50 Hz of a station.
const MAX_POINTS: usize = 4_096;

/// The latest points, oldest first.
#[derive(Clone, Debug)]
pub struct RecentPoints<T> {
    points: VecDeque<(f64, T)>,
}

impl<T> Default for RecentPoints<T> {
    fn default() -> Self {
        Self { points: VecDeque::new() }
    }
}

impl<T> RecentPoints<T> {
    /// Takes a point of this instant, in seconds of the session.
    pub fn push(&mut self, t_s: f64, point: T) {
        self.points.push_back((t_s, point));
        while self.points.len() > MAX_POINTS
            || self.points.front().is_some_and(|(oldest_s, _)| t_s - oldest_s > WINDOW_S)
        {
            self.points.pop_front();
        }
    }

    /// All of them.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        self.points.iter().map(|(_, point)| point)
    }

    /// The newest.
    pub fn last(&self) -> Option<&T> {
        self.points.back().map(|(_, point)| point)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_as_old_as_a_minute_and_not_more_than_agreed() {
        let mut recent = RecentPoints::default();
        for second in 0..100 {
            recent.push(f64::from(second), second);
        }
        assert_eq!(recent.iter().copied().collect::<Vec<_>>(), (39..100).collect::<Vec<_>>());
        for _ in 0..10_000 {
            recent.push(100.0, 7);
        }
        assert_eq!(recent.iter().count(), MAX_POINTS);
        assert_eq!(recent.last(), Some(&7));
    }
}

//! Whether the latest innovations of one source fit the claims: for live views.
//!
//! A mean over the whole run says what it was like; over the last observations, what it is like. The verdict is that of
//! [`ConsistencyBand::of_mean`].

use std::collections::VecDeque;

use super::consistency::{Consistency, ConsistencyBand};

/// Number of observations in the test: ten seconds of a brick at 20 Hz; the page tests as many.
const WINDOW_SAMPLES: usize = 200;

/// The latest normalised innovations squared of one source.
#[derive(Clone, Debug, Default)]
pub struct RecentNis {
    /// NIS and degrees of freedom.
    latest: VecDeque<(f64, u64)>,
}

impl RecentNis {
    /// Takes the NIS of an observation that was used; one that is not finite or has no degrees of freedom says nothing.
    pub fn push(&mut self, nis: f64, degrees_of_freedom: u64) {
        if !nis.is_finite() || degrees_of_freedom == 0 {
            return;
        }
        if self.latest.len() >= WINDOW_SAMPLES {
            self.latest.pop_front();
        }
        self.latest.push_back((nis, degrees_of_freedom));
    }

    /// Their sum per degree of freedom, 1 if the claims are honest; `None` without any.
    pub fn mean_per_degree(&self) -> Option<f64> {
        let degrees = self.degrees_of_freedom();
        let sum: f64 = self.latest.iter().map(|(nis, _)| nis).sum();
        (degrees > 0).then(|| sum / degrees as f64)
    }

    /// Whether the mean lies in the 95 % band of honest claims.
    pub fn consistency(&self) -> Consistency {
        let band = ConsistencyBand::of_mean(self.degrees_of_freedom());
        match (self.mean_per_degree(), band) {
            (Some(mean), Some(band)) => band.classify(mean),
            (None, _) | (_, None) => Consistency::Undetermined,
        }
    }

    fn degrees_of_freedom(&self) -> u64 {
        self.latest.iter().map(|(_, degrees)| degrees).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_latest_are_judged() {
        let mut recent = RecentNis::default();
        assert_eq!(recent.consistency(), Consistency::Undetermined);
        assert_eq!(recent.mean_per_degree(), None);
        for _ in 0..WINDOW_SAMPLES {
            recent.push(30.0, 3);
        }
        assert_eq!(recent.mean_per_degree(), Some(10.0));
        assert_eq!(recent.consistency(), Consistency::OverConfident);
        for _ in 0..WINDOW_SAMPLES {
            recent.push(3.0, 3);
        }
        assert_eq!(recent.mean_per_degree(), Some(1.0));
        assert_eq!(recent.consistency(), Consistency::Consistent);
    }

    #[test]
    fn what_is_not_finite_says_nothing() {
        let mut recent = RecentNis::default();
        recent.push(f64::NAN, 1);
        recent.push(f64::INFINITY, 1);
        recent.push(1.0, 0);
        assert_eq!(recent.consistency(), Consistency::Undetermined);
    }
}

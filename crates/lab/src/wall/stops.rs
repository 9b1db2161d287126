//! Where and when a car stopped before the wall, over many runs, and who of two did better.

/// So near the target counts as a hit, m.
pub const NEAR_WALL_M: f64 = 0.02;

/// How an approach ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopResult {
    /// Distance from the wall minus the target, m; negative is too near.
    pub error_m: f64,
    /// From the start to the stand, s.
    pub time_s: f64,
    /// Approach speed: the way driven over that time, m/s.
    pub approach_m_per_s: f64,
}

/// Approaches of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StopSummary {
    /// Approaches.
    pub runs: usize,
    /// Those that came to a stand.
    pub stopped: usize,
    /// Those that stopped within [`NEAR_WALL_M`] of the target.
    pub near: usize,
    /// Mean error of those that stopped, m.
    pub mean_error_m: f64,
    /// Its root mean square, m.
    pub rms_error_m: f64,
    /// The largest error, without sign, m.
    pub worst_error_m: f64,
    /// Mean time to the stand, s.
    pub mean_time_s: f64,
    /// Mean approach speed, m/s.
    pub mean_approach_m_per_s: f64,
}

/// Sums up approaches; `None` is one that did not end.
pub fn summarise_stops(stops: &[Option<StopResult>]) -> StopSummary {
    let mut sum = StopSummary { runs: stops.len(), ..StopSummary::default() };
    let mut squares = 0.0;
    for stop in stops.iter().flatten() {
        sum.stopped += 1;
        sum.near += usize::from(stop.error_m.abs() <= NEAR_WALL_M);
        sum.mean_error_m += stop.error_m;
        squares += stop.error_m.powi(2);
        sum.worst_error_m = sum.worst_error_m.max(stop.error_m.abs());
        sum.mean_time_s += stop.time_s;
        sum.mean_approach_m_per_s += stop.approach_m_per_s;
    }
    if sum.stopped > 0 {
        let count = sum.stopped as f64;
        sum.rms_error_m = f64::sqrt(squares / count);
        sum.mean_error_m /= count;
        sum.mean_time_s /= count;
        sum.mean_approach_m_per_s /= count;
    }
    sum
}

/// In how many runs one did better than another in the same world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StopComparison {
    /// Stopped nearer to the target.
    pub nearer: usize,
    /// At a higher approach speed.
    pub faster: usize,
    /// Both.
    pub both: usize,
}

/// Compares run by run. A method that did not stop is neither nearer nor faster than another; who stopped is both than one who did not.
pub fn compare_stops(ours: &[Option<StopResult>], theirs: &[Option<StopResult>]) -> StopComparison {
    let mut found = StopComparison::default();
    for (ours, theirs) in ours.iter().zip(theirs) {
        let Some(ours) = ours else { continue };
        let is_nearer = theirs.is_none_or(|theirs| ours.error_m.abs() < theirs.error_m.abs());
        let is_faster = theirs.is_none_or(|theirs| ours.approach_m_per_s > theirs.approach_m_per_s);
        found.nearer += usize::from(is_nearer);
        found.faster += usize::from(is_faster);
        found.both += usize::from(is_nearer && is_faster);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn stop(error_m: f64, time_s: f64) -> StopResult {
        StopResult { error_m, time_s, approach_m_per_s: 3.0 / time_s }
    }

    #[test]
    fn a_run_without_a_stop_is_counted_and_not_averaged() {
        let found = summarise_stops(&[Some(stop(0.03, 2.0)), None, Some(stop(-0.01, 4.0))]);
        assert_eq!((found.runs, found.stopped, found.near), (3, 2, 1));
        assert!((found.mean_error_m - 0.01).abs() < 1e-12);
        assert!((found.rms_error_m - 0.0005_f64.sqrt()).abs() < 1e-12);
        assert_eq!((found.worst_error_m, found.mean_time_s), (0.03, 3.0));
        assert_eq!(summarise_stops(&[]), StopSummary::default());
    }

    #[test]
    fn runs_are_compared_one_by_one() {
        let ours = [Some(stop(0.01, 2.0)), Some(stop(-0.05, 2.0)), None, Some(stop(0.2, 9.0)), Some(stop(0.0, 1.0))];
        let theirs = [Some(stop(-0.02, 3.0)), Some(stop(0.04, 3.0)), Some(stop(0.9, 9.0)), None, Some(stop(0.05, 2.0))];
        let expected = StopComparison { nearer: 3, faster: 4, both: 3 };
        assert_eq!(compare_stops(&ours, &theirs), expected);
    }
}

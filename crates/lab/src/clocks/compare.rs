//! All methods over all cases.

use super::{CLOCK_CASES, ClockCase, METHODS, MethodEntry};

/// How well one method did in one case, over all seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockRow {
    /// Name of the case.
    pub case: &'static str,
    /// Name of the method.
    pub method: &'static str,
    /// Largest error of any seed, ms; `None` if it never answered.
    pub worst_ms: Option<f64>,
    /// Mean error, ms; positive: stamps are taken for later than they were.
    pub mean_ms: Option<f64>,
    /// Standard deviation of the error, ms.
    pub std_ms: Option<f64>,
    /// Share of the scored exchanges, 0 to 1, at which it had an answer.
    pub answered: f64,
    /// Whether it answered at all.
    pub started: bool,
}

/// Runs every method of [`METHODS`] over every case of [`CLOCK_CASES`] with these seeds: a row for each, case by case.
///
/// The same seeds give the same rows. Without seeds no method starts.
pub fn compare_methods(seeds: &[u64]) -> Vec<ClockRow> {
    let pairs = CLOCK_CASES.iter().flat_map(|case| METHODS.iter().map(move |method| (case, method)));
    pairs.map(|(case, method)| row_of(case, method, seeds)).collect()
}

/// Sums over the scored exchanges.
#[derive(Clone, Copy, Debug, Default)]
struct OffsetErrors {
    scored: u32,
    answered: u32,
    sum_ms: f64,
    sum_of_squares_ms2: f64,
    worst_ms: f64,
}

impl OffsetErrors {
    fn add(&mut self, error_ms: Option<f64>) {
        self.scored += 1;
        let Some(error_ms) = error_ms else {
            return;
        };
        self.answered += 1;
        self.sum_ms += error_ms;
        self.sum_of_squares_ms2 += error_ms * error_ms;
        self.worst_ms = self.worst_ms.max(error_ms.abs());
    }
}

fn row_of(case: &ClockCase, method: &MethodEntry, seeds: &[u64]) -> ClockRow {
    let mut errors = OffsetErrors::default();
    for seed in seeds {
        let mut clock = (method.open)();
        for known in case.exchanges(*seed) {
            clock.observe_exchange(&known.exchange);
            if known.answered_s >= case.scored_from_s {
                let found_s = clock.offset_at(known.answered_s).map(|offset_s| known.exchange.remote_s + offset_s);
                errors.add(found_s.map(|found_s| (found_s - known.answered_s) * 1e3));
            }
        }
    }
    let started = errors.answered > 0;
    let count = f64::from(errors.answered);
    let mean_ms = errors.sum_ms / count;
    let variance_ms2 = errors.sum_of_squares_ms2 / count - mean_ms * mean_ms;
    ClockRow {
        case: case.name,
        method: method.name,
        worst_ms: started.then_some(errors.worst_ms),
        mean_ms: started.then_some(mean_ms),
        std_ms: started.then(|| variance_ms2.max(0.0).sqrt()),
        answered: f64::from(errors.answered) / f64::from(errors.scored.max(1)),
        started,
    }
}

//! Comparison of methods for clock alignment over a link: ours and those of other programs.
//!
//! Every method receives the same exchanges, drawn by seed over links and clocks with known truth ([`CLOCK_CASES`]), and after each
//! converts the reply's timestamp to host time. [`compare_methods`] runs all of them and returns a [`ClockRow`] for each case and
//! method. It uses no messages and no filter; [`crate::accuracy`] measures the effect of time errors on a pose.
//!
//! # Model
//! ```text
//! s_k = k / 10 s                                    request k leaves
//! m_k = max(m_k-1, s_k + d)                         the brick answers it      d = base + Exp(8 ms), 1 %: + U(50, 500) ms
//! r_k = max(r_k-1, m_k + d')                        the answer arrives
//! b_k = clock(m_k)                                  what it is stamped with, whole microseconds
//! e_k = b_k + offset(m_k) - m_k                     the method's error, positive: taken for later than it was
//! ```
//! Sources: docs/maths/clock.md, section 6; of each foreign method the source of the program that uses it.

mod cases;
mod methods;

pub use self::cases::{CLOCK_CASES, ClockCase};
pub use self::methods::{
    ArrivalTime, ClockExchange, ClockMethod, JitterCorrection, OneWayHull, TimeSyncFilter, TwoWayHulls,
};

/// A row of [`METHODS`].
#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    pub name: &'static str,
    /// Who uses the method, and how.
    pub summary: &'static str,
    pub open: fn() -> Box<dyn ClockMethod>,
}

pub const METHODS: &[MethodEntry] = &[
    MethodEntry {
        name: "arrival",
        summary: "the instant of arrival stands for the stamp",
        open: || Box::new(ArrivalTime::default()),
    },
    MethodEntry {
        name: "timesync-10ms",
        summary: "the TIMESYNC filter of PX4 and MAVROS as it is shipped, round trips below 10 ms only",
        open: || Box::new(TimeSyncFilter::new(0.010)),
    },
    MethodEntry {
        name: "timesync-60ms",
        summary: "the same filter, round trips below 60 ms",
        open: || Box::new(TimeSyncFilter::new(0.060)),
    },
    MethodEntry {
        name: "timesync-no-gate",
        summary: "the same filter, any round trip",
        open: || Box::new(TimeSyncFilter::new(f64::INFINITY)),
    },
    MethodEntry {
        name: "one-way-minimum",
        summary: "ArduPilot's JitterCorrection: the quickest message of each hundred",
        open: || Box::new(JitterCorrection::default()),
    },
    MethodEntry {
        name: "one-way-hull",
        summary: "the line below all arrivals of the window",
        open: || Box::new(OneWayHull::default()),
    },
    MethodEntry {
        name: "two-way-hulls",
        summary: "ours: half-way between the hulls of both directions",
        open: || Box::new(TwoWayHulls::default()),
    },
];

/// Error of one method in one case, over all seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockRow {
    pub case: &'static str,
    pub method: &'static str,
    /// Largest error of any seed; `None` without estimates.
    pub worst_ms: Option<f64>,
    /// Positive: timestamps are converted to later host times than true.
    pub mean_ms: Option<f64>,
    /// Share of the scored exchanges with an estimate, 0 to 1.
    pub answered: f64,
    /// Whether it produced any estimate.
    pub started: bool,
}

/// Runs every method of [`METHODS`] over every case of [`CLOCK_CASES`] with these seeds: one row for each, case by case.
///
/// The same seeds give the same rows. Without seeds no method starts.
pub fn compare_methods(seeds: &[u64]) -> Vec<ClockRow> {
    let pairs = CLOCK_CASES.iter().flat_map(|case| METHODS.iter().map(move |method| (case, method)));
    pairs.map(|(case, method)| row_of(case, method, seeds)).collect()
}

#[derive(Clone, Copy, Debug, Default)]
struct OffsetErrors {
    scored: u32,
    answered: u32,
    sum_ms: f64,
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
    ClockRow {
        case: case.name,
        method: method.name,
        worst_ms: started.then_some(errors.worst_ms),
        mean_ms: started.then(|| errors.sum_ms / f64::from(errors.answered)),
        answered: f64::from(errors.answered) / f64::from(errors.scored.max(1)),
        started,
    }
}

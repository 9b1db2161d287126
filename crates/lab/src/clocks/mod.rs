//! Ways to align two clocks over a link, side by side: ours and those that are in use elsewhere.
//!
//! Every method receives the same exchanges, drawn by seed over links and clocks whose truth is known ([`CLOCK_CASES`]), and is
//! asked after each which host instant the answer's stamp means. [`compare_methods`] runs all of them and gives a [`ClockRow`]
//! for each case and method. It sees no message and no filter; what a wrong instant does to a pose is the business of
//! [`crate::accuracy`].
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

mod arrival_time;
mod cases;
mod compare;
mod hulls;
mod jitter_correction;
mod method;
mod timesync;

pub use arrival_time::ArrivalTime;
pub use cases::{CLOCK_CASES, ClockCase};
pub use compare::{ClockRow, compare_methods};
pub use hulls::{OneWayHull, TwoWayHulls};
pub use jitter_correction::JitterCorrection;
pub use method::{ClockExchange, ClockMethod};
pub use timesync::TimeSyncFilter;

/// A row of [`METHODS`].
#[derive(Clone, Copy, Debug)]
pub struct MethodEntry {
    /// The name in tables.
    pub name: &'static str,
    /// Who does it so, and how.
    pub summary: &'static str,
    /// A fresh one.
    pub open: fn() -> Box<dyn ClockMethod>,
}

/// All methods, in the order of the table.
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

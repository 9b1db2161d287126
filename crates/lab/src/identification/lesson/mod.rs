//! The lesson of the slow thermometer: one section for each result or open question of paper 2, on a simulated sensor.
//!
//! A section is a value: text, a table, a plot and named numbers. The program renders pages, terminal text and JSON.
//! docs/lab/thermometer.md has the same order.

mod changing;
mod first;
mod identified;
mod recorded;
mod section;

pub use self::first::{BoundRun, bound_run, bounds_section};
pub use self::recorded::{RecordedPrediction, RecordedRun, recorded_sections};
pub use self::section::LessonSection;

pub type SectionBuilder = fn(u64) -> LessonSection;

/// In order, except [`bounds_section`], which accumulates many runs.
pub const SECTIONS: [SectionBuilder; 12] = [
    first::worked_example,
    first::three_methods,
    first::start,
    first::noise_gain,
    identified::orders,
    identified::other_data,
    identified::both_directions,
    changing::trend,
    changing::walking,
    first::several_sensors,
    changing::quantised,
    changing::mismatch,
];

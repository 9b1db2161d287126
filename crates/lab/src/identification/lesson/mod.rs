//! The lesson of the slow thermometer: one section for each thing that paper 2 shows or leaves open, on a simulated sensor.
//!
//! A section is a value: words, a table, a picture and named numbers. The shell makes pages, terminal text and JSON of them.
//! docs/lab/thermometer.md is the text for people; the sections have its order.

mod changing;
mod first;
mod identified;
mod recorded;
mod section;

pub use self::first::{BoundRun, bound_run, bounds_section};
pub use self::recorded::{RecordedPrediction, RecordedRun, recorded_sections};
pub use self::section::LessonSection;

pub type SectionBuilder = fn(u64) -> LessonSection;

/// The sections on the simulated sensor in their order, but for [`bounds_section`], which is added up from many runs.
pub const SECTIONS: [SectionBuilder; 12] = [
    first::worked_example,
    first::three_ways,
    first::start,
    first::noise_gain,
    identified::orders,
    identified::other_data,
    identified::both_ways,
    changing::trend,
    changing::walking,
    first::several_sensors,
    changing::quantised,
    changing::mismatch,
];

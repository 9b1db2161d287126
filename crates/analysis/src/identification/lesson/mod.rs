//! The lesson of the slow thermometer: one section for each thing that paper 2 shows or leaves open, on a simulated sensor.
//!
//! A section is a value: words, a table, a picture and named numbers. The shell makes pages, terminal text and JSON of them.
//! docs/lab/thermometer.md is the text for people; the sections have its order.

mod bounds;
mod changing;
mod first;
mod identified;
mod live;
mod mismatch;
mod recorded;

pub use bounds::{BoundRun, BoundTally, bound_run, bounds};
pub use recorded::{Recorded, RecordedRun, recorded};

use crate::figures::Plot;

/// A section of the lesson.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// For programs.
    pub name: &'static str,
    /// For people.
    pub title: String,
    /// Paragraphs.
    pub words: Vec<String>,
    /// The names of the table's columns; none for no table.
    pub header: Vec<String>,
    /// The table's rows.
    pub rows: Vec<Vec<String>>,
    /// A picture with its caption.
    pub picture: Option<(Plot, String)>,
    /// The figures that count, by their names. A figure that cannot be had is `None`.
    pub numbers: Vec<(String, Option<f64>)>,
}

impl Section {
    /// One of its numbers; `None` if it has none of this name, or no value for it.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<f64> {
        let mut all = self.numbers.iter();
        all.find(|(known, _)| known == name).and_then(|(_, value)| *value)
    }

    fn note(&mut self, name: impl Into<String>, value: impl Into<Option<f64>>) {
        self.numbers.push((name.into(), value.into()));
    }
}

/// A section of the simulated part, made from a seed.
pub type MakeSection = fn(u64) -> Section;

/// The sections on the simulated sensor in their order, but for [`bounds`], which is added up from many runs.
pub const SECTIONS: [MakeSection; 12] = [
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
    mismatch::mismatch,
];

fn header(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn seconds(value: Option<f64>) -> String {
    value.map_or_else(|| "never".to_owned(), |value| format!("{value:.2}"))
}

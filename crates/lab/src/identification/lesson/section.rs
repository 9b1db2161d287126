//! What a section of the lesson consists of.

use posebridge_report::chart::Plot;

/// A section of the lesson.
#[derive(Clone, Debug, Default)]
pub struct LessonSection {
    /// For programs.
    pub name: &'static str,
    /// For people.
    pub title: String,
    /// Paragraphs.
    pub paragraphs: Vec<String>,
    /// The names of the table's columns; none for no table.
    pub header: Vec<String>,
    /// The table's rows.
    pub rows: Vec<Vec<String>>,
    /// A picture with its caption.
    pub figure: Option<(Plot, String)>,
    /// The figures that count, by their names. A figure that cannot be had is `None`.
    pub values: Vec<(String, Option<f64>)>,
}

impl LessonSection {
    /// One of its numbers; `None` if it has none of this name, or no value for it.
    pub fn value(&self, name: &str) -> Option<f64> {
        let mut all = self.values.iter();
        all.find(|(known, _)| known == name).and_then(|(_, value)| *value)
    }

    pub(super) fn record_value(&mut self, name: impl Into<String>, value: impl Into<Option<f64>>) {
        self.values.push((name.into(), value.into()));
    }
}

pub(super) fn header(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

pub(super) fn seconds(value: Option<f64>) -> String {
    value.map_or_else(|| "never".to_owned(), |value| format!("{value:.2}"))
}

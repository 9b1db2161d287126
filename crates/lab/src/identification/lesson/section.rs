//! A section of the lesson, and what several sections draw and measure.

use posebridge_estimator::numerics::statistics::mean;
use posebridge_report::chart::{Axes, Curve, CurveShape, Plot};

use posebridge_telemetry::estimate::NORMAL_95;

use crate::identification::prediction::EndPrediction;
use crate::identification::{TimedSample, settling_time_s};

#[derive(Clone, Debug, Default)]
pub struct LessonSection {
    pub name: &'static str,
    pub title: String,
    pub paragraphs: Vec<String>,
    /// Column names; empty for no table.
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
    pub figure: Option<(Plot, String)>,
    /// Named results; `None` where a result is not available.
    pub values: Vec<(String, Option<f64>)>,
}

impl LessonSection {
    pub(super) fn new(name: &'static str, title: &str, paragraph: impl Into<String>, header: &[&str]) -> Self {
        Self {
            name,
            title: title.to_owned(),
            paragraphs: vec![paragraph.into()],
            header: header.iter().map(|name| (*name).to_owned()).collect(),
            ..Self::default()
        }
    }

    /// `None` if there is no such name, or no value for it.
    pub fn value(&self, name: &str) -> Option<f64> {
        let mut all = self.values.iter();
        all.find(|(known, _)| known == name).and_then(|(_, value)| *value)
    }

    pub(super) fn record_value(&mut self, name: impl Into<String>, value: impl Into<Option<f64>>) {
        self.values.push((name.into(), value.into()));
    }
}

pub(super) fn seconds(value: Option<f64>) -> String {
    value.map_or_else(|| "never".to_owned(), |value| format!("{value:.2}"))
}

pub(super) fn band(name: &str, values: &[(f64, f64, f64)]) -> Curve {
    let of = |(at_s, value, sigma): &(f64, f64, f64)| (*at_s, value - NORMAL_95 * sigma, value + NORMAL_95 * sigma);
    Curve::new(name, CurveShape::Band(values.iter().map(of).collect()))
}

pub(super) fn filter_values(all: &[(f64, f64, f64)]) -> Vec<(f64, f64)> {
    all.iter().map(|(at_s, value, _)| (*at_s, *value)).collect()
}

pub(super) fn sample_points(samples: &[TimedSample]) -> Vec<(f64, f64)> {
    let of = |sample: &TimedSample| (sample.at_s, sample.value);
    samples.iter().map(of).collect()
}

pub(super) fn temperatures(title: &str, panels: Vec<Vec<Curve>>) -> Plot {
    let axes = panels.into_iter().map(|curves| Axes::new("time [s]", "temperature [degrees C]", 240.0, curves));
    Plot::new(title, "", axes.collect())
}

/// Seconds from the onset until within 10, 5 and 2 % of a step of this size for good.
pub(super) fn settling_times_s(series: &[(f64, f64)], onset_s: f64, end: f64, size: f64) -> [Option<f64>; 3] {
    [0.1, 0.05, 0.02].map(|share| settling_time_s(series, onset_s, end, share * size))
}

/// Share of the bounds that contain the end, after a step was detected; `None` without one.
pub(super) fn share_inside(predictions: &[EndPrediction], end: f64) -> Option<f64> {
    let moving = predictions.iter().filter(|prediction| prediction.is_settling);
    mean(moving.map(|prediction| f64::from(u8::from(prediction.holds(end)))))
}

//! The results of `identify`: quantities, notes and plots, and their report.

use posebridge_report::chart::Plot;
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use serde_json::{Map, Value, json};

pub(super) struct Quantity {
    /// The run, if there are several.
    pub(super) of: Option<String>,
    pub(super) name: String,
    pub(super) unit: &'static str,
    pub(super) value: Option<f64>,
    pub(super) sigma: Option<f64>,
    pub(super) truth: Option<f64>,
}

impl Quantity {
    pub(super) fn new(name: impl Into<String>, unit: &'static str, value: f64, sigma: Option<f64>) -> Self {
        Self { of: None, name: name.into(), unit, value: Some(value), sigma, truth: None }
    }

    /// `None` is not significantly different from zero.
    pub(super) fn optional(name: &str, unit: &'static str, found: Option<(f64, Option<f64>)>) -> Self {
        Self {
            of: None,
            name: name.to_owned(),
            unit,
            value: found.map(|(value, _)| value),
            sigma: found.and_then(|(_, sigma)| sigma),
            truth: None,
        }
    }

    pub(super) fn for_run(mut self, run: &str) -> Self {
        self.of = Some(run.to_owned());
        self
    }

    pub(super) fn with_truth(mut self, truth: Option<f64>) -> Self {
        self.truth = truth;
        self
    }
}

pub(super) struct Findings {
    pub(super) name: &'static str,
    pub(super) title: String,
    pub(super) quantities: Vec<Quantity>,
    pub(super) notes: Vec<String>,
    pub(super) plots: Vec<Plot>,
    pub(super) extra_json: Map<String, Value>,
}

impl Findings {
    pub(super) fn new(name: &'static str, title: impl Into<String>) -> Self {
        Self {
            name,
            title: title.into(),
            quantities: Vec::new(),
            notes: Vec::new(),
            plots: Vec::new(),
            extra_json: Map::new(),
        }
    }
}

pub(super) fn report(findings: &Findings, run: &str) -> Report {
    let mut report = Report::new(findings.name, format!("{}: {run}", findings.title));
    let six = Format::new(Unit::None, 6);
    let label = |quantity: &Quantity| match &quantity.of {
        Some(of) => format!("{of}: {}", quantity.name),
        None => quantity.name.clone(),
    };
    let table = Table::of(&findings.quantities)
        .text("", "quantity", label)
        .data("of", |quantity| json!(quantity.of))
        .data("name", |quantity| json!(quantity.name))
        .number("value", "value", six, |quantity| quantity.value)
        .number("sigma", "sigma", six, |quantity| quantity.sigma)
        .text("unit", "unit", |quantity| quantity.unit.to_owned())
        .number("truth", "truth", six, |quantity| quantity.truth);
    report.table("quantities", &table);
    report.list(findings.notes.iter().cloned());
    for plot in &findings.plots {
        report.chart(plot, plot.title.as_str());
    }
    for (key, value) in &findings.extra_json {
        report.data(key, value.clone());
    }
    report.data("experiment", json!(findings.name));
    report.data("run", json!(run));
    report.data("notes", json!(findings.notes));
    report
}

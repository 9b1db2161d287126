//! What `identify` prints and draws.

use std::fmt::Write as _;
use std::path::Path;

use posebridge_report::chart::{Plot, render_plot};
use posebridge_report::page::{ReportBlock, ReportPage};
use posebridge_report::tables::{NO_VALUE, TextTable};
use serde_json::{Map, Value, json};

use crate::exit::Failure;
use crate::tools::experiment_output::{ExperimentOutcome, OutputArgs};

/// A number that was found.
pub(super) struct Quantity {
    /// The run, where there are several.
    of: Option<String>,
    name: String,
    unit: &'static str,
    value: Option<f64>,
    sigma: Option<f64>,
    truth: Option<f64>,
}

impl Quantity {
    pub(super) fn new(name: impl Into<String>, unit: &'static str, value: f64, sigma: Option<f64>) -> Self {
        Self { of: None, name: name.into(), unit, value: Some(value), sigma, truth: None }
    }

    /// One that is not significantly different from zero.
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

    /// The same of one of several runs.
    pub(super) fn for_run(mut self, run: &str) -> Self {
        self.of = Some(run.to_owned());
        self
    }

    /// The same with what is true.
    pub(super) fn with_truth(mut self, truth: Option<f64>) -> Self {
        self.truth = truth;
        self
    }
}

/// What an experiment has found.
pub(super) struct Findings {
    pub(super) name: &'static str,
    pub(super) title: String,
    pub(super) quantities: Vec<Quantity>,
    pub(super) notes: Vec<String>,
    pub(super) plots: Vec<Plot>,
    /// What programs get besides.
    pub(super) extra_json: Map<String, Value>,
}

pub(super) fn text(findings: &Findings, run: &str) -> String {
    let mut table = TextTable::new(["quantity", "value", "sigma", "unit", "truth"]);
    for quantity in &findings.quantities {
        let number = |value: Option<f64>| value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.6}"));
        table.push([
            quantity.of.as_ref().map_or_else(|| quantity.name.clone(), |of| format!("{of}: {}", quantity.name)),
            number(quantity.value),
            number(quantity.sigma),
            quantity.unit.to_owned(),
            number(quantity.truth),
        ]);
    }
    let mut text = format!("{}: {run}\n\n{}\n", findings.title, table.render());
    for note in &findings.notes {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{note}");
    }
    text
}

pub(super) fn page(findings: &Findings, text: &str) -> ReportPage {
    let figures = findings
        .plots
        .iter()
        .map(|picture| ReportBlock::Figure { svg: render_plot(picture), caption: picture.title.clone() });
    ReportPage {
        title: findings.title.clone(),
        blocks: std::iter::once(ReportBlock::PreformattedText(text.to_owned())).chain(figures).collect(),
    }
}

pub(super) fn json(findings: &Findings, run: &str) -> Value {
    let quantities: Vec<Value> = findings
        .quantities
        .iter()
        .map(|quantity| {
            json!({
                "of": quantity.of, "name": quantity.name, "unit": quantity.unit,
                "value": quantity.value, "sigma": quantity.sigma, "truth": quantity.truth,
            })
        })
        .collect();
    let mut object = findings.extra_json.clone();
    let own = [
        ("experiment", json!(findings.name)),
        ("run", json!(run)),
        ("quantities", json!(quantities)),
        ("notes", json!(findings.notes)),
    ];
    object.extend(own.map(|(key, value)| (key.to_owned(), value)));
    Value::Object(object)
}

/// Prints and writes what was found of something.
pub(super) fn write_findings(output: &OutputArgs, folder: &Path, findings: &Findings, of: &str) -> Result<(), Failure> {
    let text = text(findings, of);
    let outcome =
        ExperimentOutcome { name: findings.name, page: page(findings, &text), json: json(findings, of), text };
    output.write_outcome(folder, &outcome)
}

//! What `identify` prints and draws.

use std::fmt::Write as _;

use posebridge_analysis::figures::{Plot, plot};
use posebridge_analysis::report::page::{Page, Part};
use posebridge_analysis::report::{NO_VALUE, Table};
use serde_json::{Value, json};

/// A number that was found.
pub(super) struct Quantity {
    name: String,
    unit: &'static str,
    value: Option<f64>,
    sigma: Option<f64>,
    truth: Option<f64>,
}

impl Quantity {
    pub(super) fn new(
        name: impl Into<String>,
        unit: &'static str,
        value: f64,
        sigma: Option<f64>,
    ) -> Self {
        Self {
            name: name.into(),
            unit,
            value: Some(value),
            sigma,
            truth: None,
        }
    }

    /// One that may not be told from zero.
    pub(super) fn optional(
        name: &str,
        unit: &'static str,
        found: Option<(f64, Option<f64>)>,
    ) -> Self {
        Self {
            name: name.to_owned(),
            unit,
            value: found.map(|(value, _)| value),
            sigma: found.and_then(|(_, sigma)| sigma),
            truth: None,
        }
    }

    /// The same with what is true.
    pub(super) fn against(mut self, truth: Option<f64>) -> Self {
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
    pub(super) plot: Plot,
}

pub(super) fn text(findings: &Findings, run: &str) -> String {
    let mut table = Table::new(["quantity", "value", "sigma", "unit", "truth"]);
    for quantity in &findings.quantities {
        let number =
            |value: Option<f64>| value.map_or(NO_VALUE.to_owned(), |value| format!("{value:.6}"));
        table.push([
            quantity.name.clone(),
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

pub(super) fn page(findings: &Findings, text: &str) -> Page {
    Page {
        title: findings.title.clone(),
        parts: vec![
            Part::Lines(text.to_owned()),
            Part::Figure {
                svg: plot(&findings.plot),
                caption: findings.plot.title.clone(),
            },
        ],
    }
}

pub(super) fn json(findings: &Findings, run: &str) -> Value {
    let quantities: Vec<Value> = findings
        .quantities
        .iter()
        .map(|quantity| {
            json!({
                "name": quantity.name, "unit": quantity.unit, "value": quantity.value, "sigma": quantity.sigma, "truth": quantity.truth,
            })
        })
        .collect();
    json!({"experiment": findings.name, "run": run, "quantities": quantities, "notes": findings.notes})
}

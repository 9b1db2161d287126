//! The report of an experiment of `identify`: quantities, notes and plots.

use anyhow::{Result, ensure};
use posebridge_report::chart::Plot;
use posebridge_report::quantity::{Format, Unit};
use posebridge_report::report::{Report, Table};
use serde_json::json;

/// Checks `--from` and `--to`; returns the end.
pub(super) fn end_of_interval(from_s: f64, to_s: Option<f64>) -> Result<f64> {
    let until_s = to_s.unwrap_or(f64::INFINITY);
    ensure!(from_s < until_s, "--from is {from_s} and --to is {until_s}: nothing lies between them");
    Ok(until_s)
}

pub(super) struct Quantity {
    /// The run, if there are several.
    of: Option<String>,
    name: String,
    unit: &'static str,
    value: Option<f64>,
    sigma: Option<f64>,
    truth: Option<f64>,
}

impl Quantity {
    /// Without a value it is not significantly different from zero.
    pub(super) fn new(
        name: impl Into<String>,
        unit: &'static str,
        value: impl Into<Option<f64>>,
        sigma: impl Into<Option<f64>>,
    ) -> Self {
        Self { of: None, name: name.into(), unit, value: value.into(), sigma: sigma.into(), truth: None }
    }

    pub(super) fn for_run(self, run: impl Into<Option<String>>) -> Self {
        Self { of: run.into(), ..self }
    }

    pub(super) fn with_truth(self, truth: Option<f64>) -> Self {
        Self { truth, ..self }
    }
}

/// `name` is the command's words joined, `run` where the data come from.
pub(super) fn report(
    name: &'static str,
    title: &str,
    run: &str,
    quantities: &[Quantity],
    notes: &[String],
    plots: &[Plot],
) -> Report {
    let mut report = Report::new(name, format!("{title}: {run}"));
    let six = Format::new(Unit::None, 6);
    let label = |quantity: &Quantity| match &quantity.of {
        Some(of) => format!("{of}: {}", quantity.name),
        None => quantity.name.clone(),
    };
    let table = Table::of(quantities)
        .text("", "quantity", label)
        .data("of", |quantity| json!(quantity.of))
        .data("name", |quantity| json!(quantity.name))
        .number("value", "value", six, |quantity| quantity.value)
        .number("sigma", "sigma", six, |quantity| quantity.sigma)
        .text("unit", "unit", |quantity| quantity.unit.to_owned())
        .number("truth", "truth", six, |quantity| quantity.truth);
    report.table("quantities", &table);
    report.list(notes.iter().cloned());
    for plot in plots {
        report.chart(plot, plot.title.as_str());
    }
    report.data("experiment", json!(name));
    report.data("run", json!(run));
    report.data("notes", json!(notes));
    report
}

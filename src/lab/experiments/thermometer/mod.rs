//! `posebridge lab thermometer`: what a slow sensor will show in the end, told while it is on its way (paper 2).
//!
//! Without `--recording` on a simulated sensor, section by section; with it on recorded steps. docs/lab/thermometer.md is its page.

mod args;
mod recording;

use posebridge_lab::identification::lesson::{LessonSection, SECTIONS, bound_run, bounds_section};
use posebridge_report::chart::render_plot;
use posebridge_report::page::{ReportBlock, ReportPage};
use serde_json::{Map, Value, json};

pub use self::args::LabThermometerArgs;
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_all;
use crate::tools::experiment_output::ExperimentOutcome;

/// Runs the experiment.
///
/// # Errors
/// The recording or a run of it cannot be used, or an output cannot be written.
pub fn execute(args: &LabThermometerArgs) -> Result<(), Failure> {
    let folder = args.output.folder()?;
    let sections = if args.is_real() { recording::sections(args)? } else { simulated(args)? };
    args.output.write_outcome(&folder, &outcome(args, &sections))
}

/// A part of the work on the simulated sensor.
enum ThermometerJob {
    /// A section, by its index.
    Section(usize),
    /// A run for the bounds, by its number.
    Bound(u64),
}

/// What a job gives back.
enum ThermometerOutput {
    Section(Box<LessonSection>),
    Bound(posebridge_lab::identification::lesson::BoundRun),
}

fn simulated(args: &LabThermometerArgs) -> Result<Vec<LessonSection>, Failure> {
    let sections = (0..SECTIONS.len()).map(ThermometerJob::Section);
    let jobs: Vec<ThermometerJob> = sections.chain((0..u64::from(args.runs)).map(ThermometerJob::Bound)).collect();
    let bar = progress_bar(jobs.len() as u64, "parts").before_start()?;
    let run = |job: &ThermometerJob| match job {
        ThermometerJob::Section(index) => {
            let section = SECTIONS.get(*index).map(|make| make(args.seed));
            ThermometerOutput::Section(Box::new(section.unwrap_or_default()))
        }
        // Far from the seeds of the sections.
        ThermometerJob::Bound(run) => {
            ThermometerOutput::Bound(bound_run(args.seed.wrapping_mul(1 << 32).wrapping_add(*run)))
        }
    };
    let mut sections = Vec::new();
    let mut bound_runs = Vec::new();
    for done in run_all(&jobs, run, || bar.inc(1)) {
        match done {
            ThermometerOutput::Section(section) => sections.push(*section),
            ThermometerOutput::Bound(run) => bound_runs.push(run),
        }
    }
    bar.finish_and_clear();
    sections.push(bounds_section(&bound_runs));
    Ok(sections)
}

fn outcome(args: &LabThermometerArgs, sections: &[LessonSection]) -> ExperimentOutcome {
    let source = if args.is_real() {
        let names = args.recordings.iter().map(|path| path.display().to_string());
        let live = args.live.is_requested().then(|| "a live robot".to_owned());
        let names: Vec<String> = names.chain(live).collect();
        format!("recording {}", names.join(", "))
    } else {
        format!("simulated sensor, seed {}", args.seed)
    };
    let mut parts = vec![ReportBlock::Text(format!(
        "What will a slow sensor show in the end? Source: {source}. docs/lab/thermometer.md has the theory and exercises."
    ))];
    parts.extend(sections.iter().flat_map(report_blocks));
    ExperimentOutcome {
        name: "lab-thermometer",
        page: ReportPage { title: "The slow thermometer".to_owned(), blocks: parts },
        text: sections.iter().map(text_of).collect(),
        json: json_of(&source, sections),
    }
}

fn report_blocks(section: &LessonSection) -> Vec<ReportBlock> {
    let mut parts = vec![ReportBlock::Heading(section.title.clone())];
    parts.extend(section.paragraphs.iter().cloned().map(ReportBlock::Text));
    if !section.header.is_empty() {
        parts.push(ReportBlock::Table { header: section.header.clone(), rows: section.rows.clone() });
    }
    parts.extend(
        section
            .figure
            .iter()
            .map(|(picture, caption)| ReportBlock::Figure { svg: render_plot(picture), caption: caption.clone() }),
    );
    parts
}

/// The section's table for the terminal; nothing for a section that is a picture only.
fn text_of(section: &LessonSection) -> String {
    if section.header.is_empty() {
        return String::new();
    }
    let all = || std::iter::once(&section.header).chain(&section.rows);
    let width = |column: usize| {
        let cells = all().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..section.header.len()).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().zip(&widths);
        let cells: Vec<String> = cells.map(|(cell, width)| format!("{cell:<width$}")).collect();
        cells.join("  ").trim_end().to_owned() + "\n"
    };
    let rows: String = all().map(line).collect();
    format!("{}\n{rows}\n", section.title)
}

/// `{"source", "sections": {name: {number: value}}}`; a figure that cannot be had is null.
fn json_of(source: &str, sections: &[LessonSection]) -> Value {
    let of = |section: &LessonSection| {
        let numbers = section.values.iter();
        let numbers: Map<String, Value> = numbers.map(|(name, value)| (name.clone(), json!(value))).collect();
        (section.name.to_owned(), Value::Object(numbers))
    };
    let with_numbers = sections.iter().filter(|section| !section.values.is_empty());
    let all: Map<String, Value> = with_numbers.map(of).collect();
    json!({"source": source, "sections": all})
}
